"""Detects count loss in the position samples as it happens.

Position is smooth from SYNC to SYNC: the increment of one period follows from the two before and the two
after it. A single outlying increment in one joint alone, with no other outlier nearby, is neither noise
nor motion, because no joint of a closed chain moves alone: counts were lost or a coupling slipped.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Sequence
from dataclasses import dataclass

from hardware.canopen.cyclic import Sample

WINDOW_SAMPLES = 6
"""Consecutive samples used; the increment tested is the middle one."""
ENCODER_COUNTS = 4.0
"""Threshold at rest. Rounding of six readings gives at most two counts."""
RVDT_COUNTS = 64.0
"""Threshold at rest: 12 times the noise (two converter steps), 1.9 deg for 12 bits over 120 deg."""
COUPLED_FRACTION, COUPLED_NOISE = 0.1, 0.6
"""A real jerk moves another joint by more than this part of the jump plus this part of its own threshold."""
MOTION_FACTOR = 6.0
"""Threshold in motion over that at rest: targets arrive with some jitter."""
JERK_SYNCS = 15
"""After a drive is enabled or its mode changes its joint may jerk for this long: no detection."""
QUIET_SYNCS, ECHO_SYNCS = 10, 2
"""No other outlier may lie within QUIET_SYNCS; the jump itself shows in ECHO_SYNCS around it."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CountJump:
    """A joint's reading changed by `counts` more than its motion explains, at `sync_count`."""

    joint: int
    counts: int
    sync_count: int


class ContinuityMonitor:
    """Tests every sample; `allowed_counts` is each joint's threshold at rest."""

    def __init__(self, allowed_counts: Sequence[float]) -> None:
        self._allowed = tuple(allowed_counts)
        self._recent: deque[tuple[int, ...]] = deque(maxlen=WINDOW_SAMPLES)
        self._last_sync = -1
        self._states: tuple[int, ...] = ()
        self._outlier_syncs: tuple[deque[int], ...] = tuple(
            deque(maxlen=2 * QUIET_SYNCS) for _ in self._allowed
        )
        self._candidate: CountJump | None = None
        self._jerk_syncs_left = 0

    def expect_jerk(self) -> None:
        """Suspend detection: a drive is enabled, changes mode, or gets a target out of turn."""
        self._jerk_syncs_left = JERK_SYNCS
        self._candidate = None

    def restart_history(self) -> None:
        """Discard earlier samples: the last one may hold answers to an earlier SYNC."""
        self._recent.clear()

    def update(self, sample: Sample) -> CountJump | None:
        """Take in a sample; return a jump once it is confirmed, `QUIET_SYNCS` after it happened."""
        recent = self._recent
        if (
            not sample.complete
            or sample.sync_count != self._last_sync + 1
            or sample.statuswords != self._states
        ):
            recent.clear()
        self._last_sync, self._states = sample.sync_count, sample.statuswords
        if self._jerk_syncs_left > 0:
            self._jerk_syncs_left -= 1
            recent.clear()
            return None
        if sample.complete:
            recent.append(sample.counts)
            if len(recent) == WINDOW_SAMPLES:
                before, now, allowed = recent[2], recent[3], self._allowed
                for at, was in enumerate(before):
                    # Cheap first test: most increments are like the one before.
                    if abs(now[at] - 2 * was + recent[1][at]) > allowed[at]:
                        self._test_increment(sample.sync_count - 2)
                        break
        candidate = self._candidate
        if candidate is None or sample.sync_count < candidate.sync_count + QUIET_SYNCS:
            return None
        self._candidate = None
        outliers = self._outlier_syncs[candidate.joint - 1]
        distances = (abs(sync - candidate.sync_count) for sync in outliers)
        return None if any(ECHO_SYNCS < away <= QUIET_SYNCS for away in distances) else candidate

    def _test_increment(self, sync_count: int) -> None:
        """Test the increment that ended with the answer to this SYNC."""
        found: list[CountJump] = []
        relative = []
        at_rest = all(
            abs(a - b) <= allowed
            for one, two in ((0, 1), (1, 2), (3, 4), (4, 5))
            for a, b, allowed in zip(
                self._recent[one], self._recent[two], self._allowed, strict=True
            )
        )
        for at, allowed in enumerate(self._allowed):
            c0, c1, c2, c3, c4, c5 = (counts[at] for counts in self._recent)
            d0, d1, d2, d3, d4 = c1 - c0, c2 - c1, c3 - c2, c4 - c3, c5 - c4
            step = d2 - (4 * (d1 + d3) - d0 - d4) / 6.0  # against a cubic through the four others
            relative.append(abs(step) / allowed)
            if abs(step) > allowed:
                self._outlier_syncs[at].append(sync_count)
            acceleration = max(abs(d1 - d0), abs(d4 - d3), abs(d3 - d1))
            threshold = allowed if at_rest else MOTION_FACTOR * allowed
            if abs(step) > threshold + acceleration:
                found.append(CountJump(joint=at + 1, counts=round(step), sync_count=sync_count))
        if len(found) != 1 or self._candidate is not None:
            return
        (jump,) = found
        for at, (times, allowed) in enumerate(zip(relative, self._allowed, strict=True)):
            if (
                at != jump.joint - 1
                and times > COUPLED_NOISE + COUPLED_FRACTION * abs(jump.counts) / allowed
            ):
                return
        self._candidate = jump
