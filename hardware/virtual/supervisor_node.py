"""The supervisor node: parameter documents, their slots, and the control token.

Checking and storing a document take longer than a control period, so both run in another thread (`later`), and the SDO
request is answered afterwards.
"""

import hashlib
from collections.abc import Callable
from dataclasses import dataclass

from canopen.sdo import constants as sdo
from canopen.sdo.exceptions import SdoAbortedError

from hardware.canopen import objects
from hardware.canopen.objects import ParameterCommand, Slot
from hardware.virtual import parameter_store
from hardware.virtual.drive_node import DriveGroup
from hardware.virtual.node import Send, VirtualNode
from hardware.virtual.parameter_store import ParameterStore, Validate, ValidatedParameters
from hardware.virtual.sdo_server import Deferred


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmLabel:
    """Model and serial number of the arm, e.g. ``sarcos_dextrous``, ``SDA-0007``."""

    model: str
    serial_number: str

    @property
    def number(self) -> int:
        """Number for 1018h sub 4: the digits of `serial_number`, modulo 2**32."""
        digits = "".join(c for c in self.serial_number if c.isascii() and c.isdigit())
        return int(digits or "0") % 2**32


class _Refused(Exception):
    def __init__(self, text: str, code: int = sdo.ABORT_STORE_APPLICATION) -> None:
        self.text, self.code = text, code
        super().__init__(text)


class SupervisorNode(VirtualNode):
    """The supervisor, node 16.

    It tells the drives of `group` which node is in control, and sets their home offsets. `later` queues work, which is
    run outside the control loop, in the order of the calls. `active_document`: committed document in use, or None.
    """

    def __init__(
        self,
        send: Send,
        *,
        arm: ArmLabel,
        group: DriveGroup,
        store: ParameterStore,
        validate: Validate,
        is_heard: Callable[[int], bool],
        later: Callable[[Callable[[], None]], None],
    ) -> None:
        product = objects.SUPERVISOR_PRODUCT
        super().__init__(objects.SUPERVISOR_NODE, send, product=product, serial_number=arm.number)
        self.arm = arm
        self.holder = 0
        self._group, self._axes = group, tuple(node.axis for node in group.drives)
        self._store, self._validate = store, validate
        self._is_heard, self._later = is_heard, later
        self._received: bytes | None = None
        self._staged: tuple[bytes, ValidatedParameters] | None = None
        self._busy = False
        self._refusal = ""
        self._active = Slot.NONE
        self.active_document: bytes | None = None
        self._serve_objects()
        self.load()

    def power_up(self) -> None:
        """Power up with no node in control, nothing staged, and the home offsets of the active slot."""
        super().power_up()
        self._refusal = ""
        self.end_control()
        self.load()

    def load(self) -> None:
        """Apply the active document; if it is invalid, report that in 2004h and use offsets of 0."""
        self._active = self._store.active
        self.active_document = self._store.document(self._active)
        offsets: tuple[int, ...] = (0,) * len(self._axes)
        if self.active_document is not None:
            try:
                offsets = self._check(self.active_document).home_offset_counts
            except _Refused as refused:
                self._refusal = f"active document not used: {refused.text}"
        self._group.set_home_offsets(offsets)

    def end_control(self) -> None:
        """Release control, and drop a document that was not committed."""
        with self.lock:
            self._take(0)

    def _ask_for_control(self, node: int) -> None:
        if node == self.holder:
            return
        if node != 0 and self.holder != 0:
            self._refusal = f"node {self.holder} is in control"
            raise SdoAbortedError(sdo.ABORT_APPLICATION_DEVICE_STATE)
        if node != 0 and not self._is_heard(node):
            self._refusal = f"the heartbeat of node {node} is not heard"
            raise SdoAbortedError(sdo.ABORT_APPLICATION_DEVICE_STATE)
        self._take(node)

    def _take(self, node: int) -> None:
        if node == self.holder:
            return
        self.holder = node
        if not self._busy:
            self._received = self._staged = None
        self._group.control_changed(node)

    def _receive(self, document: bytes) -> None:
        self._require_control()
        self._received, self._staged = document, None

    def _order(self, command: int) -> None:
        self._require_control()
        work = {
            ParameterCommand.STAGE: self._stage,
            ParameterCommand.COMMIT: self._commit,
            ParameterCommand.ROLL_BACK: self._roll_back,
        }[ParameterCommand(command)]
        self._busy = True
        self._later(lambda: self._carry_out(work))
        raise Deferred

    def _require_control(self) -> None:
        if self.holder == 0:
            self._refusal = "nobody is in control: take the control token first"
            raise SdoAbortedError(sdo.ABORT_APPLICATION_LOCAL_CONTROL)
        if self._busy:
            self._refusal = "the previous command is still being carried out"
            raise SdoAbortedError(sdo.ABORT_APPLICATION_DEVICE_STATE)

    def _carry_out(self, work: Callable[[], None]) -> None:
        abort: int | None = sdo.ABORT_GENERAL_ERROR
        try:
            work()
            abort = None
        except _Refused as refused:
            self._refusal, abort = refused.text, refused.code
        except OSError as error:
            self._refusal = f"the document could not be stored: {error.strerror or error}"
            abort = sdo.ABORT_STORE_APPLICATION
        except Exception:
            self._refusal = "the controller failed while it carried out the command"
            raise
        finally:
            with self.lock:
                self._busy = False
                if self.holder == 0:
                    self._received = self._staged = None
            self.server.answer_later(abort)

    def _stage(self) -> None:
        document = self._received
        if document is None:
            raise _Refused("no document has been written", sdo.ABORT_APPLICATION_DEVICE_STATE)
        try:
            parameters = self._check(document)
        except _Refused:
            self._received = None
            raise
        self._staged = (document, parameters)

    def _commit(self) -> None:
        if self._staged is None:
            raise _Refused("nothing is staged to commit", sdo.ABORT_APPLICATION_DEVICE_STATE)
        document, parameters = self._staged
        self._activate(self._store.commit(document), document, parameters)

    def _roll_back(self) -> None:
        if self._received is not None:
            self._received = self._staged = None
            return
        document = self._store.document(self._store.spare)
        if document is None:
            raise _Refused(
                "there is no other document to roll back to", sdo.ABORT_APPLICATION_DEVICE_STATE
            )
        parameters = self._check(document)
        self._activate(self._store.roll_back(), document, parameters)

    def _activate(self, slot: Slot, document: bytes, parameters: ValidatedParameters) -> None:
        with self.lock:
            self._active, self.active_document = slot, document
            self._received = self._staged = None
        self._group.set_home_offsets(parameters.home_offset_counts)

    def _check(self, document: bytes) -> ValidatedParameters:
        try:
            parameters = self._validate(document)
        except ValueError as error:
            raise _Refused(str(error) or "the document is not valid") from error
        text = parameter_store.refusal_reason(parameters, self._axes, self.arm.serial_number)
        if text is not None:
            raise _Refused(text)
        return parameters

    def _document(self) -> bytes:
        document = self.active_document if self._received is None else self._received
        return b"" if document is None else document

    def _serve_objects(self) -> None:
        self.answers |= {
            (objects.DOCUMENT, 0): self._document,
            (objects.DIGEST, objects.DIGEST_SHA256): (
                lambda: hashlib.sha256(self._document()).digest()
            ),
            (objects.DIGEST, objects.DIGEST_LENGTH): lambda: len(self._document()),
            (objects.SLOTS, objects.SLOTS_ACTIVE): lambda: int(self._active),
            (objects.SLOTS, objects.SLOTS_A): lambda: int(self._store.state(Slot.A)),
            (objects.SLOTS, objects.SLOTS_B): lambda: int(self._store.state(Slot.B)),
            (objects.SLOTS, objects.SLOTS_STAGED): lambda: int(self._staged is not None),
            # 2004h is a visible string: ASCII with escapes.
            (objects.REFUSAL, 0): lambda: self._refusal.encode("ascii", "backslashreplace"),
            (objects.TOKEN, 0): lambda: self.holder,
            (objects.ARM, objects.ARM_MODEL): self.arm.model,
            (objects.ARM, objects.ARM_SERIAL): self.arm.serial_number,
            (objects.ARM, objects.ARM_JOINTS): len(self._axes),
        }
        self.writers |= {
            objects.DOCUMENT: self._receive,
            objects.COMMAND: self._order,
            objects.TOKEN: self._ask_for_control,
        }
