"""Runs a session for a user interface: takes tasks, returns snapshots; only `Runner.close` blocks.

One worker thread makes all blocking calls. `stop` calls the arm directly from the calling thread. A second thread
supervises the arm, whether or not a screen polls.
"""

import queue
import threading
import time
from collections import deque
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from datetime import UTC

from hardware.errors import HardwareError, StopLatched
from operator_app.errors import Cancelled
from operator_app.messages.errors import EXPECTED, words
from operator_app.session.store.journal import Clock, utc_now
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import (
    ARM_RECOVERY,
    HUNG_S,
    LOST_S,
    STALE_S,
    Change,
    DataState,
    Level,
    RunningTask,
    SessionSnapshot,
    StopReport,
    TaskKind,
    resolving_tasks,
)
from operator_app.session.ui.supervisor import Supervisor
from operator_app.session.workflow.session import Session

WATCH_PERIOD_S = 0.05
CONNECTION_ATTEMPT_S = 30.0  # limits the wait of `close`: an adapter's driver may never return
MOVING = frozenset(
    {TaskKind.MOVE, TaskKind.AUTOMATIC, TaskKind.WIGGLE, TaskKind.HOME, TaskKind.VERIFY}
)
"""Tasks that any key cancels."""


@dataclass(frozen=True, slots=True, eq=False)
class _Job:
    kind: TaskKind
    text: str
    work: Callable[[], None]
    cancel: threading.Event
    uncancellable: bool


class Runner:
    """Runs a session for a user interface.

    Only the worker thread calls the session, except for `ArmInterface.stop` and `ArmInterface.snapshot`.
    `monotonic`: clock for the age of data, s. `clock`: clock for the times of messages, UTC.
    """

    def __init__(
        self,
        session: Session,
        *,
        monotonic: Callable[[], float] = time.monotonic,
        clock: Clock = utc_now,
    ) -> None:
        self.session = session
        self._monotonic, self._clock = monotonic, clock
        self.operations = Operations(session, self)
        self._jobs: queue.SimpleQueue[_Job | None] = queue.SimpleQueue()
        # Tasks that have not ended, including the running one.
        self._waiting_jobs: deque[_Job] = deque()
        # Lock for `submit` from several threads; `stop` never acquires it.
        self._submitting = threading.Lock()
        self._current: _Job | None = None
        self._closing = threading.Event()
        self._publishing = threading.Lock()
        self.supervisor = Supervisor(self, monotonic)
        self._data_at_s = self._polled_s = monotonic()
        self.defect: BaseException | None = None
        own, solved = session.procedure, session.state.solved
        self._base = SessionSnapshot(
            now_s=monotonic(),
            procedure=own,
            folder=session.journal.path.parent,
            state=session.state,
            simulated=session.rig.simulated,
            bus=session.rig.bus,
            mobility=session.mobility,
            # Those of the recorded calibration, which is shown again.
            estimator=solved.get("estimator", own.estimator),
            unsensed_joints=tuple(solved.get("unsensed_joints", own.unsensed_joints)),
            selected_joints=session.state.position_joints or own.position_joints or (),
        )
        if session.journal.contents.torn:
            self.say(Level.WARNING, session.journal.contents.torn)
        if session.state.poses:
            kept = f"{len(session.state.poses)} poses are kept"
            self.say(Level.INFO, f"resumed: {kept}; arm, fixture and modes are checked again")
        self._worker = threading.Thread(target=self._work, name="sarcal-worker", daemon=True)
        self._watching = threading.Thread(target=self._watch, name="sarcal-watch", daemon=True)
        self._worker.start()
        self._watching.start()

    # -- publishing ----------------------------------------------------------------------------------

    def publish(self, change: Change) -> None:
        """Replace the snapshot by the result of `change`; may be called from any thread."""
        with self._publishing:
            self._base = change(self._base)

    def say(
        self, level: Level, text: str, resolving_tasks: frozenset[TaskKind] = frozenset()
    ) -> None:
        """Add a message; an alarm is resolved when one of `resolving_tasks` succeeds. May be called from any thread."""
        time_utc = f"{self._clock().astimezone(UTC):%H:%M:%S}"
        self.publish(
            lambda s: s.with_message(level, text, time=time_utc, resolving_tasks=resolving_tasks)
        )

    def acknowledge(self, number: int) -> None:
        """Remove the alarm with this number."""
        self.publish(lambda s: s.without_alarm(number))

    def cancelled(self) -> bool:
        """Whether the running task has been cancelled."""
        job = self._current
        return job is not None and job.cancel.is_set()

    # -- snapshot ----------------------------------------------------------------------------------

    def snapshot(self) -> SessionSnapshot:
        """Return the latest snapshot, and record that a user interface polls; never blocks."""
        self._polled_s = self._monotonic()
        return self._current_snapshot()

    def _current_snapshot(self) -> SessionSnapshot:
        base, now = self._base, self._monotonic()
        if base.task is not None and self.cancelled():
            # A task that is planning may take seconds to end: show at once that it is ending.
            base = replace(base, task=replace(base.task, ending=True))
        if base.identity is None:
            return replace(base, now_s=now)
        try:
            arm = self.session.arm.snapshot()
        except HardwareError:
            # A connection lost since the last call is treated like an arm that does not answer; the supervisor
            # reports that once.
            return replace(base, now_s=now, data=DataState.LOST, oldest_s=now - self._data_at_s)
        ages = [joint.age_s for joint in arm.joints]
        oldest = max(ages, default=0.0)
        self._data_at_s = now - oldest
        state = DataState.FRESH
        if oldest > STALE_S:
            # Host latency is excluded from the receive timeout, up to `HUNG_S`.
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

    @property
    def connected(self) -> bool:
        """Whether an arm is connected or being connected, i.e. whether STOP has an arm to act on."""
        return self.session.identity is not None or self.connecting

    @property
    def connecting(self) -> bool:
        """Whether the running task is connecting to the arm."""
        job = self._current
        return job is not None and job.kind is TaskKind.CONNECT

    # -- commands ----------------------------------------------------------------------------------

    def submit(
        self, kind: TaskKind, text: str, work: Callable[[], None], *, uncancellable: bool = False
    ) -> None:
        """Queue a task for the worker; do not wait for it. An `uncancellable` task is short and moves nothing."""
        job = _Job(kind, text, work, threading.Event(), uncancellable)
        with self._submitting:
            if self._closing.is_set():
                return
            self._waiting_jobs.append(job)
            # Publish the task before the worker gets it, since it may end at once.
            if self._base.task is None:
                self._show_task(job)
            self._jobs.put(job)

    def cancel(self, *, but: TaskKind | None = None) -> None:
        """Cancel all tasks except uncancellable ones and those of kind `but`; a moving arm comes to rest and holds."""
        for job in tuple(self._waiting_jobs):
            if not job.uncancellable and job.kind is not but:
                job.cancel.set()

    def stop(self) -> None:
        """Send the software STOP from the calling thread, without waiting for a task or the queue."""
        pressed_s = self._monotonic()
        problem = ""
        before = self._base.stop
        again = (before is not None and not before.problem) or bool(self.supervisor.reported_stop)
        try:
            self.session.arm.stop()
        except Exception as error:  # noqa: BLE001 - STOP may fail, it may not raise
            problem = str(error) or repr(error)
        self.cancel()
        report = StopReport(asked_s=pressed_s, problem=problem)
        self.publish(lambda s: replace(s, stop=report))
        if problem:
            problem = f"STOP could not be sent: {problem}. Use the hardware stop"
            self.say(Level.ALARM, problem, ARM_RECOVERY)
        elif not again:
            # Report STOP only once, and not if a stop by the arm itself has been reported.
            message = "software STOP sent to all drives; it is latched (R resets)"
            self.say(Level.ALARM, message, frozenset({TaskKind.RESET}))

    def close(self, reason: str) -> None:
        """Cancel the running task, hold and release the arm, and close the journal; blocks. May be called twice."""
        with self._submitting:
            if self._closing.is_set():
                return
            # None ends the worker; the jobs before it are cancelled or uncancellable.
            self._closing.set()
            self._jobs.put(None)
        self.cancel()
        self._worker.join(CONNECTION_ATTEMPT_S if self.connecting else None)
        self._watching.join()
        self.session.close(reason)

    # -- threads -----------------------------------------------------------------------------------

    @contextmanager
    def _supervised(self) -> Iterator[None]:
        try:
            yield
        except BaseException as error:  # noqa: BLE001 - kept for the screen to raise
            self.defect = error
            self.send_quick_stop()

    def _work(self) -> None:
        with self._supervised():
            while (job := self._jobs.get()) is not None:
                if not job.cancel.is_set():
                    self._current = job
                    self._do(job)
                elif not self._closing.is_set():
                    self.say(Level.INFO, f"{job.text}: cancelled by the operator before it started")
                self._waiting_jobs.remove(job)
                self._current = None
                self.publish(lambda s: replace(s, task=None))

    def _show_task(self, job: _Job) -> None:
        moves, started_s = job.kind in MOVING, self._monotonic()
        task = RunningTask(kind=job.kind, text=job.text, moves=moves, started_s=started_s)
        self.publish(lambda s: replace(s, task=task))

    def _do(self, job: _Job) -> None:
        self._show_task(job)
        try:
            job.work()
        except Cancelled as ended:
            self.say(Level.INFO, f"{job.text}: {ended.happened.lower()}; {ended.remedy.lower()}")
            self._recover()
        except StopLatched as error:
            # The STOP itself has an alarm already.
            self.say(Level.INFO, f"{job.text}: {error}")
            self._recover()
        except EXPECTED as error:
            message, resolving = words(error), resolving_tasks(error, job.kind)
            self.say(Level.ALARM, f"{message.happened}. {message.remedy}", resolving)
            self._recover()
        except BaseException as error:  # noqa: BLE001 - kept for the screen to raise
            self.defect = error
            self.say(Level.ALARM, f"program error: {error!r}")
        else:
            self.publish(lambda s: s.without_resolved(job.kind))
        finally:
            self.publish(lambda s: replace(s, task=None))

    def _recover(self) -> None:
        try:
            self.operations.refresh()
        except EXPECTED as error:
            self.say(Level.WARNING, words(error).happened)

    def _watch(self) -> None:
        with self._supervised():
            while not self._closing.wait(WATCH_PERIOD_S):
                now = self._current_snapshot()
                self.supervisor.check(now, unseen_s=now.now_s - self._polled_s)

    def send_quick_stop(self) -> bool:
        """Send a quick stop, report only a failure in the snapshot, and return whether it was sent.

        Cancels all cancellable tasks except connecting, which the operator may have requested at the same time.
        """
        self.cancel(but=TaskKind.CONNECT)
        try:
            self.session.arm.stop()
        except HardwareError as error:
            report = StopReport(asked_s=self._monotonic(), problem=str(error))
            self.publish(lambda s: replace(s, stop=report))
            return False
        return True
