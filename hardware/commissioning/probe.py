"""Which nodes are on a bus, and whether they are set up as this program drives them. Moves and enables nothing.

Listens first: where anything is heard that only a master sends, nothing is sent at all. Then every node number
is asked for its device type, and whoever answers for who it is. Knows SDO; no session and no arm file.
"""

from __future__ import annotations

import threading
from collections import Counter
from collections.abc import Callable
from dataclasses import dataclass
from pathlib import Path
from typing import Final

import can

from hardware.buses.python_can import BusSettings, open_bus
from hardware.buses.shared_bus import SharedBus
from hardware.canopen import maps
from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.masters import describe_master_frame
from hardware.canopen.objects import (
    ARM,
    ARM_JOINTS,
    COB_HEARTBEAT,
    COB_SDO_FROM_SERVER,
    COB_SDO_TO_SERVER,
    DEVICE_NAME,
    DEVICE_TYPE,
    IDENTITY,
    IDENTITY_SERIAL,
    OPERATOR_NODE,
    POSITION_ACTUAL,
    TOKEN,
)
from hardware.canopen.pdo_reading import (
    NO_PDO_CAPABILITY,
    ActivePdo,
    PdoCapability,
    read_description_objects,
    read_pdo_capability,
    read_pdos,
)
from hardware.canopen.sdo import ObjectAccess
from hardware.canopen.supervision import operator_monitoring_differences
from hardware.errors import BusError, HardwareError, SdoRefused

LISTEN_S: Final = 1.2
"""Some heartbeats of an operator, and one of the slowest node that is driven, fit in here."""
ANSWERS_S: Final = 0.6
NODES: Final = range(1, 127)
MOST_NAMED: Final = 6
"""Kinds of frames of others that a sentence names."""
NO_WATCH: Final = (
    "node {}: without 1016h nothing says that it notices when the operator is gone: keep a hand on the hardware "
    "stop, and see what it does (sarcal arm-check)"
)
_POLL_S: Final = 0.02
_LONGEST: Final = 10
"""Times `ANSWERS_S`, on a bus where the answers do not end."""
_READ_DEVICE_TYPE: Final = bytes([0x40, DEVICE_TYPE & 0xFF, DEVICE_TYPE >> 8, 0, 0, 0, 0, 0])
_UPLOAD_ANSWER: Final = 2
_SUPERVISES: Final = ((ARM, ARM_JOINTS), (TOKEN, 0))


@dataclass(frozen=True, slots=True, kw_only=True)
class FoundNode:
    """One node that answers.

    Attributes
    ----------
    device_type, device_name, serial_number
        1000h, 1008h and 1018h; None or "" where it has none.
    drive
        Whether it is a CiA 402 servo drive.
    position_counts
        6064h of a drive.
    heard
        Whether it sent a heartbeat while it was listened to.
    problems
        What is not as this program drives it, in words.
    unread
        Why it was not looked at to the end, in words: one of the problems.
    notes
        What it does not say and somebody should know, in words.
    pdos
        The PDOs of a drive that are in use.
    described
        The objects in which a drive describes itself, of those that can be compared with an arm file.
    room
        What the PDOs of a drive could be set up of.
    supervises
        Whether it says which arm this is (2020h) and who is in control (2010h).
    """

    node: int
    device_type: int
    device_name: str
    serial_number: int | None
    drive: bool
    position_counts: int | None
    heard: bool
    problems: tuple[str, ...]
    pdos: tuple[ActivePdo, ...] = ()
    described: tuple[int, ...] = ()
    supervises: bool = False
    room: PdoCapability = NO_PDO_CAPABILITY
    notes: tuple[str, ...] = ()
    unread: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Probe:
    """What a bus holds. `busy` says who works on it, in words; then nobody was asked anything.

    `meanwhile` says the same of somebody who came while the nodes were asked: their answers may be to others.
    """

    busy: str
    heard: tuple[int, ...]
    nodes: tuple[FoundNode, ...]
    meanwhile: str = ""


class _Ears:
    """Receives in a thread of its own: notes who speaks, hands SDO answers on."""

    def __init__(self, wire: SharedBus, profile: BusProfile) -> None:
        self._wire, self._profile = wire, profile
        self.heartbeats: Counter[int] = Counter()
        self.answers: Counter[int] = Counter()
        self.device_types: dict[int, int] = {}
        self.masters: Counter[str] = Counter()
        self.deliver: Callable[[int, bytes], None] = lambda _identifier, _data: None
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._run, name="sarcal-probe", daemon=True)
        self._thread.start()

    def listen(self, seconds: float) -> None:
        """Let time pass."""
        self._closing.wait(seconds)

    def listen_to_the_last(self) -> None:
        """Let time pass until no node has answered any more for `ANSWERS_S`.

        Counted in looks, not by the clock: a computer that is late itself would take its own lateness for the
        end of the answers.
        """
        looks = round(ANSWERS_S / _POLL_S)
        known = quiet = 0
        for _ in range(_LONGEST * looks):
            self.listen(_POLL_S)
            quiet = 0 if self.answers.total() > known else quiet + 1
            known = self.answers.total()
            if quiet >= looks:
                return

    def told(self) -> str:
        """Say what came from masters so far, and forget it; empty if nothing did."""
        seen, self.masters = self.masters, Counter()
        listed = [f"{words}{f', {n} times' if n > 1 else ''}" for words, n in list(seen.items())]
        more = f"; and {len(listed) - MOST_NAMED} more" if len(listed) > MOST_NAMED else ""
        return "; ".join(listed[:MOST_NAMED]) + more

    def close(self) -> None:
        """End the thread."""
        self._closing.set()
        self._thread.join(5.0)

    def _run(self) -> None:
        while not self._closing.is_set():
            try:
                message = self._wire.receive(_POLL_S)
            except BusError:
                return
            if message is not None:
                self._take_in(message)

    def _take_in(self, message: can.Message) -> None:
        identifier, data = message.arbitration_id, bytes(message.data)
        if words := describe_master_frame(self._profile, identifier, data):
            self.masters[words] += 1
        if COB_HEARTBEAT < identifier <= COB_HEARTBEAT + OPERATOR_NODE and len(data) == 1:
            self.heartbeats[identifier - COB_HEARTBEAT] += 1
        elif COB_SDO_FROM_SERVER < identifier <= COB_SDO_FROM_SERVER + OPERATOR_NODE:
            node = identifier - COB_SDO_FROM_SERVER
            if len(data) == 8 and data[1:4] == _READ_DEVICE_TYPE[1:4]:
                self.answers[node] += 1
                if data[0] >> 5 == _UPLOAD_ANSWER:
                    self.device_types[node] = int.from_bytes(data[4:8], "little")
            self.deliver(identifier, data)


def probe(
    settings: BusSettings,
    profile: BusProfile,
    *,
    opener: Callable[[BusSettings], can.BusABC] = open_bus,
    listen_s: float = LISTEN_S,
    record_to: Path | None = None,
) -> Probe:
    """Look who is on a bus, and compare the drives that a profile names with it.

    Raises
    ------
    BusError
        It cannot be opened, or takes no frames.
    """
    wire = SharedBus(opener(settings), record_to=record_to)
    ears = _Ears(wire, profile)
    try:
        ears.listen(listen_s)
        if others := ears.told():
            busy = f"somebody else is at work on this bus: {others}"
            return Probe(busy=busy, heard=tuple(sorted(ears.heartbeats)), nodes=())
        for node in NODES:
            wire.send(COB_SDO_TO_SERVER + node, _READ_DEVICE_TYPE)
            if node % 16 == 0:
                ears.listen(_POLL_S)  # slow adapters take a few frames at a time
        ears.listen_to_the_last()
        answers = dict(ears.answers)
        access = ObjectAccess(wire.send, sorted(answers))
        ears.deliver = access.deliver
        found = tuple(
            _look_at(access, profile, node, ears, answers[node]) for node in sorted(answers)
        )
        came = ears.told()
        return Probe(
            busy="",
            heard=tuple(sorted(ears.heartbeats)),
            nodes=found,
            meanwhile=came and f"somebody else came to work on this bus meanwhile: {came}",
        )
    finally:
        ears.close()
        wire.close()


def _look_at(
    access: ObjectAccess, profile: BusProfile, node: int, ears: _Ears, answers: int
) -> FoundNode:
    kind = ears.device_types.get(node, 0)
    drive = profile.is_drive(kind)
    heard = ears.heartbeats[node] > 0
    problems, name, serial, position = list[str](), "", None, None
    supervises, notes = False, list[str]()
    pdos, described, room = tuple[ActivePdo, ...](), tuple[int, ...](), NO_PDO_CAPABILITY
    unread = ""
    if answers > 1:
        # Nothing that it says can be told from what the other one says.
        unread = f"two devices answer as node {node}: give one of them another number"
    else:
        try:
            name = _text(access, node, DEVICE_NAME)
            serial = _number(access, node, IDENTITY, IDENTITY_SERIAL)
            if drive and node in profile.drives:
                problems += map(str, maps.pdo_differences(access, node, profile))
            elif drive:
                problems.append(
                    f"node {node}: a drive that the bus profile {profile.name} does not name"
                )
            else:
                supervises = all(_number(access, node, i, s) is not None for i, s in _SUPERVISES)
            if drive:
                watch = operator_monitoring_differences(access, node)
                problems += map(str, watch or ())
                if watch is None:
                    notes.append(NO_WATCH.format(node))
                pdos = read_pdos(access, node)
                described = read_description_objects(access, node)
                room = read_pdo_capability(access, node)
                position = access.read_signed(node, POSITION_ACTUAL)
        except HardwareError as error:
            unread = str(error)
    if unread:
        problems.append(unread)
    if not heard:
        problems.append(f"node {node}: no heartbeat was heard in {LISTEN_S:g} s")
    return FoundNode(
        node=node,
        device_type=kind,
        device_name=name,
        serial_number=serial,
        drive=drive,
        position_counts=position,
        heard=heard,
        problems=tuple(problems),
        pdos=pdos,
        described=described,
        supervises=supervises,
        room=room,
        notes=tuple(notes),
        unread=unread,
    )


def _text(access: ObjectAccess, node: int, index: int) -> str:
    try:
        return access.read_text(node, index)
    except SdoRefused:
        return ""


def _number(access: ObjectAccess, node: int, index: int, subindex: int) -> int | None:
    try:
        return access.read_unsigned(node, index, subindex)
    except SdoRefused:
        return None
