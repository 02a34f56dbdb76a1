"""Finds the nodes on a bus and compares their set-up with a bus profile; enables nothing.

The probe listens first, and sends nothing if another master is heard. Otherwise it requests the device type of every
node number, then identity and set-up of the nodes that answer.
"""

import time
from collections import Counter
from collections.abc import Callable, Mapping
from contextlib import suppress
from dataclasses import dataclass, field
from typing import Final

import can
from canopen.sdo import constants as sdo

from hardware.buses.shared_bus import SharedBus, receiving
from hardware.canopen import drive_settings, maps, objects
from hardware.canopen.bus_profile import COMMAND_OBJECTS, FEEDBACK_OBJECTS, BusProfile
from hardware.canopen.drive_settings import DrivePdo
from hardware.canopen.sdo import ANSWER_TIMEOUT_S, ObjectAccess
from hardware.errors import BusError, HardwareError, SdoRefused
from hardware.monitors.node_monitor import describe_master_frame

LISTEN_PERIODS: Final = 1.2
"""Time to listen, as a multiple of the slowest heartbeat that the profile allows. At the default limit (1 s), an
operator sends several heartbeats in this time, and every node sends one."""
NODES: Final = range(1, 127)
MAX_NAMED: Final = 6
"""Largest number of different foreign frames named in a message."""
NO_OPERATOR_MONITORING: Final = (
    "node {} {}, and may keep moving without the operator's heartbeat: keep a hand on the hardware stop, "
    "and test it (sarcal arm-check)"
)
_POLL_S: Final = 0.02
_MAX_ANSWER_PERIODS: Final = 10
"""Longest wait for answers, as a multiple of the silence that ends a wait."""
_READ_DEVICE_TYPE: Final = sdo.SDO_STRUCT.pack(sdo.REQUEST_UPLOAD, objects.DEVICE_TYPE, 0) + bytes(
    4
)
_SUPERVISES: Final = ((objects.ARM, objects.ARM_JOINTS), (objects.TOKEN, 0))


@dataclass(slots=True, kw_only=True)
class FoundNode:
    """One node that answers."""

    node: int
    device_type: int
    device_name: str = ""
    serial_number: int | None = None
    """`device_type`: 1000h; `device_name`: 1008h, or empty; `serial_number`: 1018h sub 4, or None."""
    drive: bool
    position_counts: int | None = None
    """6064h of a drive."""
    heard: bool
    problems: tuple[str, ...] = ()
    pdos: tuple[DrivePdo, ...] = ()
    described: tuple[int, ...] = ()
    """Objects of a drive that can be compared with an arm file."""
    supervises: bool = False
    """Whether the node has the supervisor's objects 2020h (arm) and 2010h (control token)."""
    widths: Mapping[int, int] = field(default_factory=dict)
    """Width in bits of each object that the PDOs of a drive must carry."""
    notes: tuple[str, ...] = ()
    unread: str = ""
    """Why reading stopped early (also in `problems`); otherwise empty."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe:
    """Result of a probe.

    `busy` describes another master that was heard before the first request; the probe then sent nothing. `meanwhile`
    describes one heard later: some nodes may have answered that master, not the probe. Empty if none was heard.
    """

    busy: str
    heard: tuple[int, ...]
    nodes: tuple[FoundNode, ...]
    meanwhile: str = ""

    @property
    def unanswering(self) -> tuple[str, ...]:
        """Problems of the nodes that were heard but answered no request."""
        problem = (
            "sends a heartbeat, but answers no SDO request: reset the node, which may be in NMT state "
            "stopped, or raise sdo_timeout_s of the bus profile"
        )
        nodes = sorted({*self.heard} - {found.node for found in self.nodes})
        return tuple(f"node {node} {problem}" for node in nodes)


class _Listener:
    """Counts heartbeats, SDO answers and frames of other masters."""

    def __init__(self, profile: BusProfile) -> None:
        self._profile = profile
        self.listen_s = LISTEN_PERIODS * max(1e-3 * profile.slowest_heartbeat_ms, 1.0)
        self.heartbeats: Counter[int] = Counter()
        self.answers: Counter[int] = Counter()
        self.device_types: dict[int, int] = {}
        self.masters: Counter[str] = Counter()
        self.deliver: Callable[[int, bytes], None] = lambda _identifier, _data: None

    def wait_for_answers(self, quiet_s: float) -> None:
        """Wait until no node has answered for `quiet_s`. The time is measured in polls, which excludes host latency."""
        polls = round(quiet_s / _POLL_S)
        known = silent_polls = 0
        for _ in range(_MAX_ANSWER_PERIODS * polls):
            time.sleep(_POLL_S)
            silent_polls = 0 if self.answers.total() > known else silent_polls + 1
            known = self.answers.total()
            if silent_polls >= polls:
                return

    def take_masters(self) -> str:
        masters, self.masters = self.masters, Counter()
        listed = [f"{text}{f', {n} times' if n > 1 else ''}" for text, n in list(masters.items())]
        more = f"; and {len(listed) - MAX_NAMED} more" if len(listed) > MAX_NAMED else ""
        return "; ".join(listed[:MAX_NAMED]) + more

    def take_in(self, message: can.Message) -> None:
        identifier, data = message.arbitration_id, bytes(message.data)
        if text := describe_master_frame(self._profile, identifier, data):
            self.masters[text] += 1
        if (node := objects.node_of(identifier, objects.COB_HEARTBEAT)) and len(data) == 1:
            self.heartbeats[node] += 1
        elif node := objects.node_of(identifier, objects.COB_SDO_FROM_SERVER):
            if len(data) == 8 and data[1:4] == _READ_DEVICE_TYPE[1:4]:
                self.answers[node] += 1
                if data[0] & 0xE0 == sdo.RESPONSE_UPLOAD:
                    self.device_types[node] = int.from_bytes(data[4:8], "little")
            self.deliver(identifier, data)


def probe(wire: SharedBus, profile: BusProfile) -> Probe:
    """Find the nodes on a bus and compare its drives with a profile; `BusError` if the bus fails. Closes the bus.

    The probe listens before it sends anything. A node may take as long to answer as in a session.
    """
    timeout_s = profile.sdo_timeout_s or ANSWER_TIMEOUT_S
    listener = _Listener(profile)
    with receiving(wire, listener.take_in, "sarcal-probe") as failures:
        time.sleep(listener.listen_s)
        if others := listener.take_masters():
            busy = f"another program uses this bus: {others}"
            return Probe(busy=busy, heard=tuple(sorted(listener.heartbeats)), nodes=())
        for node in NODES:
            wire.send(objects.COB_SDO_TO_SERVER + node, _READ_DEVICE_TYPE)
            if node % 16 == 0:
                time.sleep(_POLL_S)  # slow adapters take a few frames at a time
        listener.wait_for_answers(timeout_s)
        answers = dict(listener.answers)
        if failures:
            raise BusError(failures[0])
        access = ObjectAccess(wire.send, sorted(answers), timeout_s=timeout_s)
        listener.deliver = access.deliver
        nodes = tuple(
            _read_node(access, profile, node, listener, answers[node]) for node in sorted(answers)
        )
        came = listener.take_masters()
        return Probe(
            busy="",
            heard=tuple(sorted(listener.heartbeats)),
            nodes=nodes,
            meanwhile=came and f"another program started to use this bus during the probe: {came}",
        )


def _read_node(
    access: ObjectAccess, profile: BusProfile, node: int, listener: _Listener, answers: int
) -> FoundNode:
    kind = listener.device_types.get(node, 0)
    is_drive, heard = profile.is_drive(kind), listener.heartbeats[node] > 0
    node_found = FoundNode(node=node, device_type=kind, drive=is_drive, heard=heard)
    if answers > 1:
        node_found.unread = f"two devices answer as node {node}: give one of them another number"
    else:
        try:
            _ask(access, profile, node_found)
        except HardwareError as error:
            node_found.unread = str(error)
    if node_found.unread:
        node_found.problems += (node_found.unread,)
    if not node_found.heard:
        node_found.problems += (f"node {node}: no heartbeat was heard in {listener.listen_s:g} s",)
    return node_found


def _ask(access: ObjectAccess, profile: BusProfile, node_found: FoundNode) -> None:
    node = node_found.node
    with suppress(SdoRefused):
        node_found.device_name = access.read_text(node, objects.DEVICE_NAME)
    serial = _read(access, node, objects.IDENTITY, objects.IDENTITY_SERIAL)
    node_found.serial_number = None if serial is None else int.from_bytes(serial, "little")
    if not node_found.drive:
        node_found.supervises = all(_read(access, node, i, s) is not None for i, s in _SUPERVISES)
        return
    if node in profile.drives:
        # Added one by one, to keep those found so far if the node falls silent.
        for difference in maps.pdo_differences(access, node, profile):
            node_found.problems += (str(difference),)
    else:
        unknown = f"node {node}: a drive that is not in the bus profile {profile.name}"
        node_found.problems = (unknown,)
    monitoring = drive_settings.operator_monitoring_differences(access, node)
    node_found.problems += tuple(map(str, monitoring or ()))
    if monitoring is None:
        node_found.notes = (NO_OPERATOR_MONITORING.format(node, "has no 1016h"),)
    elif drive_settings.ignores_operator_timeout(access, node):
        takes_no_action = "takes no action after a heartbeat time-out (6007h = 0)"
        node_found.notes = (NO_OPERATOR_MONITORING.format(node, takes_no_action),)
    node_found.pdos = tuple(drive_settings.read_pdos(access, node))
    node_found.described = tuple(
        index
        for index in drive_settings.DESCRIPTION_OBJECTS
        if _read(access, node, index, 1) is not None
    )
    mapped = {i: _read(access, node, i) for i in (*COMMAND_OBJECTS, *FEEDBACK_OBJECTS)}
    node_found.widths = {i: 8 * len(data) for i, data in mapped.items() if data is not None}
    node_found.position_counts = access.read_signed(node, objects.POSITION_ACTUAL)


def _read(access: ObjectAccess, node: int, index: int, subindex: int = 0) -> bytes | None:
    try:
        return access.read(node, index, subindex)
    except SdoRefused:
        return None
