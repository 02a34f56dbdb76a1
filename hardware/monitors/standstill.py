"""Detects motion of joints after a quick stop from any source.

After a quick stop a drive holds its own target, which the operator does not know, so the reference is the
position where the joint came to rest. A drive whose quick stop ends without power (605Ah below 5) reports
that in its state and is not checked; neither is a joint in free mode, which the others may move.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hardware.arm import DriveState
from hardware.canopen.cia402 import shows
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION
from hardware.monitors.following import DIVERGED_SYNCS, Divergence

MIN_BRAKING_SYNCS: Final = 30
"""0.3 s: time that every stopped joint has to come to rest."""
MAX_BRAKING_SYNCS: Final = 200
"""2 s: limit while it keeps slowing down; the deceleration (6085h) is the drive maker's choice."""
STRETCH_SYNCS: Final = 10
"""Travel is compared between consecutive stretches of this length; a constant creep is no braking."""


@dataclass(slots=True)
class _Joint:
    """SYNCs since the stop, rest position, SYNCs away from it; before rest, the present stretch."""

    stopped_syncs: int = 0
    rest_counts: int = 0
    outside_syncs: int = 0
    at_rest: bool = False
    stretch_start_counts: int = 0
    last_travel_counts: float = math.inf

    def brake(self, counts: int) -> None:
        """Take in a position before rest; the joint is at rest once it no longer slows down."""
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
    """Checks every sample; `windows_counts` is each joint's limit from rest, empty for no check."""

    def __init__(self, windows_counts: Sequence[float] = ()) -> None:
        self._windows = tuple(windows_counts)
        self._joints = tuple(_Joint() for _ in self._windows)

    def update(self, sample: Sample, commands: Setpoints | None) -> Divergence | None:
        """Take in a sample and the commands sent last; return the first joint that moved."""
        if commands is None:
            return None
        found = None
        for at, (joint, window) in enumerate(zip(self._joints, self._windows, strict=True)):
            stopped = shows(sample.statuswords[at], DriveState.QUICK_STOP_ACTIVE)
            if not stopped or commands[at].mode != CYCLIC_POSITION:
                joint.stopped_syncs = joint.outside_syncs = 0
                continue
            if at + 1 in sample.missing:
                continue
            counts = sample.counts[at]
            if joint.stopped_syncs == 0 or not joint.at_rest:
                joint.brake(counts)
                continue
            moved = counts - joint.rest_counts
            joint.outside_syncs = joint.outside_syncs + 1 if abs(moved) > window else 0
            if joint.outside_syncs >= DIVERGED_SYNCS and found is None:
                since = sample.sync_count - joint.outside_syncs + 1
                found = Divergence(joint=at + 1, counts=moved, sync_count=since, stopped=True)
        return found
