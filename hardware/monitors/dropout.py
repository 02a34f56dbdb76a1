"""Detects drives that leave *operation enabled*, or stop following, without a command from this program.

A drive that trips sends an emergency. A drive that is disabled at the drive itself reports that in its statusword only,
and the next repeated command would enable it again, although it may have been switched off on purpose. Therefore that
drive is not enabled again, and all other drives stop as after a trip: in a closed chain they would push against a joint
that does not follow.
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
    state_of,
)
from hardware.canopen.cyclic import Sample, Setpoint, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION

CONFIRMED_SYNCS: Final = 10
"""After a drive has answered this many times as commanded, no answer from before the command can still arrive."""
DROPOUT_SYNCS: Final = 2
"""A drive that has been enabled for fewer than `CONFIRMED_SYNCS` counts as dropped out after this many consecutive
*disabled* answers; meanwhile its joint gets no command. If the drive has been enabled for longer, a single *disabled*
answer is enough."""
NOT_FOLLOWING_SYNCS: Final = 50
"""0.5 s without bit 12 or with bit 13: longer than a mode change, during which a drive may set or clear these bits."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Dropout:
    """Uncommanded `status` of a drive; if its state is *operation enabled*, the drive has stopped following."""

    joint: int
    status: int
    sync_count: int

    @property
    def state(self) -> DriveState:
        """The drive's state."""
        return state_of(self.status)

    @property
    def not_following(self) -> bool:
        """Whether the drive is enabled but reports that it does not follow (6041h, bit 12 or bit 13)."""
        return self.state is DriveState.OPERATION_ENABLED

    @property
    def controlword(self) -> int:
        """Controlword that does not enable the drive: quick stop if the drive holds, otherwise disable voltage."""
        holds = self.not_following or self.state is DriveState.QUICK_STOP_ACTIVE
        return CONTROLWORD_QUICK_STOP if holds else CONTROLWORD_DISABLE_VOLTAGE


@dataclass(slots=True)
class _Joint:
    """Number of SYNCs since the command to enable, by condition of the drive."""

    enabled_syncs: int = 0
    disabled_syncs: int = 0
    following_syncs: int = 0
    not_following_syncs: int = 0

    def update(self, status: int, command: Setpoint) -> bool:
        """Take in a statusword; return whether the drive has dropped out."""
        if command.controlword != CONTROLWORD_ENABLE_OPERATION:
            self.enabled_syncs = self.disabled_syncs = 0
            self.following_syncs = self.not_following_syncs = 0
            return False
        if state_of(status) is not DriveState.OPERATION_ENABLED:
            self.following_syncs = self.not_following_syncs = 0
            self.disabled_syncs += self.enabled_syncs > 0
            was_enabled = self.enabled_syncs >= CONFIRMED_SYNCS
            return was_enabled or self.disabled_syncs >= DROPOUT_SYNCS
        self.enabled_syncs, self.disabled_syncs = self.enabled_syncs + 1, 0
        if command.mode != CYCLIC_POSITION:
            self.following_syncs = self.not_following_syncs = 0
        elif status & StatusBit.FOLLOWING_ERROR:
            self.not_following_syncs += 1
        elif status & StatusBit.FOLLOWS_COMMAND:
            self.following_syncs, self.not_following_syncs = self.following_syncs + 1, 0
        elif self.following_syncs < CONFIRMED_SYNCS:
            self.not_following_syncs = 0
        else:
            self.not_following_syncs += 1
        return self.not_following_syncs >= NOT_FOLLOWING_SYNCS


class DropoutMonitor:
    """Checks every sample and keeps the dropouts until `reset`."""

    def __init__(self) -> None:
        self._dropouts: dict[int, Dropout] = {}
        self._joints: tuple[_Joint, ...] = ()

    @property
    def dropouts(self) -> tuple[Dropout, ...]:
        """Dropouts so far, the most likely cause first."""
        return tuple(sorted(self._dropouts.values(), key=_priority))

    def command(self, joint: int, command: Setpoint) -> Setpoint | None:
        """Return the command to send to a joint: after a dropout, one that does not enable the drive.

        The result is None (send nothing) while a dropout of this joint is suspected: a command might enable the drive.
        """
        if command.controlword != CONTROLWORD_ENABLE_OPERATION:
            return command
        if not self._dropouts:
            suspected = bool(self._joints) and self._joints[joint - 1].disabled_syncs > 0
            return None if suspected else command
        dropout = self._dropouts.get(joint)
        word = CONTROLWORD_QUICK_STOP if dropout is None else dropout.controlword
        return Setpoint(word, command.target_counts, command.mode)

    def update(self, sample: Sample, commands: Setpoints | None, *, stopped: bool) -> None:
        """Take in a sample and the commands sent last; while `stopped`, quick stop is sent in their place."""
        if commands is None or stopped:
            self._joints = ()
            return
        if not self._joints:
            self._joints = tuple(_Joint() for _ in commands)
        if not self._dropouts:  # afterwards the other drives stop on command
            self._dropouts = {each.joint: each for each in self._find(sample, commands)}

    def reset(self) -> None:
        """Clear the dropouts, once the operator has reset the drives."""
        self._dropouts = {}
        self._joints = ()

    def _find(self, sample: Sample, commands: Setpoints) -> Iterator[Dropout]:
        joints = zip(self._joints, sample.statuswords, commands, strict=True)
        for number, (joint, status, command) in enumerate(joints, 1):
            if number not in sample.missing and joint.update(status, command):
                yield Dropout(joint=number, status=status, sync_count=sample.sync_count)


def _priority(dropout: Dropout) -> int:
    """Return the rank of a dropout as likely cause of the others, 0 first: a drive in fault stops its neighbours."""
    if dropout.state in (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE):
        return 0
    return 2 if dropout.state is DriveState.QUICK_STOP_ACTIVE else 1
