"""Supervision of the arm, every 50 ms, whether or not a screen polls.

Checks the age of the data, the joint motion, stops of the arm, host latency, and whether a screen polls while the arm
moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from hardware.arm import DriveState
from operator_app.messages.errors import stopped_words
from operator_app.session.safety.joint_motion import MotionMonitor
from operator_app.session.safety.latency import LatenessReporter
from operator_app.session.ui.message_log import ARM_RECOVERY
from operator_app.session.ui.snapshot import (
    LOST_S,
    DataState,
    Level,
    SessionSnapshot,
    StopReport,
)

if TYPE_CHECKING:
    from operator_app.session.ui.runner import Runner

UNWATCHED_S = 1.5
"""A motion is ended when no screen has polled for this long: no key could stop it."""


class Supervisor:
    """Checks one snapshot after the other.

    Attributes
    ----------
    told_of_stop
        Last reported reason why the arm stopped by itself; "" if it is not stopped.
    """

    def __init__(
        self,
        runner: Runner,
        motion: MotionMonitor,
        recording_ended: Callable[[], str],
        monotonic: Callable[[], float],
    ) -> None:
        self._runner, self._motion, self._monotonic = runner, motion, monotonic
        self._recording_ended, self._recording_reported = recording_ended, ""
        self._lateness = LatenessReporter()
        self._lost = False
        self.reported_stop = ""

    def check(self, now: SessionSnapshot, *, unseen_s: float) -> None:
        """Check a snapshot: lost data stop the arm; `unseen_s` without a poll ends a motion."""
        self._end_unwatched_motion(now, unseen_s)
        self._report_stop(now)
        self._update_motion(now)
        if news := self.recording_problem():
            self._runner.say(Level.WARNING, news)
        if now.arm is None:
            self._lateness = LatenessReporter()
        elif late := self._lateness.new_text(now.arm.lateness, now.now_s):
            self._runner.say(Level.WARNING, late)
        if now.arm is not None and now.stop is not None:
            self._count_stopped(now, now.stop)
        if now.identity is None:
            self._lost = False
        # While connecting there are no data yet, and a STOP would end it.
        if now.data is DataState.LOST and not self._lost and not self._runner.connecting:
            self._lost = True
            sent = "quick stop sent" if self._runner.stop_quietly() else "quick stop NOT sent"
            who = "no data from the arm", "Check the bus and the controller"
            if now.arm is not None and now.oldest_s - now.arm.late_s <= LOST_S:
                who = "this program did not read the bus", "End other programs"
            self._runner.say(
                Level.ALARM,
                f"{who[0]} for {now.oldest_s:.1f} s: {sent}, the drives hold by themselves. {who[1]}",
                ARM_RECOVERY,
            )
        elif self._lost and _all_data_fresh(now):
            self._lost = False
            self._runner.say(Level.INFO, "the data are back: reset STOP (R) when it is safe")

    def _report_stop(self, now: SessionSnapshot) -> None:
        """Report and record why the arm stopped by itself."""
        why, before = now.stopped_for, self.reported_stop
        self.reported_stop = why
        if why and why != before:
            self._runner.say(Level.ALARM, stopped_words(why), ARM_RECOVERY)
            self._runner.record_why_stopped()

    def _update_motion(self, now: SessionSnapshot) -> None:
        if now.arm is not None and now.data is DataState.FRESH:
            motion = self._motion.update(now.now_s, now.arm)
            self._runner.publish(lambda s: replace(s, motion=motion))
        elif now.motion is not None:
            self._motion.reset()
            self._runner.publish(lambda s: replace(s, motion=None))

    def recording_problem(self) -> str:
        """Return why a recording of the bus ended early; "" if it did not, or was reported already."""
        words, add_message = self._recording_ended(), self._recording_reported
        self._recording_reported = words
        return "" if words == add_message else words[:1].upper() + words[1:]

    def _end_unwatched_motion(self, now: SessionSnapshot, unseen_s: float) -> None:
        """End a motion when no screen polls: a key could not stop it."""
        if (
            now.task is not None
            and now.task.moves
            and unseen_s > UNWATCHED_S
            and not self._runner.cancelled()
        ):
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
            acknowledged_after_s=self._monotonic() - report.asked_s if done else None,
        )
        # A newer STOP or a reset may have replaced the report meanwhile.
        self._runner.publish(lambda s: replace(s, stop=counted) if s.stop is report else s)


def _all_data_fresh(s: SessionSnapshot) -> bool:
    """Whether all joint data and heartbeats are fresh: a reset needs both."""
    return (
        s.data is DataState.FRESH
        and s.arm is not None
        and max(s.arm.heartbeat_age_s.values(), default=0.0) < LOST_S
    )
