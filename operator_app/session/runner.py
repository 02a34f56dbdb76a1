"""Runs a session for a face: commands go in, snapshots come out, nothing waits.

One worker thread owns every blocking call. STOP does not go through it: `stop` calls the arm from
whichever thread asks. A watchman looks at the age of the data whether or not a screen does. Knows no
Textual and prints nothing.
"""

from __future__ import annotations

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC

from hardware.arm import ArmSnapshot, DriveState
from hardware.errors import HardwareError
from operator_app.errors import Cancelled
from operator_app.session.journal import Clock, utc_now
from operator_app.session.motion import MotionWatch
from operator_app.session.operations import Operations
from operator_app.session.session import Session
from operator_app.session.snapshot import (
    HUNG_S,
    LOST_S,
    STALE_S,
    Change,
    DataState,
    Level,
    Message,
    SessionSnapshot,
    StopReport,
    Task,
    TaskKind,
)
from operator_app.session.wording import EXPECTED, words

WATCH_PERIOD_S = 0.05
MESSAGES_KEPT = 100
UNSEEN_S = 1.5
"""A motion that nobody has looked at for so long is ended: any key ends a motion, if it is read."""

MOVING = frozenset(
    {TaskKind.MOVE, TaskKind.AUTOMATIC, TaskKind.WIGGLE, TaskKind.HOME, TaskKind.VERIFY}
)
"""Tasks that any key ends."""


@dataclass(frozen=True, slots=True)
class _Job:
    kind: TaskKind
    text: str
    work: Callable[[], None]
    cancel: threading.Event


class Runner:
    """Runs a session for a screen.

    Parameters
    ----------
    session
        Its calls are made by the worker only, but for `Arm.stop` and `Arm.snapshot`.
    simulated, bus
        Whether nothing real can move, and the bus in words.
    recording_ended
        How a recording of the bus ended early; "" while it goes on, or where there is none.
    monotonic, clock
        Seconds for ages, UTC for messages.
    """

    def __init__(
        self,
        session: Session,
        *,
        simulated: bool,
        bus: str,
        recording_ended: Callable[[], str] = str,
        monotonic: Callable[[], float] = time.monotonic,
        clock: Clock = utc_now,
    ) -> None:
        self.session = session
        self._monotonic, self._clock = monotonic, clock
        self._operations = Operations(session, self)
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        self._hand: deque[_Job] = deque()
        self._current: _Job | None = None
        self._closing = threading.Event()
        self._publishing = threading.Lock()
        self._recording_ended, self._told_of_recording = recording_ended, ""
        self._motion = MotionWatch(session.model, session.procedure.capture)
        self._seen_s = self._looked_s = monotonic()
        self.defect: BaseException | None = None
        self._base = SessionSnapshot(
            now_s=monotonic(),
            procedure=session.procedure,
            folder=session.journal.path.parent,
            state=session.state,
            simulated=simulated,
            bus=bus,
            mobility=session.mobility,
            estimator=session.procedure.estimator,
            unsensed_joints=session.procedure.unsensed_joints,
            wanted_joints=session.procedure.position_joints or (),
        )
        if session.journal.contents.torn:
            self.say(Level.WARNING, session.journal.contents.torn)
        if session.state.poses:
            self.say(
                Level.INFO,
                f"resumed: {len(session.state.poses)} poses are kept; arm, fixture and modes are "
                "checked again",
            )
        self._worker = threading.Thread(target=self._work, name="sarcal-worker", daemon=True)
        self._watchman = threading.Thread(target=self._watch, name="sarcal-watch", daemon=True)
        self._worker.start()
        self._watchman.start()

    # -- publishing ----------------------------------------------------------------------------------

    def publish(self, change: Change) -> None:
        """Put the changed snapshot in the place of the present one, from any thread."""
        with self._publishing:
            self._base = change(self._base)

    def say(self, level: Level, text: str) -> None:
        """Add a message, from any thread."""
        time_utc = f"{self._clock().astimezone(UTC):%H:%M:%S}"

        def add(s: SessionSnapshot) -> SessionSnapshot:
            number = s.messages[-1].number + 1 if s.messages else 1
            message = Message(number=number, time=time_utc, level=level, text=text)
            return replace(s, messages=(*s.messages, message)[-MESSAGES_KEPT:])

        self.publish(add)

    def cancelled(self) -> bool:
        """Whether the work in hand should end."""
        job = self._current
        return job is not None and job.cancel.is_set()

    # -- looking -----------------------------------------------------------------------------------

    def snapshot(self) -> SessionSnapshot:
        """Return the latest picture, to somebody who looks at it; never blocks."""
        self._looked_s = self._monotonic()
        return self._picture()

    def _picture(self) -> SessionSnapshot:
        base, now = self._base, self._monotonic()
        if base.identity is None:
            return replace(base, now_s=now)
        arm = self._arm_snapshot()
        if arm is None:
            # There was an arm: that there is none now is as bad as silence.
            return replace(base, now_s=now, data=DataState.LOST, oldest_s=now - self._seen_s)
        ages = [joint.age_s for joint in arm.joints]
        oldest = max(ages, default=0.0)
        self._seen_s = now - oldest
        state = DataState.FRESH
        if oldest > STALE_S:
            # Our own lateness is not the arm's silence; but a loop that hangs for good is found as well.
            silent = oldest - arm.late_s > LOST_S or oldest > HUNG_S
            state = DataState.LOST if silent else DataState.STALE
        return replace(
            base,
            now_s=now,
            arm=arm,
            data=state,
            oldest_s=oldest,
            stale_joints=tuple(j.joint for j in arm.joints if j.age_s > STALE_S),
        )

    def _arm_snapshot(self) -> ArmSnapshot | None:
        try:
            return self.session.arm.snapshot()
        except HardwareError:
            # The link went down between two looks; the watchman says so once.
            return None

    @property
    def connected(self) -> bool:
        """Whether there is an arm to stop: also one that is being connected to."""
        return self.session.identity is not None or self._connecting

    @property
    def _connecting(self) -> bool:
        job = self._current
        return job is not None and job.kind is TaskKind.CONNECT

    # -- commands ----------------------------------------------------------------------------------

    @property
    def operations(self) -> Operations:
        """What can be handed to `submit`."""
        return self._operations

    def submit(self, kind: TaskKind, text: str, work: Callable[[], None]) -> None:
        """Queue work for the worker; returns at once."""
        if not self._closing.is_set():
            job = _Job(kind, text, work, threading.Event())
            self._hand.append(job)
            # Shown before the worker has it: shown after, it could be over already, and stay.
            if self._base.task is None:
                self._show_task(kind, text)
            self._jobs.put(job)

    def cancel(self) -> None:
        """End the work in hand and what waits behind it; a moving arm comes to rest and holds."""
        for job in tuple(self._hand):
            job.cancel.set()

    def stop(self) -> None:
        """Software STOP, from the calling thread: waits for no queue, no lock, no work."""
        asked = self._monotonic()
        problem = ""
        again = self._base.stop is not None and not self._base.stop.problem
        try:
            self.session.arm.stop()
        except Exception as error:  # noqa: BLE001 - STOP may fail, it may not raise
            problem = str(error) or repr(error)
        self.cancel()
        sent = self._monotonic() - asked
        report = StopReport(
            asked_s=asked,
            sent_after_s=sent,
            acknowledged_after_s=None,
            drives_stopped=0,
            problem=problem,
        )
        self.publish(lambda s: replace(s, stop=report))
        if problem:
            self.say(Level.ALARM, f"STOP could not be sent: {problem}. Use the hardware stop")
        elif not again:
            # Said once: a key that is held down would push out why it was pressed.
            self.say(Level.ALARM, "software STOP sent to all drives; it is latched (R resets)")

    def close(self, reason: str) -> None:
        """End the work in hand, leave the arm held and the journal whole. Safe to call twice."""
        if self._closing.is_set():
            return
        self.cancel()
        self._closing.set()
        self._jobs.put(None)
        self._worker.join()
        self._watchman.join()
        self.session.close(reason)

    # -- threads -----------------------------------------------------------------------------------

    def _show_task(self, kind: TaskKind, text: str) -> None:
        task = Task(kind=kind, text=text, moves=kind in MOVING, started_s=self._monotonic())
        self.publish(lambda s: replace(s, task=task))

    def _work(self) -> None:
        with self._supervised():
            self._work_off()

    @contextmanager
    def _supervised(self) -> Iterator[None]:
        """A thread that ends by a defect stops the arm and tells the screen."""
        try:
            yield
        except BaseException as error:  # noqa: BLE001 - kept for the screen to raise
            self.defect = error
            self._stop_quietly()

    def _work_off(self) -> None:
        while True:
            job = self._jobs.get()
            if job is None:
                return
            if not job.cancel.is_set():
                self._current = job
                self._show_task(job.kind, job.text)
                self._do(job)
            elif not self._closing.is_set():
                self.say(Level.INFO, f"{job.text}: ended by the operator before it began")
            self._hand.popleft()
            self._current = None
            self.publish(lambda s: replace(s, task=None))

    def _do(self, job: _Job) -> None:
        try:
            job.work()
        except Cancelled as ended:
            self.say(Level.INFO, f"{job.text}: {ended.happened.lower()}; {ended.remedy.lower()}")
            self._recover()
        except EXPECTED as error:
            said = words(error)
            self.say(Level.ALARM, f"{said.happened}. {said.remedy}")
            self._recover()
        except BaseException as error:  # noqa: BLE001 - kept for the screen to raise
            self.defect = error
            self.say(Level.ALARM, f"a defect of this program: {error!r}")
        finally:
            self.publish(lambda s: replace(s, task=None))

    def _recover(self) -> None:
        """Publish what counts after something was cut short."""
        try:
            self._operations.refresh()
        except EXPECTED as error:
            self.say(Level.WARNING, words(error).happened)

    def _watch(self) -> None:
        with self._supervised():
            self._keep_watch()

    def _keep_watch(self) -> None:
        """Lost data end the work and stop the arm, and so does nobody looking while it moves."""
        lost = False
        while not self._closing.wait(WATCH_PERIOD_S):
            now = self._picture()
            self._end_what_nobody_sees(now)
            self._look_at_motion(now)
            if news := self.recording_news():
                self.say(Level.WARNING, news)
            if now.arm is not None and now.stop is not None:
                self._count_stopped(now, now.stop)
            # While connecting anew there are none yet, and a STOP would end it.
            if now.data is DataState.LOST and not lost and not self._connecting:
                lost = True
                sent = "quick stop sent" if self._stop_quietly() else "quick stop NOT sent"
                self.say(
                    Level.ALARM,
                    f"no data from the arm for {now.oldest_s:.1f} s: {sent}, the drives hold by "
                    "themselves. Look at the bus and the controller",
                )
            elif lost and _all_is_heard(now):
                lost = False
                self.say(Level.INFO, "the data are back: reset STOP (R) when it is safe")

    def _look_at_motion(self, now: SessionSnapshot) -> None:
        if now.arm is not None and now.data is DataState.FRESH:
            motion = self._motion.see(now.now_s, now.arm)
            self.publish(lambda s: replace(s, motion=motion))
        elif now.motion is not None:
            self._motion.forget()
            self.publish(lambda s: replace(s, motion=None))

    def recording_news(self) -> str:
        """How a recording of the bus ended early, in words; "" when that was told already, or it did not.

        A full disk ends a recording, and nothing else: the session goes on without it.
        """
        words, told = self._recording_ended(), self._told_of_recording
        self._told_of_recording = words
        return "" if words == told else words[:1].upper() + words[1:]

    def _end_what_nobody_sees(self, now: SessionSnapshot) -> None:
        """A screen that hangs, on a terminal that is not read any more, takes no key that stops."""
        unseen = now.now_s - self._looked_s
        if now.task is not None and now.task.moves and unseen > UNSEEN_S and not self.cancelled():
            self.cancel()
            self.say(
                Level.ALARM,
                f"the screen did not answer for {unseen:.1f} s while the arm moved: the motion was "
                "ended. Look at the terminal and its connection",
            )

    def _stop_quietly(self) -> bool:
        """Quick stop; whether it could be sent."""
        self.cancel()
        try:
            self.session.arm.stop()
        except HardwareError:
            return False
        return True

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
        self.publish(lambda s: replace(s, stop=counted) if s.stop is report else s)


def _all_is_heard(s: SessionSnapshot) -> bool:
    """Whether every joint answers and every node's heartbeat is back: a reset needs both."""
    return (
        s.data is DataState.FRESH
        and s.arm is not None
        and max(s.arm.heartbeat_age_s.values(), default=0.0) < LOST_S
    )
