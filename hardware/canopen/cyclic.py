"""What travels every SYNC as the operator sees it: setpoints out, a sample in. Knows no thread and no bus."""

from __future__ import annotations

import struct
from dataclasses import dataclass
from typing import Final

from hardware.canopen.bus_profile import ANSWERED, BusProfile, Entry, JointProfile, Pdo
from hardware.canopen.objects import CONTROLWORD, EMCY, JOINT_MODE, MODE, TARGET_POSITION
from hardware.errors import HardwareError

_LETTERS: Final = {8: "b", 16: "h", 32: "i", 64: "q"}
_WORDS: Final = (*ANSWERED[:1], CONTROLWORD)
"""Unsigned: bits that mean something each; everything else has a sign."""

LATE_SYNCS: Final = 100
"""On a busy machine an answer may be to a SYNC so long ago, and nobody is to blame."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """What a joint is told: 6040h, 607Ah, and 6060h as CiA 402 numbers the modes."""

    controlword: int
    target_counts: int
    mode: int


Setpoints = tuple[Setpoint, ...]
"""One for each joint 1..n."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """What all joints answered to one SYNC.

    Attributes
    ----------
    sync_count
        SYNCs since the connection began.
    statuswords, counts, torques_per_mille
        6041h, 6064h and 6077h of joints 1..n; a joint in `missing` keeps its last known values.
    missing
        Joints that did not answer this SYNC in time, or answered twice.
    """

    sync_count: int
    statuswords: tuple[int, ...]
    counts: tuple[int, ...]
    torques_per_mille: tuple[int, ...]
    missing: tuple[int, ...] = ()

    @property
    def complete(self) -> bool:
        """All joints answered once: all values were latched on the same SYNC."""
        return not self.missing


class Answer:
    """Reads one TPDO of a joint; `brings` are the indices of what is read."""

    def __init__(self, pdo: Pdo) -> None:
        self._struct, self.brings = _layout(pdo.entries, ANSWERED)
        self._places = tuple(map(ANSWERED.index, self.brings))

    def read_into(self, state: list[int], data: bytes | bytearray) -> bool:
        """Put what it brings into statusword, counts and torque; false for data of another length."""
        if len(data) != self._struct.size:
            return False
        for place, value in zip(self._places, self._struct.unpack(data), strict=True):
            state[place] = value
        return True


class _Command:
    """Packs one RPDO of a joint."""

    def __init__(self, pdo: Pdo) -> None:
        self.cob_id = pdo.cob_id
        self._struct, self._known = _layout(pdo.entries, (CONTROLWORD, TARGET_POSITION, MODE))

    def pack(self, values: dict[int, int]) -> bytes:
        return self._struct.pack(*(values[index] for index in self._known))

    def unpack(self, data: bytes) -> dict[int, int]:
        if len(data) != self._struct.size:
            return {}
        return dict(zip(self._known, self._struct.unpack(data), strict=True))


class JointFrames:
    """The frames of one joint, by its profile.

    Attributes
    ----------
    answers
        By identifier: the TPDOs that make one answer between them.
    command_ids
        Identifiers of its RPDOs.
    """

    def __init__(self, profile: BusProfile, joint: JointProfile) -> None:
        self.answers = {pdo.cob_id: Answer(pdo) for pdo in joint.answers}
        # A drive acts on each as it comes: it must have its target before a mode that follows it.
        order = sorted(
            joint.commands,
            key=lambda pdo: (TARGET_POSITION not in pdo.carried, MODE not in pdo.carried),
        )
        self._commands = tuple(map(_Command, order))
        self.command_ids = frozenset(command.cob_id for command in self._commands)
        self._controlling = {p.cob_id for p in joint.commands if CONTROLWORD in p.carried}
        self._codes = {code: profile.mode_codes[mode] for code, mode in JOINT_MODE.items()}
        self._modes = {theirs: ours for ours, theirs in self._codes.items()}

    def pack(self, setpoint: Setpoint) -> tuple[tuple[int, bytes], ...]:
        """Identifiers and data of the frames that carry a setpoint, in the order they go out."""
        values = {
            CONTROLWORD: setpoint.controlword,
            TARGET_POSITION: setpoint.target_counts,
            MODE: self._codes[setpoint.mode],
        }
        return tuple((command.cob_id, command.pack(values)) for command in self._commands)

    def pack_controlword(self, setpoint: Setpoint) -> tuple[tuple[int, bytes], ...]:
        """Of those frames, the ones that have the controlword: all that STOP needs."""
        return tuple(frame for frame in self.pack(setpoint) if frame[0] in self._controlling)

    def commanded(self, identifier: int, data: bytes) -> dict[int, int]:
        """What a command of somebody else's carries, by index, the mode as CiA 402 numbers it."""
        found: dict[int, int] = {}
        for command in self._commands:
            if command.cob_id == identifier:
                found = command.unpack(data)
        if MODE in found:
            found[MODE] = self._modes.get(found[MODE], found[MODE])
        return found


def frames_of(profile: BusProfile) -> tuple[JointFrames, ...]:
    """Frames of joints 1..n."""
    return tuple(JointFrames(profile, joint) for joint in profile.joints)


def unpack_emergency(data: bytes | bytearray) -> int | None:
    """Error code of an emergency message; None if it is not one."""
    return int(EMCY.unpack(data)[0]) if len(data) == EMCY.size else None


class Abandoned(HardwareError):
    """The caller gave a command up (Ctrl-C); the arm was brought to rest and holds."""


def _layout(
    entries: tuple[Entry, ...], wanted: tuple[int, ...]
) -> tuple[struct.Struct, tuple[int, ...]]:
    """Layout of a PDO, everything but `wanted` left out (and sent as 0); which of them it has, in order."""
    form, known = "<", list[int]()
    for index, _, bits in entries:
        if index in wanted:
            letter = _LETTERS[bits]
            form += letter.upper() if index in _WORDS else letter
            known.append(index)
        else:
            form += f"{bits // 8}x"
    return struct.Struct(form), tuple(known)
