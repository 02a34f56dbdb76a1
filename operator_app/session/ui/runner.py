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

from hardware.arm import ArmSnapshot
from hardware.errors import HardwareError, StopLatched
from operator_app.errors import Cancelled
from operator_app.messages.errors import EXPECTED, words
from operator_app.session.safety.joint_motion import MotionWatch
from operator_app.session.store.journal import Clock, utc_now
from operator_app.session.ui.message_log import ARM_AGAIN, acknowledged, resolved_by, told, until
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import (
    HUNG_S,
    LOST_S,
    STALE_S,
    Change,
    DataState,
    Level,
    SessionSnapshot,
    StopReport,
    TaskKind,
    Work,
)
from operator_app.session.ui.supervisor import Watchman
from operator_app.session.workflow.session import Session

WATCH_PERIOD_S = 0.05
MOVING = frozenset(
    {TaskKind.MOVE, TaskKind.AUTOMATIC, TaskKind.WIGGLE, TaskKind.HOME, TaskKind.VERIFY}
)
"""Tasks that any key ends."""


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    kind: TaskKind
    text: str
    work: Callable[[], None]
    cancel: threading.Event
    in_any_case: bool


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
        # The screen hands work in, and the watchman does: never taken where STOP has to get through.
        self._handing_in = threading.Lock()
        self._current: _Job | None = None
        self._closing = threading.Event()
        self._publishing = threading.Lock()
        motion = MotionWatch(session.model, session.procedure.capture)
        self._watchman = Watchman(self, motion, recording_ended, monotonic)
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
        self._watching = threading.Thread(target=self._watch, name="sarcal-watch", daemon=True)
        self._worker.start()
        self._watching.start()

    # -- publishing ----------------------------------------------------------------------------------

    def publish(self, change: Change) -> None:
        """Put the changed snapshot in the place of the present one, from any thread."""
        with self._publishing:
            self._base = change(self._base)

    def say(self, level: Level, text: str, until: frozenset[TaskKind] = frozenset()) -> None:
        """Add a message, from any thread; `until` is the work that resolves an alarm."""
        time_utc = f"{self._clock().astimezone(UTC):%H:%M:%S}"
        self.publish(lambda s: told(s, level, text, time=time_utc, until=until))

    def acknowledge(self, number: int) -> None:
        """Let the alarm of this number stand no more: the operator has seen it."""
        self.publish(lambda s: acknowledged(s, number))

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
        return self.session.identity is not None or self.connecting

    @property
    def connecting(self) -> bool:
        """Whether the arm is being connected to."""
        job = self._current
        return job is not None and job.kind is TaskKind.CONNECT

    # -- commands ----------------------------------------------------------------------------------

    @property
    def operations(self) -> Operations:
        """What can be handed to `submit`."""
        return self._operations

    def submit(
        self, kind: TaskKind, text: str, work: Callable[[], None], *, in_any_case: bool = False
    ) -> None:
        """Queue work for the worker; returns at once.

        What is done `in_any_case` no key ends: it is short, and moves nothing.
        """
        job = _Job(kind, text, work, threading.Event(), in_any_case)
        with self._handing_in:
            if self._closing.is_set():
                return
            self._hand.append(job)
            # Shown before the worker has it: shown after, it could be over already, and stay.
            if self._base.task is None:
                self._show_task(kind, text)
            self._jobs.put(job)

    def cancel(self) -> None:
        """End the work in hand and what waits behind it; a moving arm comes to rest and holds."""
        for job in tuple(self._hand):
            if not job.in_any_case:
                job.cancel.set()

    def stop(self) -> None:
        """Software STOP, from the calling thread: waits for no queue, no lock, no work."""
        asked = self._monotonic()
        problem = ""
        before = self._base.stop
        again = (before is not None and not before.problem) or bool(self._watchman.told_of_stop)
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
            problem = f"STOP could not be sent: {problem}. Use the hardware stop"
            self.say(Level.ALARM, problem, ARM_AGAIN)
        elif not again:
            # Said once, and not over why the arm was stopped before.
            said = "software STOP sent to all drives; it is latched (R resets)"
            self.say(Level.ALARM, said, frozenset({TaskKind.RESET}))

    def close(self, reason: str) -> None:
        """End the work in hand, leave the arm held and the journal whole. Safe to call twice."""
        with self._handing_in:
            if self._closing.is_set():
                return
            # Nothing comes behind it; and what came before it is ended, or done in any case.
            self._closing.set()
            self._jobs.put(None)
        self.cancel()
        self._worker.join()
        self._watching.join()
        self.session.close(reason)

    # -- threads -----------------------------------------------------------------------------------

    def _show_task(self, kind: TaskKind, text: str) -> None:
        task = Work(kind=kind, text=text, moves=kind in MOVING, started_s=self._monotonic())
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
            self.stop_quietly()

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
            self._hand.remove(job)
            self._current = None
            self.publish(lambda s: replace(s, task=None))

    def _do(self, job: _Job) -> None:
        try:
            job.work()
        except Cancelled as ended:
            self.say(Level.INFO, f"{job.text}: {ended.happened.lower()}; {ended.remedy.lower()}")
            self._recover()
        except StopLatched as error:
            # Whoever latched it has said so: no second alarm about it.
            self.say(Level.INFO, f"{job.text}: {error}")
            self._recover()
        except EXPECTED as error:
            said = words(error)
            self.say(Level.ALARM, f"{said.happened}. {said.remedy}", until(error, job.kind))
            self._recover()
        except BaseException as error:  # noqa: BLE001 - kept for the screen to raise
            self.defect = error
            self.say(Level.ALARM, f"a defect of this program: {error!r}")
        else:
            self.publish(lambda s: resolved_by(s, job.kind))
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
        while not self._closing.wait(WATCH_PERIOD_S):
            now = self._picture()
            self._watchman.look(now, unseen_s=now.now_s - self._looked_s)

    def recording_news(self) -> str:
        """How a recording of the bus ended early, in words; "" when that was told already, or it did not."""
        return self._watchman.recording_news()

    def note_why_stopped(self) -> None:
        """Have it kept in the journal why the arm was stopped, whatever else is ended meanwhile."""
        self.submit(
            TaskKind.NOTE,
            "noting why the arm was stopped",
            self._operations.heed,
            in_any_case=True,
        )

    def stop_quietly(self) -> bool:
        """Quick stop; whether it could be sent."""
        self.cancel()
        try:
            self.session.arm.stop()
        except HardwareError:
            return False
        return True
