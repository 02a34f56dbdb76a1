"""What travels every SYNC as the operator sees it: setpoints out, a sample in. Knows no thread and no bus."""

from __future__ import annotations

from dataclasses import dataclass

from hardware.errors import HardwareError
from hardware.objects import EMCY, RPDO1, TPDO1


@dataclass(frozen=True, slots=True)
class Setpoint:
    """RPDO1 of one joint: 6040h, 607Ah, 6060h."""

    controlword: int
    target_counts: int
    mode: int

    def pack(self) -> bytes:
        """Data of the frame."""
        return RPDO1.pack(self.controlword, self.target_counts, self.mode)


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


def unpack_status(data: bytes | bytearray) -> tuple[int, int, int] | None:
    """Statusword, position (counts) and torque (per mille) of a TPDO1; None if it is not one."""
    return TPDO1.unpack(data) if len(data) == TPDO1.size else None


def unpack_emergency(data: bytes | bytearray) -> int | None:
    """Error code of an emergency message; None if it is not one."""
    return int(EMCY.unpack(data)[0]) if len(data) == EMCY.size else None


class Abandoned(HardwareError):
    """The caller gave a command up (Ctrl-C); the arm was brought to rest and holds."""
