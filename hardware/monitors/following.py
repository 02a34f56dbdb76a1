"""Detects uncommanded motion: joints away from the commanded position, or moving after a quick stop.

A drive checks its following error (6065h) with its own target and sensor. If another program sends targets to the
drive, or the drive's reports are wrong, only this program can detect that, since it has the commands.

A joint is checked from the moment its drive reports that it follows (6041h, bit 12) until its mode changes or the drive
leaves *operation enabled*, even if bit 12 drops. If a drive never sets bit 12, setting its mode fails
(`hardware.control.canopen_arm`). A drive that reports a refused target keeps an earlier one, so its joint may be near
any of the targets sent before the report.
"""

from __future__ import annotations

import math
from collections import deque
from collections.abc import Collection, Iterator, Sequence
from dataclasses import dataclass
from itertools import islice
from typing import Final

from hardware.arm import DriveState
from hardware.canopen.cia402 import StatusBit, state_of
from hardware.canopen.cyclic import MAX_LATE_SYNCS, Sample, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION

DIVERGED_SYNCS: Final = 10
"""Consecutive SYNCs outside the window that show uncommanded motion; a new target or a late frame causes fewer."""
LAG_SYNCS: Final = 20
"""0.2 s: allowed lag of a servo behind its target in motion, in addition to its window."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Divergence:
    """A joint that, since SYNC `sync_count`, is `counts` from its target or, if `stopped`, from its rest position.

    `angle_rad` is the same distance as an angle; None if it is not computed yet.
    """

    joint: int
    counts: int
    sync_count: int
    stopped: bool = False
    angle_rad: float | None = None


class FollowingMonitor:
    """Compares samples with commands; `windows_counts` has each joint's window (empty: no check).

    A joint may leave the range of its latest targets by no more than its window. The latest targets are those of
    `LAG_SYNCS` SYNCs, plus one more for each SYNC that the joint has not answered yet.
    """

    def __init__(self, windows_counts: Sequence[float] = ()) -> None:
        self._windows = tuple(windows_counts)
        self._outside_syncs = [0] * len(self._windows)
        self._followed = [False] * len(self._windows)
        longest = 1 + LAG_SYNCS + MAX_LATE_SYNCS
        self._targets = tuple(deque[int](maxlen=longest) for _ in self._windows)  # newest first

    def update(
        self, sample: Sample, commands: Setpoints | None, refusing_joints: Collection[int] = ()
    ) -> tuple[Divergence, ...]:
        """Take in a sample and the commands sent before it; return the divergences of joints that do not follow.

        `refusing_joints`: joints whose drives report a refused target.
        """
        return () if commands is None else tuple(self._find(sample, commands, refusing_joints))

    def away(self, sample: Sample, commands: Setpoints) -> tuple[int, ...]:
        """Return the joints in position mode that are outside their windows, or did not answer."""
        errors = zip(sample.counts, commands, self._windows, strict=False)  # no windows: no joint
        return tuple(
            joint
            for joint, (counts, command, window) in enumerate(errors, 1)
            if command.mode == CYCLIC_POSITION
            and (joint in sample.missing or abs(counts - command.target_counts) > window)
        )

    def _find(
        self, sample: Sample, commands: Setpoints, refusing_joints: Collection[int]
    ) -> Iterator[Divergence]:
        for at, window in enumerate(self._windows):
            command, status, targets = commands[at], sample.statuswords[at], self._targets[at]
            if command.mode != CYCLIC_POSITION:
                targets.clear()
                self._outside_syncs[at], self._followed[at] = 0, False
                continue
            if at + 1 not in refusing_joints or not targets:
                targets.appendleft(command.target_counts)
            if at + 1 in sample.missing:
                continue
            follows = bool(status & StatusBit.FOLLOWS_COMMAND) or self._followed[at]
            self._followed[at] = follows and state_of(status) is DriveState.OPERATION_ENABLED
            counts = sample.counts[at]
            error = counts - command.target_counts
            outside = self._followed[at] and abs(error) > window
            if outside:  # outside the range of earlier targets too?
                overdue = sample.overdue[at] if sample.overdue else 0
                recent = tuple(islice(targets, 1 + LAG_SYNCS + overdue))
                outside = not min(recent) - window <= counts <= max(recent) + window
            self._outside_syncs[at] = self._outside_syncs[at] + 1 if outside else 0
            if self._outside_syncs[at] >= DIVERGED_SYNCS:
                since = sample.sync_count - self._outside_syncs[at] + 1
                yield Divergence(joint=at + 1, counts=error, sync_count=since)


MIN_BRAKING_SYNCS: Final = 30
"""0.3 s: time allowed for every stopped joint to come to rest."""
MAX_BRAKING_SYNCS: Final = 200
"""2 s: time allowed to a joint that keeps slowing down; the deceleration (6085h) is the drive maker's choice."""
STRETCH_SYNCS: Final = 10
"""Length of the successive intervals after a stop. A joint brakes as long as its displacement decreases from one
interval to the next."""


@dataclass(slots=True)
class _Joint:
    """State of a joint after a stop; `last_travel_counts` is its displacement in the previous interval."""

    stopped_syncs: int = 0
    rest_counts: int = 0
    outside_syncs: int = 0
    at_rest: bool = False
    stretch_start_counts: int = 0
    last_travel_counts: float = math.inf

    def brake(self, counts: int) -> None:
        """Take in a position of the braking joint, which counts as at rest once it no longer slows down."""
        if self.stopped_syncs == 0:
            self.at_rest = False
            self.stretch_start_counts, self.last_travel_counts = counts, math.inf
        self.stopped_syncs += 1
        self.rest_counts = counts
        if self.stopped_syncs % STRETCH_SYNCS:
            return
        travel = abs(counts - self.stretch_start_counts)
        slowing = 0 < travel < self.last_travel_counts and self.stopped_syncs < MAX_BRAKING_SYNCS
        self.at_rest = self.stopped_syncs >= MIN_BRAKING_SYNCS and not slowing
        self.stretch_start_counts, self.last_travel_counts = counts, travel


class StandstillMonitor:
    """Checks every sample after a quick stop; `windows_counts` limits each joint's distance from its rest position.

    If `windows_counts` is empty, nothing is checked. A stopped drive holds at a target of its own, which this program
    does not know, so the reference is the position where the joint came to rest. Joints in free mode are not checked,
    nor drives that report no power after a quick stop (605Ah below 5).
    """

    def __init__(self, windows_counts: Sequence[float] = ()) -> None:
        self._windows = tuple(windows_counts)
        self._joints = tuple(_Joint() for _ in self._windows)

    def update(self, sample: Sample, commands: Setpoints | None) -> tuple[Divergence, ...]:
        """Take in a sample and the commands sent last; return the divergences of the joints that moved."""
        return () if commands is None else tuple(self._find(sample, commands))

    def _find(self, sample: Sample, commands: Setpoints) -> Iterator[Divergence]:
        for at, (joint, window) in enumerate(zip(self._joints, self._windows, strict=True)):
            stopped = state_of(sample.statuswords[at]) is DriveState.QUICK_STOP_ACTIVE
            if not stopped or commands[at].mode != CYCLIC_POSITION:
                joint.stopped_syncs = joint.outside_syncs = 0
                continue
            if at + 1 in sample.missing:
                continue
            counts = sample.counts[at]
            if joint.stopped_syncs == 0 or not joint.at_rest:
                joint.brake(counts)
                continue
            displacement = counts - joint.rest_counts
            joint.outside_syncs = joint.outside_syncs + 1 if abs(displacement) > window else 0
            if joint.outside_syncs >= DIVERGED_SYNCS:
                since = sample.sync_count - joint.outside_syncs + 1
                yield Divergence(joint=at + 1, counts=displacement, sync_count=since, stopped=True)
