"""Setpoints and samples of one SYNC on the operator's side, and the frames that carry them."""

import struct
from collections.abc import Collection, Mapping
from dataclasses import dataclass
from typing import Final

from hardware.arm import DriveState, JointMode
from hardware.canopen import bus_profile
from hardware.canopen.bus_profile import BusProfile, JointProfile, Pdo
from hardware.canopen.cia402 import state_of
from hardware.canopen.objects import CONTROLWORD, EMCY, MODE, TARGET_POSITION
from hardware.errors import HardwareError

_LETTERS: Final = {8: "b", 16: "h", 32: "i", 64: "q"}
_UNSIGNED: Final = (*bus_profile.FEEDBACK_OBJECTS[:1], CONTROLWORD)

MAX_LATE_SYNCS: Final = 100
"""Upper limit of `Sample.overdue`: largest age, in SYNCs, of answers that a busy computer delivers late."""


@dataclass(frozen=True, slots=True)
class Setpoint:
    """Command of one joint: 6040h, 607Ah, and the mode whose code is sent in 6060h."""

    controlword: int
    target_counts: int
    mode: JointMode


Setpoints = tuple[Setpoint, ...]
"""Setpoints of joints 1..n."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Sample:
    """Answers of all joints to one SYNC; a joint in `missing` keeps its last values."""

    sync_count: int
    """SYNCs since the connection began."""
    statuswords: tuple[int, ...]
    counts: tuple[int, ...]
    torques_per_mille: tuple[int, ...]
    """The three tuples: 6041h, 6064h and 6077h of joints 1..n."""
    missing: tuple[int, ...] = ()
    """Joints that did not answer this SYNC in time, or answered twice."""
    overdue: tuple[int, ...] = ()
    """Number of earlier SYNCs that each joint has not answered; its values may be that old. If empty, all are 0."""

    @property
    def complete(self) -> bool:
        """Whether every joint answered exactly once, so that all values were latched on the same SYNC."""
        return not self.missing

    def joints_in(self, states: Collection[DriveState]) -> tuple[int, ...]:
        """Return the joints whose drives are in one of these states."""
        words = enumerate(self.statuswords, 1)
        return tuple(joint for joint, word in words if state_of(word) in states)


class PdoFields:
    """Encodes and decodes a PDO. Objects with an index in `indices` carry values; all others are sent as 0."""

    def __init__(self, pdo: Pdo, indices: tuple[int, ...]) -> None:
        form, known = "<", list[int]()
        for index, _, bits in pdo.entries:
            if index in indices:
                letter = _LETTERS[bits]
                form += letter.upper() if index in _UNSIGNED else letter
                known.append(index)
            else:
                form += f"{bits // 8}x"
        self._struct, self._indices = struct.Struct(form), tuple(known)

    @property
    def size(self) -> int:
        """Length of the PDO's data, bytes."""
        return self._struct.size

    def pack(self, values: Mapping[int, int]) -> bytes:
        """Return the data of a PDO that carries `values`, which are given by object index."""
        return self._struct.pack(*(values[index] for index in self._indices))

    def unpack(self, data: bytes | bytearray) -> dict[int, int] | None:
        """Return the values in `data` by object index; None if `data` has the wrong length."""
        if len(data) != self.size:
            return None
        return dict(zip(self._indices, self._struct.unpack(data), strict=True))


class JointFrames:
    """Identifiers and layouts of the PDOs of one joint: TPDOs (`answers`) and RPDOs (`commands`)."""

    def __init__(self, profile: BusProfile, joint: JointProfile) -> None:
        self.answers = {
            pdo.cob_id: PdoFields(pdo, bus_profile.FEEDBACK_OBJECTS) for pdo in joint.answers
        }
        # A drive acts on each frame on receipt: the target must come before the mode that uses it.
        order = sorted(
            joint.commands,
            key=lambda pdo: (TARGET_POSITION not in pdo.carried, MODE not in pdo.carried),
        )
        self.commands = {pdo.cob_id: PdoFields(pdo, bus_profile.COMMAND_OBJECTS) for pdo in order}
        self._controlling = {p.cob_id for p in joint.commands if CONTROLWORD in p.carried}
        self._mode_codes = {mode: profile.mode_codes[mode] for mode in JointMode}

    def pack(self, setpoint: Setpoint) -> tuple[tuple[int, bytes], ...]:
        """Return identifier and data of the frames that carry a setpoint, in the order to be sent."""
        values = {
            CONTROLWORD: setpoint.controlword,
            TARGET_POSITION: setpoint.target_counts,
            MODE: self._mode_codes[setpoint.mode],
        }
        return tuple((cob_id, command.pack(values)) for cob_id, command in self.commands.items())

    def pack_controlword(self, setpoint: Setpoint) -> tuple[tuple[int, bytes], ...]:
        """Return the frames of `pack` that carry the controlword; STOP needs no others."""
        return tuple(frame for frame in self.pack(setpoint) if frame[0] in self._controlling)


def frames_of(profile: BusProfile) -> tuple[JointFrames, ...]:
    """Return the identifiers and layouts of the PDOs of joints 1..n."""
    return tuple(JointFrames(profile, joint) for joint in profile.joints)


def unpack_emergency(data: bytes | bytearray) -> tuple[int, int] | None:
    """Return error code and error register of an emergency message; None for data of the wrong length."""
    return EMCY.unpack(data)[:2] if len(data) == EMCY.size else None


class Abandoned(HardwareError):
    """The caller interrupted a command (Ctrl-C); the arm was brought to rest and holds."""
