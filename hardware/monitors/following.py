"""Is each joint where it was told to be? Looked at with every sample. Knows no bus, no clock and no arm.

A drive watches its own following error (6065h) by its own target and its own sensor. When somebody else
gives it targets, or it does not do what it says, that sees nothing; the operator, who knows what was
commanded, does.

A drive that has said that it follows (bit 12) is held to its target from then on, until it is told another mode or
leaves *operation enabled*: to say no more that it follows, and go elsewhere, is no excuse. Before, as it changes
modes, it goes by no target yet; one that never says so is given no mode (`hardware.control.steps`).
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass
from typing import Final

from hardware.arm import DriveState
from hardware.canopen.cia402 import StatusBit, shows
from hardware.canopen.cyclic import LATE_SYNCS, Sample, Setpoints
from hardware.canopen.objects import CYCLIC_POSITION

AWAY_SYNCS: Final = 10
"""So many SYNCs in a row: a target that was just sent, or a frame that came late, is no error."""

_NOWHERE: Final = (math.inf, -math.inf)


@dataclass(frozen=True, slots=True, kw_only=True)
class Astray:
    """A joint that is `counts` from its target, since the answer to a SYNC; of a `stopped` one, from where it stood."""

    joint: int
    counts: int
    sync_count: int
    stopped: bool = False


class Following:
    """Looks at every sample.

    Parameters
    ----------
    windows_counts
        By joint: how far from its target it may be; empty: nothing is looked at.
    """

    def __init__(self, windows_counts: Sequence[float] = ()) -> None:
        self._windows = tuple(windows_counts)
        self._away = [0] * len(self._windows)
        self._followed = [False] * len(self._windows)
        # Lowest and highest target of each joint, in this stretch of SYNCs and in the one before: an answer
        # that comes late says where the joint was then.
        self._told = [_NOWHERE] * len(self._windows)
        self._told_before = list(self._told)
        self._stretch = 0

    def see(self, sample: Sample, commands: Setpoints | None) -> Astray | None:
        """Take in a sample and the commands that were sent before it; the joint that is astray, if one is."""
        if commands is None:
            return None
        self._stretch += 1
        if self._stretch == LATE_SYNCS:
            self._stretch = 0
            self._told_before, self._told = self._told, [_NOWHERE] * len(self._windows)
        for at, window in enumerate(self._windows):
            command, status = commands[at], sample.statuswords[at]
            if command.mode != CYCLIC_POSITION:
                self._told[at] = self._told_before[at] = _NOWHERE
                self._away[at], self._followed[at] = 0, False
                continue
            target, (low, high) = command.target_counts, self._told[at]
            if not low <= target <= high:
                low, high = self._told[at] = (min(low, target), max(high, target))
            if not sample.complete:
                continue
            lower, higher = self._told_before[at]
            counts = sample.counts[at]
            error = min(counts - min(low, lower), 0) or max(counts - max(high, higher), 0)
            follows = bool(status & StatusBit.FOLLOWS_COMMAND) or self._followed[at]
            self._followed[at] = follows and shows(status, DriveState.OPERATION_ENABLED)
            away = self._followed[at] and abs(error) > window
            self._away[at] = self._away[at] + 1 if away else 0
            if self._away[at] >= AWAY_SYNCS:
                since = sample.sync_count - self._away[at] + 1
                return Astray(joint=at + 1, counts=round(error), sync_count=since)
        return None
