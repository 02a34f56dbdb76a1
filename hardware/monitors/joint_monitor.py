"""Monitors of every sample, e.g. for count loss.

Position is smooth from SYNC to SYNC: the increment of one period can be predicted from the two increments before and
the two after. A single outlying increment in one joint alone, with no other outlier shortly before or after, is neither
noise nor motion, because no joint of a closed chain moves alone: counts were lost or a coupling slipped.
"""

from collections import deque
from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace

import numpy as np

from hardware.arm import DriveState
from hardware.arm_description import JointScale
from hardware.canopen.cia402 import state_of
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.monitors.following import Divergence, DropoutMonitor, FollowingMonitor

WINDOW_SAMPLES = 6
"""Consecutive samples used; the increment tested is the middle one."""
ENCODER_COUNTS = 4.0
"""Jump threshold of encoders at rest. Rounding of the six readings changes the tested value by less than 3 counts."""
RVDT_COUNTS = 64.0
"""Jump threshold of RVDTs at rest: 1.9 deg with 12 bits over 120 deg. With two counts of noise, the threshold is
12 sigma of the tested value."""
COUPLED_FRACTION, COUPLED_NOISE = 0.1, 0.6
"""A real jerk moves another joint by more than COUPLED_FRACTION of the jump plus COUPLED_NOISE of that joint's
threshold."""
MOTION_FACTOR = 6.0
"""Ratio of the jump threshold in motion to that at rest; it is above 1 because targets arrive with some jitter."""
JERK_SYNCS = 15
"""Jumps are not detected for this many SYNCs after a drive is enabled or changes its mode: its joint may jerk."""
QUIET_SYNCS, ECHO_SYNCS = 10, 2
"""A jump is confirmed only if the joint has no other outlier within QUIET_SYNCS of it. Outliers within ECHO_SYNCS do
not count, because the jump itself causes them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CountJump:
    """A joint's reading changed by `counts` more than its motion explains, at `sync_count`."""

    joint: int
    counts: int
    sync_count: int


class ContinuityMonitor:
    """Detects count jumps; `allowed_counts` is each joint's threshold at rest."""

    def __init__(self, allowed_counts: Sequence[float]) -> None:
        self._allowed = tuple(allowed_counts)
        self._recent: deque[tuple[int, ...]] = deque(maxlen=WINDOW_SAMPLES)
        self._last_sync = -1
        self._states: tuple[DriveState, ...] = ()
        self._outlier_syncs = [deque[int](maxlen=2 * QUIET_SYNCS) for _ in self._allowed]
        self._candidate: CountJump | None = None
        self._jerk_syncs_left = 0

    def expect_jerk(self) -> None:
        """Ignore jumps for `JERK_SYNCS`; call when a drive is enabled, changes mode or gets a target outside a move."""
        self._jerk_syncs_left = JERK_SYNCS
        self._candidate = None

    def update(self, sample: Sample, *, answered_late: bool = False) -> CountJump | None:
        """Take in a sample; return a jump once it is confirmed, `QUIET_SYNCS` SYNCs after the jump.

        `answered_late`: the previous sample may hold answers to an earlier SYNC.
        """
        recent = self._recent
        follows_last = sample.sync_count == self._last_sync + 1 and not answered_late
        states = tuple(map(state_of, sample.statuswords))  # other bits may change with every answer
        if not (sample.complete and follows_last and states == self._states):
            recent.clear()
        self._last_sync, self._states = sample.sync_count, states
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
        """Compare joints' increments at SYNC `sync_count` with predicted ones; keep a jump for `update` to confirm."""
        allowed = np.array(self._allowed)
        d0, d1, d2, d3, d4 = np.diff(np.array(self._recent), axis=0)
        steps = d2 - (4 * (d1 + d3) - d0 - d4) / 6.0  # minus a cubic through the four others
        sizes = np.abs(steps)
        for outlier in np.flatnonzero(sizes > allowed):
            self._outlier_syncs[outlier].append(sync_count)
        at_rest = all(np.all(np.abs(d) <= allowed) for d in (d0, d1, d3, d4))
        acceleration = np.max(np.abs([d1 - d0, d4 - d3, d3 - d1]), axis=0)
        threshold = allowed if at_rest else MOTION_FACTOR * allowed
        jumps = np.flatnonzero(sizes > threshold + acceleration)
        if len(jumps) != 1 or self._candidate is not None:
            return
        (at,) = jumps.tolist()
        jump = CountJump(joint=at + 1, counts=round(steps[at]), sync_count=sync_count)
        coupled = sizes > COUPLED_NOISE * allowed + COUPLED_FRACTION * abs(jump.counts)
        if np.flatnonzero(coupled).tolist() in ([], [at]):
            self._candidate = jump


class JointMonitor:
    """Checks every sample in the control loop's thread; its attributes may be read from any thread.

    `allowed_counts`: each joint's threshold for count jumps at rest. `divergence`: uncommanded motion in an earlier
    connection for which STOP is still latched; None if there is none.
    """

    def __init__(
        self, allowed_counts: Sequence[float], *, divergence: Divergence | None = None
    ) -> None:
        self.jump: CountJump | None = None
        self.divergence = divergence
        """The first uncommanded motion, which stopped the arm; None if there was none."""
        self.switched_off: frozenset[int] = frozenset()
        """Joints whose drives are switched off after STOP: because of uncommanded motion, or, when the arm is released,
        because they have not obeyed quick stop."""
        self.dropout = DropoutMonitor()
        self.set_following_windows((), ())
        self.continuity = ContinuityMonitor(allowed_counts)

    def set_following_windows(
        self, windows_counts: Sequence[float], scales: Sequence[JointScale]
    ) -> None:
        """Set how far each joint may be from its target or, after a quick stop, from the position where it rests.

        `scales` convert the counts to angles. Call before SYNC starts.
        """
        self._counts_per_rad = tuple(scale.counts_per_rad for scale in scales)
        self.following = FollowingMonitor(windows_counts)

    def update(
        self,
        sample: Sample,
        commands: Setpoints | None,
        *,
        answered_late: bool,
        stopped: bool = False,
        refusing_joints: Collection[int] = (),
    ) -> bool:
        """Take in a sample and the commands sent before it; return whether a joint just diverged.

        `answered_late`: the previous sample may hold answers to earlier SYNCs; `stopped`: STOP is latched;
        `refusing_joints`: joints whose drives have reported a refused target.
        """
        if self.jump is None:
            self.jump = self.continuity.update(sample, answered_late=answered_late)
        self.dropout.update(sample, commands, stopped=stopped)
        before = self.switched_off
        for divergence in self.following.update(sample, commands, refusing_joints):
            if self.divergence is None:
                angle_rad = divergence.counts / self._counts_per_rad[divergence.joint - 1]
                self.divergence = replace(divergence, angle_rad=angle_rad)
            # All of these joints: the drive of the first may not obey.
            self.switched_off |= {divergence.joint}
        return self.switched_off != before

    def reset(self) -> None:
        """Clear all findings."""
        self.jump = self.divergence = None
        self.dropout.reset()
        self.switched_off = frozenset()
