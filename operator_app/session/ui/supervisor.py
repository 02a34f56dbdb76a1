"""What is said and done at every look at the arm, whether or not a screen looks. Knows no thread and no screen.

The age of the data, what the joints do, why the arm was stopped, how late this computer was, and whether anybody
sees what moves.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from typing import TYPE_CHECKING

from hardware.arm import DriveState
from operator_app.messages.errors import stopped_words
from operator_app.session.safety.joint_motion import MotionWatch
from operator_app.session.safety.latency import LatenessNews
from operator_app.session.ui.message_log import ARM_AGAIN
from operator_app.session.ui.snapshot import (
    LOST_S,
    DataState,
    Level,
    SessionSnapshot,
    StopReport,
)

if TYPE_CHECKING:
    from operator_app.session.ui.runner import Runner

UNSEEN_S = 1.5
"""A motion that nobody has looked at for so long is ended: any key ends a motion, if it is read."""


class Watchman:
    """Looks at one snapshot after the other.

    Attributes
    ----------
    told_of_stop
        What the arm was stopped for by itself, as was said last; "" where it is not.
    """

    def __init__(
        self,
        runner: Runner,
        motion: MotionWatch,
        recording_ended: Callable[[], str],
        monotonic: Callable[[], float],
    ) -> None:
        self._runner, self._motion, self._monotonic = runner, motion, monotonic
        self._recording_ended, self._told_of_recording = recording_ended, ""
        self._lateness = LatenessNews()
        self._lost = False
        self.told_of_stop = ""

    def look(self, now: SessionSnapshot, *, unseen_s: float) -> None:
        """Lost data end the work and stop the arm, and so does nobody looking while it moves."""
        self._end_what_nobody_sees(now, unseen_s)
        self._look_why_stopped(now)
        self._look_at_motion(now)
        if news := self.recording_news():
            self._runner.say(Level.WARNING, news)
        if now.arm is None:
            self._lateness = LatenessNews()  # the next connection counts anew
        elif late := self._lateness.since(now.arm.lateness, now.now_s):
            self._runner.say(Level.WARNING, late)
        if now.arm is not None and now.stop is not None:
            self._count_stopped(now, now.stop)
        if now.identity is None:
            self._lost = False
        # While connecting anew there are none yet, and a STOP would end it.
        if now.data is DataState.LOST and not self._lost and not self._runner.connecting:
            self._lost = True
            sent = "quick stop sent" if self._runner.stop_quietly() else "quick stop NOT sent"
            who = "no data from the arm", "Look at the bus and the controller"
            if now.arm is not None and now.oldest_s - now.arm.late_s <= LOST_S:
                who = "this program did not listen to the arm", "End other programs"
            self._runner.say(
                Level.ALARM,
                f"{who[0]} for {now.oldest_s:.1f} s: {sent}, the drives hold by themselves. {who[1]}",
                ARM_AGAIN,
            )
        elif self._lost and _all_is_heard(now):
            self._lost = False
            self._runner.say(Level.INFO, "the data are back: reset STOP (R) when it is safe")

    def _look_why_stopped(self, now: SessionSnapshot) -> None:
        """An arm may be stopped by itself while nothing is asked of it: say so at once, then keep it."""
        why, before = now.stopped_for, self.told_of_stop
        self.told_of_stop = why
        if why and why != before:
            self._runner.say(Level.ALARM, stopped_words(why), ARM_AGAIN)
            self._runner.note_why_stopped()

    def _look_at_motion(self, now: SessionSnapshot) -> None:
        if now.arm is not None and now.data is DataState.FRESH:
            motion = self._motion.see(now.now_s, now.arm)
            self._runner.publish(lambda s: replace(s, motion=motion))
        elif now.motion is not None:
            self._motion.forget()
            self._runner.publish(lambda s: replace(s, motion=None))

    def recording_news(self) -> str:
        """How a recording of the bus ended early, in words; "" when that was told already, or it did not.

        A full disk ends a recording, and nothing else: the session goes on without it.
        """
        words, told = self._recording_ended(), self._told_of_recording
        self._told_of_recording = words
        return "" if words == told else words[:1].upper() + words[1:]

    def _end_what_nobody_sees(self, now: SessionSnapshot, unseen_s: float) -> None:
        """A screen that hangs, on a terminal that is not read any more, takes no key that stops."""
        if (
            now.task is not None
            and now.task.moves
            and unseen_s > UNSEEN_S
            and not self._runner.cancelled()
        ):
            self._runner.cancel()
            self._runner.say(
                Level.ALARM,
                f"the screen did not answer for {unseen_s:.1f} s while the arm moved: the motion was "
                "ended. Look at the terminal and its connection",
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
        # A newer STOP, or a reset, may have been said meanwhile: that stands.
        self._runner.publish(lambda s: replace(s, stop=counted) if s.stop is report else s)


def _all_is_heard(s: SessionSnapshot) -> bool:
    """Whether every joint answers and every node's heartbeat is back: a reset needs both."""
    return (
        s.data is DataState.FRESH
        and s.arm is not None
        and max(s.arm.heartbeat_age_s.values(), default=0.0) < LOST_S
    )
