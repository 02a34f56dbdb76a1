"""A virtual CANopen node (boot, NMT, heartbeat, EMCY, object access), and the controller's network.

`canopen.LocalNode` lacks much of this and sends heartbeats from a separate timer; here the controller's loop sends the
heartbeats, so that they stop when the loop hangs.
"""

from __future__ import annotations

import struct
import threading
from collections.abc import Callable
from functools import partial

import can
import canopen
from canopen.objectdictionary import ODVariable
from canopen.sdo.exceptions import SdoAbortedError

from hardware.canopen import objects
from hardware.canopen.objects import Abort, EmergencyCode, ErrorBit, NmtCommand, NmtState
from hardware.eds import node_dictionary, variables
from hardware.virtual.disturbances import Disturbances
from hardware.virtual.sdo_server import NodeSdoServer

Value = int | bytes | str

_NUMBERS = frozenset(ODVariable.STRUCT_TYPES)


class VirtualNode(canopen.LocalNode):
    """A node on the bus; `serial_number` is 1018h sub 4.

    A read of an object returns its entry in `answers`, a value or a function, or else its default. A write (sub-index
    0) calls its entry in `writers`, which may raise `SdoAbortedError`, or else is refused. Methods that handle frames
    take `lock`.
    """

    def __init__(self, node: int, *, serial_number: int) -> None:
        super().__init__(node, node_dictionary(node))
        self.lock = threading.RLock()
        self.state = NmtState.BOOT_UP
        self.error_register = ErrorBit(0)
        self._history: list[int] = []
        self._variables = variables(self.object_dictionary)
        self.number = node
        self.server = self.sdo = NodeSdoServer(
            objects.COB_SDO_TO_SERVER + node,
            objects.COB_SDO_FROM_SERVER + node,
            self,
            self._may_answer_sdo,
        )
        self.answers: dict[tuple[int, int], Value | Callable[[], Value]] = {
            (objects.IDENTITY, objects.IDENTITY_SERIAL): serial_number,
            (objects.ERROR_REGISTER, 0): lambda: int(self.error_register),
            (objects.ERROR_FIELD, 0): lambda: len(self._history),
        }
        for place in range(objects.ERROR_HISTORY):
            self.answers[objects.ERROR_FIELD, place + 1] = partial(self._history_entry, place)
        self.writers: dict[int, Callable[[Value], None]] = {}
        self.writers[objects.ERROR_FIELD] = self._clear_history

    def associate_network(self, network: canopen.Network) -> None:
        """Subscribe to SDO requests only: the controller passes NMT commands to `on_nmt`."""
        super().associate_network(network)
        network.unsubscribe(objects.COB_NMT, self.nmt.on_command)

    def boot(self) -> None:
        """Send the boot-up message and enter pre-operational."""
        with self.lock:
            self.server.reset()
            self.state = NmtState.BOOT_UP
            self._heartbeat()
            self.state = NmtState.PRE_OPERATIONAL

    def beat(self) -> None:
        """Send a heartbeat."""
        with self.lock:
            if self.state is not NmtState.BOOT_UP:
                self._heartbeat()

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
        """Called when the node leaves *operational*: no more PDOs."""

    def send_emergency(self, code: EmergencyCode, register: ErrorBit) -> None:
        """Send EMCY for an error, or for its end (`NONE`), and update 1001h and 1003h."""
        self.error_register = register
        if code is not EmergencyCode.NONE:
            self._history = [int(code), *self._history][: objects.ERROR_HISTORY]
        if self.state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL):
            data = objects.EMCY.pack(code, register, bytes(5))
            self.network.send_message(objects.COB_EMCY + self.number, data)

    def get_data(self, index: int, subindex: int, check_readable: bool = False) -> bytes:  # noqa: FBT001, FBT002
        """Return the bytes of an object; raises `SdoAbortedError` if it is absent or write-only."""
        variable = self._variable(index, subindex)
        if check_readable and not variable.readable:
            raise SdoAbortedError(Abort.WRITE_ONLY)
        answer = self.answers.get((index, subindex), variable.default)
        value = answer() if callable(answer) else answer
        return b"" if value is None else bytes(variable.encode_raw(value))

    def set_data(
        self,
        index: int,
        subindex: int,
        data: bytes,
        check_writable: bool = False,  # noqa: FBT001, FBT002
    ) -> None:
        """Write bytes to an object; raises `SdoAbortedError` if it is absent or read-only, or the value is refused."""
        variable = self._variable(index, subindex)
        if check_writable:
            self.check_writable(index, subindex)
        value: Value = data
        if variable.data_type in _NUMBERS:
            if 8 * len(data) != len(variable):
                raise SdoAbortedError(Abort.LENGTH)
            value = int(variable.decode_raw(data))
            if variable.min is not None and value < variable.min:
                raise SdoAbortedError(Abort.VALUE_TOO_LOW)
            if variable.max is not None and value > variable.max:
                raise SdoAbortedError(Abort.VALUE_TOO_HIGH)
        writer = self.writers.get(index) if subindex == 0 else None
        if writer is None:
            raise SdoAbortedError(Abort.READ_ONLY)
        writer(value)

    def check_writable(self, index: int, subindex: int) -> None:
        """Raise `SdoAbortedError` for an object that cannot be written."""
        if not self._variable(index, subindex).writable:
            raise SdoAbortedError(Abort.READ_ONLY)

    def _variable(self, index: int, subindex: int) -> ODVariable:
        variable = self._variables.get((index, subindex))
        if variable is None:
            known = index in self.object_dictionary.indices
            raise SdoAbortedError(Abort.NO_SUBINDEX if known else Abort.NO_OBJECT)
        return variable

    def _heartbeat(self) -> None:
        self.network.send_message(objects.COB_HEARTBEAT + self.number, bytes([self.state]))

    def _may_answer_sdo(self) -> bool:
        return self.state in (NmtState.OPERATIONAL, NmtState.PRE_OPERATIONAL)

    def _history_entry(self, place: int) -> int:
        if place >= len(self._history):
            raise SdoAbortedError(Abort.NO_DATA)
        return self._history[place]

    def _clear_history(self, value: Value) -> None:
        if value != 0:
            raise SdoAbortedError(Abort.VALUE)
        self._history.clear()


_NODE_BITS = 0x7F
_ABORT, _ABORTED = 0x80, struct.Struct("<B3sI")


class ControllerNetwork(canopen.Network):
    """A `canopen.Network` on an open bus, without a receiving thread; applies the active faults to frames."""

    def __init__(self, bus: can.BusABC, disturbances: Disturbances) -> None:
        super().__init__(bus)
        self._out = bus
        self._cut, self._disturbances = disturbances.cut_since_s, disturbances

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: FBT001, FBT002
        """Send a frame; safe from any thread."""
        if self._disturbances.off_until_s is not None:
            return
        if self._cut and can_id & _NODE_BITS in self._cut:
            return
        message = can.Message(
            arbitration_id=can_id, data=data, is_extended_id=False, is_remote_frame=remote
        )
        with self.send_lock:
            for passed in self._disturbances.wire_out.passed(message):
                self._out.send(passed)

    def send_overdue(self) -> None:
        """Send delayed frames that are due."""
        with self.send_lock:
            for message in self._disturbances.wire_out.overdue():
                self._out.send(message)

    def notify(self, can_id: int, data: bytearray, timestamp: float) -> None:
        """Pass a frame to its node, unless an SDO fault stops it."""
        node = can_id - objects.COB_SDO_TO_SERVER
        if node in self._disturbances.stalled_sdo:
            return
        if node in self._disturbances.refused_sdo and data[0] != _ABORT:
            answer = _ABORTED.pack(_ABORT, bytes(data[1:4]), Abort.GENERAL)
            self.send_message(objects.COB_SDO_FROM_SERVER + node, answer)
            return
        super().notify(can_id, data, timestamp)
