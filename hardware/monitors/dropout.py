"""Does each drive stay as it was put: enabled, and following? Looked at with every sample. Knows no bus and no clock.

A drive that trips says so. One whose enable was taken away at the drive, or that drops out for a moment, says
nothing but its statusword, and the next repetition of the command would switch it on again: unasked, beside
somebody who may have seen to it that it is off. All others are stopped for it, as for one that trips: in a closed
chain they would push against a joint that does not follow.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from typing import Final

from hardware.arm import DriveState
from hardware.canopen.cia402 import (
    CONTROLWORD_DISABLE_VOLTAGE,
    CONTROLWORD_ENABLE_OPERATION,
    CONTROLWORD_QUICK_STOP,
    StatusBit,
    shows,
    state_of,
)
from hardware.canopen.cyclic import Sample, Setpoint, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION

SURE_SYNCS: Final = 10
"""Once a drive was seen as it should be so often, no answer from before can come any more."""
DOUBT_SYNCS: Final = 2
"""Until then it has left when it says so as often as this, one answer after the other; it is told nothing meanwhile."""
DEAF_SYNCS: Final = 50
"""0.5 s in a row without bit 12: longer than a drive takes from one mode to another, where it may say either."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Left:
    """A drive that is in `state`, not by a command from here; enabled still: it follows its target no more."""

    joint: int
    state: DriveState
    sync_count: int

    @property
    def deaf(self) -> bool:
        """Whether it is enabled, and says that it does not follow."""
        return self.state is DriveState.OPERATION_ENABLED

    @property
    def controlword(self) -> int:
        """What keeps it from being switched on; one that holds its joint, or may, is let hold it."""
        holds = self.deaf or self.state is DriveState.QUICK_STOP_ACTIVE
        return CONTROLWORD_QUICK_STOP if holds else CONTROLWORD_DISABLE_VOLTAGE


@dataclass(slots=True)
class _Joint:
    """How often its drive was seen enabled, and following, since it was told to be; SYNCs since it does no more."""

    enabled: int = 0
    doubts: int = 0
    followed: int = 0
    deaf: int = 0

    def see(self, status: int, command: Setpoint) -> DriveState | None:
        """Take in its statusword; the state it is in, where that is not as it was put."""
        if command.controlword != CONTROLWORD_ENABLE_OPERATION:
            self.enabled = self.doubts = self.followed = self.deaf = 0
            return None
        if not shows(status, DriveState.OPERATION_ENABLED):
            self.followed = self.deaf = 0
            self.doubts += self.enabled > 0
            sure = self.enabled >= SURE_SYNCS or self.doubts >= DOUBT_SYNCS
            return state_of(status) if sure else None
        self.enabled, self.doubts = self.enabled + 1, 0
        if command.mode != CYCLIC_POSITION:
            self.followed = self.deaf = 0
        elif status & StatusBit.FOLLOWS_COMMAND:
            self.followed, self.deaf = self.followed + 1, 0
        elif status & StatusBit.INTERNAL_LIMIT or self.followed < SURE_SYNCS:
            self.deaf = 0
        else:
            self.deaf += 1
        return DriveState.OPERATION_ENABLED if self.deaf >= DEAF_SYNCS else None


class Staying:
    """Looks at every sample, and remembers who has left until it is told to `forget`."""

    def __init__(self) -> None:
        self._left: dict[int, Left] = {}
        self._joints: tuple[_Joint, ...] = ()

    @property
    def left(self) -> tuple[Left, ...]:
        """Drives that did not stay as they were put, those first that may be why others did not."""
        return tuple(sorted(self._left.values(), key=_urgency))

    def command(self, joint: int, command: Setpoint) -> Setpoint | None:
        """What a joint is sent in place of a command once a drive has left: nothing that keeps one enabled.

        None, and nothing is sent, for as long as its own may have: it might switch that one on again.
        """
        if command.controlword != CONTROLWORD_ENABLE_OPERATION:
            return command
        if not self._left:
            doubted = bool(self._joints) and self._joints[joint - 1].doubts > 0
            return None if doubted else command
        left = self._left.get(joint)
        word = CONTROLWORD_QUICK_STOP if left is None else left.controlword
        return Setpoint(word, command.target_counts, command.mode)

    def see(self, sample: Sample, commands: Setpoints | None, *, stopped: bool) -> None:
        """Take in a sample and the commands sent last; `stopped`: STOP is latched, and sent in their place."""
        if commands is None or stopped:
            self._joints = ()
            return
        if not self._joints:
            self._joints = tuple(_Joint() for _ in commands)
        if not self._left:  # from then on the others leave because they are told to
            self._left = {left.joint: left for left in self._find(sample, commands)}

    def forget(self) -> None:
        """Forget who has left: the operator has reset the drives."""
        self._left = {}
        self._joints = ()

    def _find(self, sample: Sample, commands: Setpoints) -> Iterator[Left]:
        watched = zip(self._joints, sample.statuswords, commands, strict=True)
        for number, (joint, status, command) in enumerate(watched, 1):
            state = None if number in sample.missing else joint.see(status, command)
            if state is not None:
                yield Left(joint=number, state=state, sync_count=sample.sync_count)


def _urgency(left: Left) -> int:
    """A drive in fault stops its neighbours; one that stopped may well be such a neighbour."""
    if left.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
        return 0
    return 2 if left.state is DriveState.QUICK_STOP_ACTIVE else 1
