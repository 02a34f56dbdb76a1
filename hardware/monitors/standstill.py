"""Does a joint stand that was stopped? Looked at with every sample, pressed by whomever. Knows no bus and no clock.

After a quick stop a drive holds by its own target, of which the operator knows nothing: what it stands at
once it has had time to come to rest is what it is held to. A drive whose quick stop ends without power
(605Ah below 5) says so in its state, and holds nothing; a joint in free mode may be moved by the others.
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
from hardware.monitors.following import AWAY_SYNCS, Astray

REST_SYNCS: Final = 30
"""0.3 s: a joint that was stopped has this to come to rest, however it goes."""
LONGEST_REST_SYNCS: Final = 200
"""2 s: and this for as long as it becomes slower. How steep its drive brakes (6085h) is its maker's affair."""
STRETCH_SYNCS: Final = 10
"""Whether it does is looked at from one such stretch to the next. One that creeps on does not."""


@dataclass(slots=True)
class _Joint:
    """How long it has been stopped, what it stands at, and since how many SYNCs it is elsewhere.

    Until it `stands`: where the present stretch of SYNCs began, and how far it went in the one before.
    """

    stopped: int = 0
    stood_at: int = 0
    away: int = 0
    stands: bool = False
    began_at: int = 0
    went: float = math.inf

    def come_to_rest(self, counts: int) -> None:
        """Take in where it is on its way to rest; what it stands at is known when it does not brake any more."""
        if self.stopped == 0:
            self.stands, self.began_at, self.went = False, counts, math.inf
        self.stopped += 1
        self.stood_at = counts
        if self.stopped % STRETCH_SYNCS:
            return
        went = abs(counts - self.began_at)
        brakes = 0 < went < self.went and self.stopped < LONGEST_REST_SYNCS
        self.stands = self.stopped >= REST_SYNCS and not brakes
        self.began_at, self.went = counts, went


class StandstillMonitor:
    """Looks at every sample.

    Parameters
    ----------
    windows_counts
        By joint: how far it may go from where it came to rest; empty: nothing is looked at.
    """

    def __init__(self, windows_counts: Sequence[float] = ()) -> None:
        self._windows = tuple(windows_counts)
        self._joints = tuple(_Joint() for _ in self._windows)

    def see(self, sample: Sample, commands: Setpoints | None) -> Astray | None:
        """Take in a sample and the commands sent last; the first joint that does not stand, if one does not."""
        if commands is None:
            return None
        found = None
        for at, (joint, window) in enumerate(zip(self._joints, self._windows, strict=True)):
            stopped = shows(sample.statuswords[at], DriveState.QUICK_STOP_ACTIVE)
            if not stopped or commands[at].mode != CYCLIC_POSITION:
                joint.stopped = joint.away = 0
                continue
            if at + 1 in sample.missing:
                continue
            counts = sample.counts[at]
            if joint.stopped == 0 or not joint.stands:
                joint.come_to_rest(counts)
                continue
            moved = counts - joint.stood_at
            joint.away = joint.away + 1 if abs(moved) > window else 0
            if joint.away >= AWAY_SYNCS and found is None:
                since = sample.sync_count - joint.away + 1
                found = Astray(joint=at + 1, counts=moved, sync_count=since, stopped=True)
        return found
