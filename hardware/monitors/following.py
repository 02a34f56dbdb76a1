"""Detects uncommanded motion, and drives that leave *operation enabled* or stop following without a command.

A drive checks its following error (6065h) with its own target and sensor. If another program sends targets to the
drive, or the drive's reports are wrong, only this program can detect the fault, since it knows the commands.

A joint is checked from the moment its drive reports that it follows (6041h, bit 12) until its mode changes or the drive
leaves *operation enabled*, even if bit 12 drops. If a drive never sets bit 12, setting its mode fails
(`hardware.control.canopen_arm`). A drive that reports a refused target keeps an earlier target, so its joint may be
near any of the targets sent before the report.

A drive that trips sends an emergency. A drive that is disabled at the drive itself, perhaps on purpose, reports this in
its statusword only. The next repeated command would enable this drive again, so it gets no such command. All other
drives stop as after a trip: in a closed chain they would push against its joint.
"""

import math
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from hardware.arm import DriveState, JointMode
from hardware.canopen import cia402
from hardware.canopen.cia402 import StatusBit, state_of
from hardware.canopen.cyclic import MAX_LATE_SYNCS, Sample, Setpoint, Setpoints

DIVERGED_SYNCS: Final = 10
"""Consecutive SYNCs outside the window that show uncommanded motion; a new target or a late frame causes fewer."""
LAG_SYNCS: Final = 20
"""0.2 s: allowed lag of a servo behind its target in motion, in addition to its window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Divergence:
    """Uncommanded motion of a joint, first seen at SYNC `sync_count`.

    `counts`: distance from the target; with `stopped`, from the position where the joint came to rest. `angle_rad`: the
    same distance, rad; None if it is not computed yet.
    """

    joint: int
    counts: int
    sync_count: int
    stopped: bool = False
    angle_rad: float | None = None


MIN_BRAKING_SYNCS: Final = 30
"""0.3 s: time allowed for every stopped joint to come to rest."""
MAX_BRAKING_SYNCS: Final = 200
"""2 s: time allowed to a joint that keeps slowing down; the deceleration (6085h) is the drive maker's choice."""
STRETCH_SYNCS: Final = 10
"""Length of the successive intervals after a stop. A joint counts as braking as long as it moves less in each interval
than in the one before."""


@dataclass(slots=True)
class _StoppedJoint:
    """State of a joint after a stop; `last_travel_counts`: distance moved in the last interval of `STRETCH_SYNCS`."""

    stopped_syncs: int = 0
    rest_counts: int = 0
    at_rest: bool = False
    stretch_start_counts: int = 0
    last_travel_counts: float = math.inf

    def displacement(self, counts: int) -> int:
        """Return the distance from the rest position; 0 until the joint has come to rest."""
        if self.at_rest:
            return counts - self.rest_counts
        if self.stopped_syncs == 0:
            self.stretch_start_counts = counts
        self.stopped_syncs += 1
        self.rest_counts = counts
        if self.stopped_syncs % STRETCH_SYNCS == 0:
            travel = abs(counts - self.stretch_start_counts)
            slowing = (
                0 < travel < self.last_travel_counts and self.stopped_syncs < MAX_BRAKING_SYNCS
            )
            self.at_rest = self.stopped_syncs >= MIN_BRAKING_SYNCS and not slowing
            self.stretch_start_counts, self.last_travel_counts = counts, travel
        return 0


class FollowingMonitor:
    """Finds joints that do not follow their targets or, after a quick stop, do not stay where they came to rest.

    The latest targets of a joint are the present one, those of the `LAG_SYNCS` SYNCs before, and one more for each SYNC
    that the joint has not answered yet. A joint may be outside the range of these targets by at most its window
    (`windows_counts`). After a quick stop the window is around the rest position, since a stopped drive's own target is
    not known to this program. Joints in free mode are not checked. Neither are joints whose drives report no power
    after a quick stop (605Ah below 5). If `windows_counts` is empty, no joint is checked.
    """

    def __init__(self, windows_counts: Sequence[float] = ()) -> None:
        self._windows = tuple(windows_counts)
        self._outside_syncs = [0] * len(self._windows)
        self._followed = [False] * len(self._windows)
        longest = 1 + LAG_SYNCS + MAX_LATE_SYNCS
        self._targets = tuple(deque[int](maxlen=longest) for _ in self._windows)  # newest first
        self._stopped = [_StoppedJoint() for _ in self._windows]

    def update(
        self, sample: Sample, commands: Setpoints | None, refusing_joints: Collection[int] = ()
    ) -> tuple[Divergence, ...]:
        """Take in a sample and the commands sent before it; return the joints' divergences.

        `refusing_joints`: joints whose drives report a refused target.
        """
        return () if commands is None else tuple(self._find(sample, commands, refusing_joints))

    def away(self, sample: Sample, commands: Setpoints) -> tuple[int, ...]:
        """Return the joints in position mode that did not answer or are outside the window around their target."""
        errors = zip(sample.counts, commands, self._windows, strict=False)  # no windows: no joint
        return tuple(
            joint
            for joint, (counts, command, window) in enumerate(errors, 1)
            if command.mode is JointMode.POSITION
            and (joint in sample.missing or abs(counts - command.target_counts) > window)
        )

    def _find(
        self, sample: Sample, commands: Setpoints, refusing_joints: Collection[int]
    ) -> Iterator[Divergence]:
        for at, window in enumerate(self._windows):
            command, status, targets = commands[at], sample.statuswords[at], self._targets[at]
            state, counts = state_of(status), sample.counts[at]
            stopped = state is DriveState.QUICK_STOP_ACTIVE
            if not stopped or command.mode is not JointMode.POSITION:
                if self._stopped[at].stopped_syncs:  # enabled again directly: another window
                    self._outside_syncs[at] = 0
                self._stopped[at] = _StoppedJoint()
            if command.mode is not JointMode.POSITION:
                targets.clear()
                self._outside_syncs[at], self._followed[at] = 0, False
                continue
            if at + 1 not in refusing_joints or not targets:
                targets.appendleft(command.target_counts)
            if at + 1 in sample.missing:
                continue
            follows = bool(status & StatusBit.FOLLOWS_COMMAND) or self._followed[at]
            self._followed[at] = follows and state is DriveState.OPERATION_ENABLED
            error = counts - command.target_counts
            if stopped:
                error = self._stopped[at].displacement(counts)
            outside = (stopped or self._followed[at]) and abs(error) > window
            if outside and not stopped:  # outside the range of earlier targets too?
                overdue = sample.overdue[at] if sample.overdue else 0
                recent = tuple(islice(targets, 1 + LAG_SYNCS + overdue))
                outside = not min(recent) - window <= counts <= max(recent) + window
            self._outside_syncs[at] = self._outside_syncs[at] + 1 if outside else 0
            if self._outside_syncs[at] >= DIVERGED_SYNCS:
                since = sample.sync_count - self._outside_syncs[at] + 1
                yield Divergence(joint=at + 1, counts=error, sync_count=since, stopped=stopped)


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
    """A drive that, without a command, left *operation enabled* or stopped following; `status` is its statusword."""

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
        return cia402.CONTROLWORD_QUICK_STOP if holds else cia402.CONTROLWORD_DISABLE_VOLTAGE


@dataclass(slots=True)
class _EnabledJoint:
    """Counts, by reported state, a joint's answers since the command that enables its drive."""

    enabled_syncs: int = 0
    disabled_syncs: int = 0
    following_syncs: int = 0
    not_following_syncs: int = 0

    def update(self, status: int, command: Setpoint) -> bool:
        if command.controlword != cia402.CONTROLWORD_ENABLE_OPERATION:
            self.enabled_syncs = self.disabled_syncs = 0
            self.following_syncs = self.not_following_syncs = 0
            return False
        if state_of(status) is not DriveState.OPERATION_ENABLED:
            self.following_syncs = self.not_following_syncs = 0
            self.disabled_syncs += self.enabled_syncs > 0
            was_enabled = self.enabled_syncs >= CONFIRMED_SYNCS
            return was_enabled or self.disabled_syncs >= DROPOUT_SYNCS
        self.enabled_syncs, self.disabled_syncs = self.enabled_syncs + 1, 0
        if command.mode is not JointMode.POSITION:
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
    """Checks every sample for dropouts, and keeps the dropouts until `reset`."""

    def __init__(self) -> None:
        self._dropouts: dict[int, Dropout] = {}
        self._joints: tuple[_EnabledJoint, ...] = ()

    @property
    def dropouts(self) -> tuple[Dropout, ...]:
        """Dropouts so far, the most likely cause first."""
        return tuple(sorted(self._dropouts.values(), key=_priority))

    def command(self, joint: int, command: Setpoint) -> Setpoint | None:
        """Return the command to send: `command` or, after a dropout, one that does not enable the joint's drive.

        Returns None (send nothing) while a dropout of this joint is suspected, since `command` might enable the drive.
        """
        if command.controlword != cia402.CONTROLWORD_ENABLE_OPERATION:
            return command
        if not self._dropouts:
            suspected = bool(self._joints) and self._joints[joint - 1].disabled_syncs > 0
            return None if suspected else command
        dropout = self._dropouts.get(joint)
        word = cia402.CONTROLWORD_QUICK_STOP if dropout is None else dropout.controlword
        return Setpoint(word, command.target_counts, command.mode)

    def update(self, sample: Sample, commands: Setpoints | None, *, stopped: bool) -> None:
        """Look for dropouts in a sample, unless STOP is latched (`stopped`). `commands`: the commands sent last."""
        if commands is None or stopped:
            self._joints = ()
            return
        if not self._joints:
            self._joints = tuple(_EnabledJoint() for _ in commands)
        if not self._dropouts:  # afterwards the other drives stop on command
            self._dropouts = {each.joint: each for each in self._find(sample, commands)}

    def reset(self) -> None:
        """Clear the dropouts; called when the operator resets the drives."""
        self._dropouts = {}
        self._joints = ()

    def _find(self, sample: Sample, commands: Setpoints) -> Iterator[Dropout]:
        joints = zip(self._joints, sample.statuswords, commands, strict=True)
        for number, (joint, status, command) in enumerate(joints, 1):
            if number not in sample.missing and joint.update(status, command):
                yield Dropout(joint=number, status=status, sync_count=sample.sync_count)


def _priority(dropout: Dropout) -> int:
    """Return 0 for a likely cause of other dropouts (a drive in fault), 2 for a likely effect (quick stop), else 1."""
    if dropout.state in cia402.FAULT_STATES:
        return 0
    return 2 if dropout.state is DriveState.QUICK_STOP_ACTIVE else 1
