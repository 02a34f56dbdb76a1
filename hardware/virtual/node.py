"""A virtual CANopen node: boot, NMT, heartbeat, EMCY, object access.

`canopen.LocalNode` lacks much of this and sends heartbeats from a separate timer; here the controller's loop sends the
heartbeats, so that they stop when the loop hangs.
"""

import threading
from collections.abc import Callable, Sequence
from functools import partial
from typing import Any

from canopen.objectdictionary import ODVariable
from canopen.sdo import constants as sdo
from canopen.sdo.exceptions import SdoAbortedError

from hardware.canopen import objects
from hardware.canopen.objects import EmergencyCode, ErrorBit, NmtCommand, NmtState
from hardware.eds import variables
from hardware.virtual.sdo_server import NodeSdoServer

Value = int | bytes | str
Send = Callable[[int, bytes], None]
"""Sends a frame, from any thread: identifier, data."""

_NUMBERS = frozenset(ODVariable.STRUCT_TYPES)
_REGISTER = {
    EmergencyCode.HEARTBEAT_LOST: ErrorBit.COMMUNICATION,
    EmergencyCode.EXTERNAL_STOP: ErrorBit.MANUFACTURER,
    EmergencyCode.EXTERNAL_STOP_SECOND: ErrorBit.MANUFACTURER,
}
"""Bit of the error register, besides `GENERIC`, by error; `PROFILE` for all others."""


class VirtualNode:
    """A node on the bus, on which `send` puts a frame; `product` and `serial_number` are 1018h subs 2 and 4.

    `answers`: values by (index, sub-index), or functions that return them (None: no data); other objects have their
    default values.
    `writers`: functions, by index, that write sub-index 0 (an int, or bytes) and may raise `SdoAbortedError`; other
    objects refuse a write. `lock` is held while objects are accessed and while NMT commands are handled.
    """

    def __init__(self, node: int, send: Send, *, product: int, serial_number: int) -> None:
        self.number, self._send = node, send
        self.lock = threading.RLock()
        self.state = NmtState.BOOT_UP
        self.faults: set[str] = set()
        """Names of this node's active faults (`hardware.virtual.faults`)."""
        self.heartbeat_period_s, self.next_beat_s = objects.HEARTBEAT_PERIOD_S, 0.0
        self.error_register = ErrorBit(0)
        self._history: dict[int, int] = {}
        """Codes of past errors by sub-index of 1003h, the latest first."""
        self._variables = variables(product, node)
        self.server = NodeSdoServer(self)
        self.answers: dict[tuple[int, int], Value | Callable[[], Value | None]] = {
            (objects.IDENTITY, objects.IDENTITY_SERIAL): serial_number,
            (objects.ERROR_REGISTER, 0): lambda: int(self.error_register),
            (objects.ERROR_FIELD, 0): lambda: len(self._history),
        }
        for place in range(1, objects.ERROR_HISTORY + 1):
            self.answers[objects.ERROR_FIELD, place] = partial(self._history.get, place)
        self.writers: dict[int, Callable[[Any], None]] = {objects.ERROR_FIELD: self._clear_history}

    @property
    def has_sdo_and_emcy(self) -> bool:
        """Whether the node's NMT state allows object access and emergencies."""
        return self.state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)

    def send(self, base: int, data: bytes) -> None:
        """Send a frame whose identifier is `base` plus the node's number."""
        self._send(base + self.number, data)

    def boot(self) -> None:
        """Send the boot-up message and enter pre-operational."""
        with self.lock:
            self.server.reset()
            self.state = NmtState.BOOT_UP
            self.beat()
            self.state = NmtState.PRE_OPERATIONAL

    def beat(self) -> None:
        """Send a heartbeat."""
        self.send(objects.COB_HEARTBEAT, bytes([self.state]))

    def on_nmt(self, command: int) -> None:
        """Act on an NMT command for this node."""
        with self.lock:
            was_operational = self.state is NmtState.OPERATIONAL
            match command:
                case NmtCommand.START:
                    self.state = NmtState.OPERATIONAL
                case NmtCommand.STOP:
                    self.state = NmtState.STOPPED
                case NmtCommand.ENTER_PRE_OPERATIONAL:
                    self.state = NmtState.PRE_OPERATIONAL
                case NmtCommand.RESET_COMMUNICATION:
                    self.boot()
                case NmtCommand.RESET_NODE:
                    self.power_up()
                    self.boot()
            if was_operational and self.state is not NmtState.OPERATIONAL:
                self.left_operational()

    def power_up(self) -> None:
        """Clear what a power cycle clears: error register and error history."""
        self._history.clear()
        self.error_register = ErrorBit(0)

    def left_operational(self) -> None:
        """Called when the node leaves *operational*; from then on it exchanges no PDOs."""

    def send_emergency(self, errors: Sequence[EmergencyCode]) -> None:
        """Send the emergency of the latest active error, or of the end of all errors; update 1001h and 1003h."""
        code, register = errors[-1] if errors else EmergencyCode.NONE, ErrorBit(0)
        for error in errors:
            register |= ErrorBit.GENERIC | _REGISTER.get(error, ErrorBit.PROFILE)
        self.error_register = register
        if errors:
            codes = [int(code), *self._history.values()][: objects.ERROR_HISTORY]
            self._history.update(enumerate(codes, 1))
        if self.has_sdo_and_emcy:
            self.send(objects.COB_EMCY, objects.EMCY.pack(code, register, bytes(5)))

    def read_object(self, index: int, subindex: int) -> bytes:
        """Return the bytes of an object; raises `SdoAbortedError` if the object is absent or write-only."""
        variable = self._variable(index, subindex)
        if not variable.readable:
            raise SdoAbortedError(sdo.ABORT_READ_WRITEONLY)
        answer = self.answers.get((index, subindex), variable.default)
        value = answer() if callable(answer) else answer
        return b"" if value is None else bytes(variable.encode_raw(value))

    def write_object(self, index: int, subindex: int, data: bytes) -> None:
        """Write bytes to an object that `check_writable` has accepted; `SdoAbortedError` if the value is refused."""
        variable = self._variable(index, subindex)
        value: int | bytes = data
        if variable.data_type in _NUMBERS:
            if 8 * len(data) != len(variable):
                raise SdoAbortedError(sdo.ABORT_LENGTH_NOT_MATCHED)
            value = int(variable.decode_raw(data))
            if variable.min is not None and value < variable.min:
                raise SdoAbortedError(sdo.ABORT_VALUE_TOO_LOW)
            if variable.max is not None and value > variable.max:
                raise SdoAbortedError(sdo.ABORT_VALUE_TOO_HIGH)
        writer = self.writers.get(index) if subindex == 0 else None
        if writer is None:
            raise SdoAbortedError(sdo.ABORT_WRITE_READONLY)
        writer(value)

    def check_writable(self, index: int, subindex: int) -> None:
        """Raise `SdoAbortedError` for an object that cannot be written."""
        if not self._variable(index, subindex).writable:
            raise SdoAbortedError(sdo.ABORT_WRITE_READONLY)

    def _variable(self, index: int, subindex: int) -> ODVariable:
        variable = self._variables.get((index, subindex))
        if variable is None:
            known = any(index == other for other, _ in self._variables)
            raise SdoAbortedError(sdo.ABORT_NO_SUBINDEX if known else sdo.ABORT_NOT_IN_OD)
        return variable

    def _clear_history(self, value: int) -> None:
        if value != 0:
            raise SdoAbortedError(sdo.ABORT_INVALID_VALUE)
        self._history.clear()
