"""Monitors of every sample, e.g. for count loss, and the alarms that end a command, in order of priority.

Position is smooth from SYNC to SYNC: the increment of one period can be predicted from the two increments before and
the two after. A single outlying increment in one joint alone, with no other outlier shortly before or after, is neither
noise nor motion, because no joint of a closed chain moves alone: counts were lost or a coupling slipped.
"""

from collections import deque
from collections.abc import Collection, Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from types import MappingProxyType

import numpy as np

from hardware import errors
from hardware.arm import DriveState
from hardware.arm_description import JointScale
from hardware.canopen.cia402 import conditions, state_of
from hardware.canopen.cyclic import Sample, Setpoints
from hardware.canopen.objects import OPERATOR_NODE, EmergencyCode
from hardware.monitors.following import (
    Divergence,
    DropoutMonitor,
    FollowingMonitor,
    StandstillMonitor,
)
from hardware.monitors.node_monitor import NodeMonitor

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
        self._standstill = StandstillMonitor(windows_counts)

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
        found = self.following.update(sample, commands, refusing_joints)
        for divergence in (*found, *self._standstill.update(sample, commands)):
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


def stop_error(cause: Divergence | None) -> errors.HardwareError:
    """Return the error for a latched STOP; `cause` is the uncommanded motion that caused STOP, or None."""
    if cause is None:
        return errors.StopLatched("STOP is latched: reset it before anything moves again")
    return errors.DriveDiverged(
        cause.joint,
        cause.counts,
        cause.sync_count,
        stopped=cause.stopped,
        angle_rad=cause.angle_rad,
    )


def _nodes(numbers: Sequence[int]) -> str:
    return f"node{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def alarms(
    nodes: NodeMonitor,
    watch: JointMonitor,
    *,
    stop_latched: bool,
    lost_joints: tuple[int, ...] = (),
    duplicate_joints: tuple[int, ...] = (),
    wrong_lengths: Mapping[int, str] = MappingProxyType({}),
    tripped_joints: tuple[int, ...] = (),
) -> Iterator[errors.HardwareError]:
    """Yield all alarms, highest priority first.

    `lost_joints`: joints that do not answer SYNC; `duplicate_joints`: joints that answer each SYNC twice;
    `wrong_lengths`: description, by joint, of a TPDO that was ignored because of its length; `tripped_joints`: joints
    whose drives are in fault.
    """
    if watch.divergence is not None:  # the cause of a STOP comes before the STOP
        yield stop_error(watch.divergence)
    if stop_latched:
        yield stop_error(None)
    for fault in nodes.faults:
        if fault.joint is None:
            yield errors.Stopped(f"the supervisor reports: {fault.text} ({fault.code:04X}h)")
        elif fault.code == EmergencyCode.REFERENCE_LIMIT:
            yield errors.TargetRefused(f"joint {fault.joint}: {fault.text}")
        else:
            tripped = fault.joint in tripped_joints
            yield errors.DriveFault(fault.joint, fault.code, fault.text, tripped=tripped)
    if nodes.foreign_command:  # before the NMT states, which that program may have changed
        yield errors.OtherMaster(
            f"Another program commands this arm: it sent {nodes.foreign_command}. End that program, check what it "
            "changed, then connect again."
        )
    if down := nodes.not_operational():
        has = "has" if len(down) == 1 else "have"
        yield errors.BusError(
            f"{_nodes(down).capitalize()} {has} left operation, as after a loss of power"
        )
    if nodes.restarted:
        restarted = tuple(sorted(nodes.restarted))
        yield errors.NodeRestarted(restarted, [nodes.profile.who(node) for node in restarted])
    drives = nodes.profile.drives
    if duplicate_joints:
        yield errors.DuplicateNodeId(tuple(drives[j - 1] for j in duplicate_joints))
    if watch.jump is not None:
        yield errors.SensorFault(
            watch.jump.joint,
            f"jumped by {watch.jump.counts:+d} counts between two SYNCs, and no other joint moved: "
            "its sensor lost counts, or its coupling slipped. No pose has been captured since",
            since_sync=watch.jump.sync_count,
        )
    yield from _silence(nodes, lost_joints, wrong_lengths)
    if nodes.other_operator(nodes.heartbeat_timeout_s):
        yield errors.ControlDenied(OPERATOR_NODE)
    for each in watch.dropout.dropouts:  # last: all of the above may be the cause
        yield errors.DriveDropout(
            each.joint,
            each.state.value,
            not_following=each.not_following,
            conditions=conditions(each.status),
        )


def _silence(
    nodes: NodeMonitor, lost_joints: tuple[int, ...], wrong_lengths: Mapping[int, str]
) -> Iterator[errors.BusError]:
    drives = nodes.profile.drives
    if wrong := [
        f"node {drives[j - 1]}: {wrong_lengths[j]}" for j in lost_joints if j in wrong_lengths
    ]:
        yield errors.BusError(
            f"Answers to SYNC are not as the bus profile states: {'; '.join(wrong)}. Compare the drive's map with "
            "the profile (`sarcal probe`); if they agree, its maker must find out why it sends something else."
        )
    unanswered = tuple(drives[j - 1] for j in lost_joints if j not in wrong_lengths)
    silent = (("no heartbeat from", nodes.silent()), ("no answer to SYNC from", unanswered))
    if silence := " and ".join(f"{what} {_nodes(numbers)}" for what, numbers in silent if numbers):
        yield errors.BusError(f"The arm has gone silent: {silence}")
