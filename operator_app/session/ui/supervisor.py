"""Supervises the arm every 50 ms, whether or not a screen polls.

Checks the age of the data, the joint motion, stops of the arm, host latency, and whether a screen polls while the arm
moves.
"""

from __future__ import annotations

from collections import deque
from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import TYPE_CHECKING

import numpy as np

from hardware.arm import NO_LATENCY, ArmSnapshot, DriveState, HostLatency
from operator_app.config.procedure import CapturePlan
from operator_app.messages.errors import lateness_words, stopped_words, unstopped_words
from operator_app.session.ui.snapshot import (
    ARM_RECOVERY,
    LOST_S,
    DataState,
    Level,
    SessionSnapshot,
    StopReport,
    TaskKind,
)
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel

if TYPE_CHECKING:
    from operator_app.session.ui.runner import Runner


SPEED_WINDOW_S = 0.5
RATE_WINDOW_S = 1.0
MIN_SAMPLES = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class Motion:
    """Motion of the joints, for display only (the arm itself checks standstill).

    `speed_rad_per_s` (n,): slopes of straight lines fitted to the measured angles of the last 0.5 s.
    `still`: whether the spread of each joint's readings is within the limit of the procedure's `SettleRule`.
    `held_s`: time at standstill so far. `needed_s`: time at standstill that capturing a pose requires.
    `worst_joint`: joint (1-based) with the largest ratio of spread to limit. `spread_share`: this ratio.
    """

    sync_rate_hz: float
    speed_rad_per_s: FloatArray
    still: bool
    held_s: float
    needed_s: float
    worst_joint: int
    spread_share: float


class MotionMonitor:
    """Computes `Motion` from the arm's snapshots with the settle rule of `capture`. Not thread-safe."""

    def __init__(self, arm: ArmModel, capture: CapturePlan) -> None:
        self._allowed = np.array(capture.settle.spread_rad(arm))
        self._window = capture.settle.window_syncs
        self._needed = self._window + capture.samples_per_pose
        self._samples: deque[tuple[float, int, FloatArray]] = deque()
        self._still_since_s: float | None = None

    def reset(self) -> None:
        """Discard all samples; to be called after a gap in the data."""
        self._samples.clear()
        self._still_since_s = None

    def update(self, now_s: float, arm: ArmSnapshot) -> Motion:
        """Add a snapshot and return the joints' motion."""
        samples = self._samples
        samples.append((now_s, arm.sync_count, arm.positions_rad))
        while now_s - samples[0][0] > RATE_WINDOW_S:
            samples.popleft()
        elapsed = now_s - samples[0][0]
        rate = (arm.sync_count - samples[0][1]) / elapsed if elapsed > 0.0 else 0.0
        # At least four samples: with a fast SYNC, the settle window may contain only one sample, which has no spread.
        late = [q for _, sync, q in samples if arm.sync_count - sync < self._window]
        recent = np.array(
            late if len(late) >= MIN_SAMPLES else [q for _, _, q in samples][-MIN_SAMPLES:]
        )
        share = np.ptp(recent, axis=0) / self._allowed
        worst = int(np.argmax(share))
        still = bool(share[worst] <= 1.0)
        if not still:
            self._still_since_s = None
        elif self._still_since_s is None:
            self._still_since_s = now_s
        return Motion(
            sync_rate_hz=rate,
            speed_rad_per_s=self._speeds(now_s),
            still=still,
            held_s=0.0 if self._still_since_s is None else now_s - self._still_since_s,
            needed_s=self._needed / rate if rate > 0.0 else 0.0,
            worst_joint=worst + 1,
            spread_share=float(share[worst]),
        )

    def _speeds(self, now_s: float) -> FloatArray:
        late = [(t, q) for t, _, q in self._samples if now_s - t <= SPEED_WINDOW_S]
        t = np.array([t for t, _ in late])
        q = np.array([q for _, q in late])
        t = t - t.mean()
        square = float(t @ t)
        return t @ (q - q.mean(axis=0)) / square if square > 0.0 else np.zeros(q.shape[1])


LATENESS_INTERVAL_S = 30.0
"""Shortest time between two messages about host latency."""


class LatenessReporter:
    """Returns messages about new delays of this computer (host latency) during one connection to the arm."""

    def __init__(self) -> None:
        self._reported = NO_LATENCY
        self._reported_at_s = -LATENESS_INTERVAL_S

    def new_text(self, lateness: HostLatency, now_s: float) -> str:
        """Return a message about new delays; "" if there are none, or the last message is too recent."""
        new = lateness.times - self._reported.times
        if new == 0 or now_s - self._reported_at_s < LATENESS_INTERVAL_S:
            return ""
        self._reported, self._reported_at_s = lateness, now_s
        return lateness_words(lateness, new)


UNSTOPPED_S = 0.5
"""A drive that is still enabled this long after STOP has not obeyed it."""
UNWATCHED_S = 1.5
"""A motion is ended if no screen has polled for this long, since no key could stop the motion."""


class Supervisor:
    """Checks successive snapshots: raises alarms and, if necessary, stops the arm.

    `reported_stop`: why the arm stopped by itself, according to the last snapshot; "" if it did not.
    """

    def __init__(self, runner: Runner, monotonic: Callable[[], float]) -> None:
        self._runner, self._monotonic, session = runner, monotonic, runner.session
        self._motion = MotionMonitor(session.model, session.procedure.capture)
        self._recording_reported = ""
        self._lateness = LatenessReporter()
        self._lost = False
        self._stopped_at_s: float | None = None
        self.reported_stop = ""

    def check(self, now: SessionSnapshot, *, unseen_s: float) -> None:
        """Check a snapshot: stop the arm if its data are lost; end a motion if no screen polls for `UNWATCHED_S`.

        `unseen_s`: time, s, since a screen last asked for a snapshot (polled).
        """
        self._end_unwatched_motion(now, unseen_s)
        self._report_stop(now)
        self._update_motion(now)
        if problem := self.recording_problem():
            self._runner.say(Level.WARNING, problem)
        if now.arm is None:
            self._lateness = LatenessReporter()
        elif late := self._lateness.new_text(now.arm.lateness, now.now_s):
            self._runner.say(Level.WARNING, late)
        if now.stop is not None:
            self._count_stopped(now, now.stop)
        self._find_unstopped(now)
        if now.identity is None:
            self._lost = False
        # While connecting, there are no data yet, and a STOP would end the connecting.
        if now.data is DataState.LOST and not self._lost and not self._runner.connecting:
            self._lost = True
            sent = "quick stop sent" if self._runner.send_quick_stop() else "quick stop NOT sent"
            cause, remedy = "no data from the arm", "Check the bus and the controller"
            if now.arm is not None and now.oldest_s - now.arm.late_s <= LOST_S:
                cause, remedy = "this program did not read the bus", "End other programs"
            self._runner.say(
                Level.ALARM,
                f"{cause} for {now.oldest_s:.1f} s: {sent}; the arm's state is not known: look before you "
                f"go near. {remedy}",
                ARM_RECOVERY,
            )
        elif (
            self._lost
            and now.data is DataState.FRESH
            and now.arm is not None
            # A reset requires fresh heartbeats of all nodes.
            and max(now.arm.heartbeat_age_s.values(), default=0.0) < LOST_S
        ):
            self._lost = False
            self._runner.say(Level.INFO, "the data are back: reset STOP (R) when it is safe")

    def _report_stop(self, now: SessionSnapshot) -> None:
        reason, before = now.stopped_for, self.reported_stop
        self.reported_stop = reason
        if reason and reason != before:
            self._runner.say(Level.ALARM, stopped_words(reason), ARM_RECOVERY)
            self._runner.submit(
                TaskKind.NOTE,
                "recording why the arm was stopped",
                self._runner.session.reader.sensor_faults.record_stop_cause,
                uncancellable=True,
            )

    def _update_motion(self, now: SessionSnapshot) -> None:
        if now.arm is not None and now.data is DataState.FRESH:
            motion = self._motion.update(now.now_s, now.arm)
            self._runner.publish(lambda s: replace(s, motion=motion))
        elif now.motion is not None:
            self._motion.reset()
            self._runner.publish(lambda s: replace(s, motion=None))

    def recording_problem(self) -> str:
        """Return why a recording of the bus ended early; "" if it did not, or if that was already reported."""
        problem, before = self._runner.session.rig.recording_ended(), self._recording_reported
        self._recording_reported = problem
        return "" if problem == before else problem[:1].upper() + problem[1:]

    def _end_unwatched_motion(self, now: SessionSnapshot, unseen_s: float) -> None:
        moves = now.task is not None and now.task.moves
        if moves and unseen_s > UNWATCHED_S and not self._runner.cancelled():
            self._runner.cancel()
            self._runner.say(
                Level.ALARM,
                f"the screen did not respond for {unseen_s:.1f} s while the arm moved: the motion was "
                "ended. Check the terminal and its connection",
            )

    def _count_stopped(self, now: SessionSnapshot, report: StopReport) -> None:
        if now.arm is None or report.acknowledged_after_s is not None or not now.arm.stopped:
            return
        resting = sum(j.drive is not DriveState.OPERATION_ENABLED for j in now.arm.joints)
        done = resting == len(now.arm.joints)
        counted = replace(
            report,
            drives_stopped=resting,
            # Read after the drives' states: the time shown is never too short.
            acknowledged_after_s=self._monotonic() - report.asked_s if done else None,
        )
        # A newer STOP or a reset may have replaced the report in the meantime.
        self._runner.publish(lambda s: replace(s, stop=counted) if s.stop is report else s)

    def _find_unstopped(self, now: SessionSnapshot) -> None:
        """Raise an alarm for joints whose drives report, `UNSTOPPED_S` after STOP, that they are still enabled."""
        found: tuple[int, ...] = ()
        if now.arm is None or not now.arm.stopped:
            self._stopped_at_s = None
        elif self._stopped_at_s is None:
            self._stopped_at_s = now.now_s
        else:
            since_s = now.now_s - self._stopped_at_s
            found = tuple(
                j.joint
                for j in now.arm.joints
                # An older report may have been sent before STOP.
                if j.drive is DriveState.OPERATION_ENABLED and since_s - j.age_s >= UNSTOPPED_S
            )
        if found == now.unstopped_joints:
            return
        self._runner.publish(lambda s: replace(s, unstopped_joints=found))
        if not set(found) <= set(now.unstopped_joints):
            text = f"{unstopped_words(found)} {UNSTOPPED_S:g} s after STOP: use the hardware stop"
            self._runner.say(Level.ALARM, text, ARM_RECOVERY)
