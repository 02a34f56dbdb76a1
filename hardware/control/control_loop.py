"""The thread for the cyclic traffic (SYNC, commands, samples, heartbeat), which receives all frames.

Motions are given as steps (`Steps`) by a caller in another thread, one motion at a time. Rates and time-outs are in
`hardware.timing`. A sample is closed when all joints have answered. After a time-out it is closed without the missing
answers, but not while received frames wait in the queue: the next SYNC must not overtake a late answer.

STOP sets `latch` and sends its own frames. The loop itself stops the arm only after uncommanded motion.

Ctrl-C in the caller's thread can leave conditions and futures locked. So the loop uses `TimedQueue` (based on C) only.
`Thread.is_alive` is not used either: up to Python 3.12, Ctrl-C during a call can make all later calls return false.
"""

import threading
from collections import deque
from collections.abc import Callable, Generator
from contextlib import suppress
from dataclasses import dataclass, field
from inspect import GEN_CREATED, getgeneratorstate
from queue import Empty
from typing import Any, TypeVar

from hardware.buses.python_can import ArmOnBus, stamping_clock
from hardware.buses.shared_bus import SharedBus
from hardware.canopen import objects
from hardware.canopen.cyclic import Abandoned, Sample, Setpoints, frames_of
from hardware.canopen.objects import NmtState
from hardware.control.alarms import alarms
from hardware.control.sampling import CommandSender, Sampler
from hardware.control.stop_line import StopLatch
from hardware.errors import BusError, HardwareError
from hardware.monitors.joint_monitor import JointMonitor
from hardware.monitors.node_monitor import NodeMonitor
from hardware.timed_queue import TimedQueue
from hardware.timing import LatencyMonitor, Pace, raise_loop_priority

FRAMES_AT_A_TIME = 200
"""Limit of the frames handled in a row, so that SYNC is not delayed on a bus where a frame is always waiting."""
MAX_SAMPLE_AGE_S = 0.1
"""A sample older than this is taken again before the next command. Without host latency, samples are a few ms old."""
IDLE_GROWTH, MAX_IDLE_POLL_S = 1.1, 0.02
"""Growth and limit of the loop's idle waits for a frame, which a new task does not end. As each wait is a tenth longer
than the last, a task waits for at most about a tenth of the preceding idle time."""
SYNCS_AFTER_STOP = 20
"""Number of SYNCs sent after STOP in fast forward, so that the drives come to rest."""


Result = TypeVar("Result")
Steps = Generator[Setpoints | None, Sample, Result]
"""Generator that yields commands for the next SYNC, or None to repeat the last commands; receives the sample of that
SYNC; and returns a result."""

_ALIVE_POLL_S = 0.2
"""Period at which a waiting caller checks that the loop runs."""


@dataclass(slots=True, eq=False)
class LoopTask:
    """Steps that the loop runs for a caller in another thread; `abandoned` if that caller was interrupted (Ctrl-C).

    `despite`: types of alarms to ignore. When `finished`, the steps have ended with a `result`, or with an `error`.
    """

    steps: Steps[Any]
    despite: tuple[type[HardwareError], ...] = ()
    abandoned: bool = False
    finished: bool = False
    result: Any = None
    error: BaseException | None = None
    _wake: TimedQueue[None] = field(default_factory=TimedQueue)

    def advance(self, sample: Sample) -> Setpoints | None:
        """Run the steps up to the next SYNC and return the commands; raises `StopIteration` when the steps end."""
        begins = getgeneratorstate(self.steps) == GEN_CREATED
        return next(self.steps) if begins else self.steps.send(sample)

    def finish(self, *, result: Any = None, error: BaseException | None = None) -> None:
        """Pass the result or error to the caller."""
        self.steps.close()
        self.result, self.error = result, error
        self.finished = True
        self._wake.put(None)

    def wait(self, may_finish: Callable[[], bool]) -> bool:
        """Wait until `finish` was called; return false if `may_finish` returns false before that."""
        while not self.finished:
            with suppress(Empty):
                self._wake.get(timeout=_ALIVE_POLL_S)
            if not may_finish():
                break
        return self.finished


class ControlLoop:
    """Runs the cyclic traffic of an arm.

    The loop's thread calls `on_sdo` with identifier and data of every SDO answer and of other programs' SDO requests.
    `quick_stop` sends quick stop to all drives. Neither may wait. `allow` is called with the sample, the last commands
    and new commands before they are sent, and may raise `CommandRefused`. `clock` returns monotonic time, s.
    """

    def __init__(
        self,
        wire: SharedBus,
        on_bus: ArmOnBus,
        *,
        on_sdo: Callable[[int, bytes], None],
        allow: Callable[[Sample, Setpoints | None, Setpoints], None],
        quick_stop: Callable[[], None],
        watch: JointMonitor,
        latch: StopLatch,
        clock: Callable[[], float],
    ) -> None:
        pace, timing, stamps = on_bus.pace, on_bus.timing, stamping_clock(on_bus.settings)
        self.latency = LatencyMonitor(clock, stamps, arm_waits=pace is Pace.FAST_FORWARD)
        """Monitor of the host's latency, which the nodes' time-outs exclude."""
        self.nodes = NodeMonitor(
            on_bus.profile, lambda: self.latency.listened_s, timing.heartbeat_timeout_s
        )
        self.commands: Setpoints | None = None
        """Commands sent last; None before control was taken."""
        self.latch, self.watch = latch, watch
        self.moving = False
        """Whether steps are moving the arm."""
        self.failure: HardwareError | None = None
        """Error that ended the thread; None if there is none."""
        self._wire, self._pace = wire, pace
        self._on_sdo, self._allow = on_sdo, allow
        frames = frames_of(on_bus.profile)
        self._sender = CommandSender(wire.send, frames, self.latch, self.watch, quick_stop)
        self._timing, self._clock = timing, clock
        self._answer_timeout_s = timing.answer_timeouts_s[pace]
        self.sampler = Sampler(frames, max_misses=timing.misses(pace), now_s=clock())
        self._running = False
        self._thread = threading.Thread(target=self._run, name="sarcal-control", daemon=True)
        self._tasks: deque[LoopTask] = deque()  # the loop works on the first
        self._syncing = self._watching = self._beating = self._resampled = self._closing = False
        self._next_beat_s = self._next_tick_s = 0.0
        self._syncs_owed = SYNCS_AFTER_STOP
        self._synced_s = clock()
        self._idle_poll_s = timing.idle_poll_s

    def start(self) -> None:
        """Start receiving; sends nothing yet."""
        self._running = True
        self._thread.start()

    def begin_heartbeat(self) -> None:
        """Start the operator's heartbeat."""
        self._beating = True

    def begin_sync(self) -> None:
        """Start SYNC."""
        self._syncing = True

    def close(self) -> None:
        """Stop sending and end the thread. May be called twice."""
        self._closing = True
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def run(self, steps: Steps[Result], *, despite: tuple[type[HardwareError], ...] = ()) -> Result:
        """Run steps for a caller in another thread; return their result, or raise the error that ended them.

        Alarms of the types in `despite` are ignored. On Ctrl-C the arm is first brought to rest.
        """
        task = LoopTask(steps, despite)
        try:
            self._tasks.append(task)
            answered = task.wait(lambda: self._running)
        except BaseException:
            task.abandoned = True
            # Ctrl-C may have come before the task was queued.
            task.wait(lambda: self._running and task in tuple(self._tasks))
            raise
        if not answered:
            raise self._closed_error()
        if task.error is not None:
            raise task.error
        result: Result = task.result
        return result

    @property
    def sample(self) -> Sample:
        """The latest sample."""
        return self.sampler.view.sample

    def alarm(self) -> HardwareError | None:
        """Return the alarm that requires the current steps to stop the arm and end; None if there is none."""
        task = self._tasks[0] if self._tasks else None
        latched = self.latch.latched
        every = alarms(self.nodes, self.watch, self.sampler, stop_latched=latched)
        despite = () if task is None else task.despite
        first = next((alarm for alarm in every if not isinstance(alarm, despite)), None)
        if first is None and task is not None and task.abandoned:
            return Abandoned("the command was interrupted")
        return first

    def _run(self) -> None:
        try:
            raise_loop_priority()
            self.latency.begin()
            self._drain()  # old frames in the adapter: their sender may be gone
            self._watching = True
            while not self._closing:
                self._work()
        except HardwareError as error:
            self.failure = error
        finally:
            self._running = False
            self.latency.end()
            while self._tasks:
                self._tasks.popleft().finish(error=self._closed_error())

    def _work(self) -> None:
        if self._tasks and not self._must_resample():
            self._idle_poll_s = self._timing.idle_poll_s
            self._advance()
        elif self._syncing and (self._pace is Pace.REAL_TIME or self._needs_another_sync()):
            self._cycle()
        else:
            self._receive_one(self._idle_poll_s)
            self._idle_poll_s = min(IDLE_GROWTH * self._idle_poll_s, MAX_IDLE_POLL_S)
        self._beat()

    def _must_resample(self) -> bool:
        """Return whether host latency has made the sample too old to derive the next command from it.

        If so, the loop first takes a new sample while the drives hold. The result is never true twice in a row: the
        steps must run in between, to react to alarms and interrupts.
        """
        real_time = self._pace is Pace.REAL_TIME and self._syncing
        late = real_time and self._clock() - self._synced_s > MAX_SAMPLE_AGE_S
        self._resampled = late and not self._resampled
        return self._resampled

    def _closed_error(self) -> HardwareError:
        return self.failure or BusError("The connection to the arm is closed.")

    def _needs_another_sync(self) -> bool:
        """Whether a simulated arm needs a further SYNC to come to rest after STOP."""
        if not self.latch.latched:
            self._syncs_owed = SYNCS_AFTER_STOP
        elif self._syncs_owed > 0:
            self._syncs_owed -= 1
            return True
        return False

    def _advance(self) -> None:
        try:
            commands = self._tasks[0].advance(self.sample)
            if commands is not None:
                self._allow(self.sample, self.commands, commands)
        except StopIteration as stop:
            self._tasks.popleft().finish(result=stop.value)
        except Exception as error:  # noqa: BLE001 - handed to the caller, who raises it
            self._tasks.popleft().finish(error=error)
        else:
            if commands is not None:
                self.commands = commands
            self._cycle()

    def _cycle(self) -> None:
        if self._pace is Pace.REAL_TIME:
            self._wait_for_tick()
        self._drain()  # late and duplicate answers
        if self.commands is not None:
            self._sender.send(self.commands, self.sample.sync_count, moving=self.moving)
        self.sampler.open()
        self._synced_s = self._clock()
        self._wire.send(objects.COB_SYNC, b"")
        deadline = self._clock() + self._answer_timeout_s
        frames_left = FRAMES_AT_A_TIME
        while self.sampler.waiting > 0 and not self._closing and frames_left > 0:
            remaining_s = deadline - self._clock()
            # After the deadline, only frames that arrived during host latency are still read.
            wait_s = min(max(remaining_s, 0.0), 0.5 * objects.HEARTBEAT_PERIOD_S)
            if remaining_s <= 0.0:
                frames_left -= 1
            if not self._receive_one(wait_s) and remaining_s <= 0.0:
                break
            self._beat()
        self.sampler.close()
        before, stopped = self.watch.dropout.dropouts, self.latch.latched
        diverged = self.watch.update(
            self.sample,
            self.commands,
            answered_late=self.sampler.answered_late,
            stopped=stopped,
            refusing_joints=self.nodes.refusing_joints,
        )
        if diverged:
            self.latch.press(self.watch.divergence)
            self._sender.stop_all(self.commands)
        elif self.commands is not None and self.watch.dropout.dropouts != before:
            self._sender.send(self.commands, self.sample.sync_count, moving=False)  # at once

    def _drain(self) -> None:
        for _ in range(FRAMES_AT_A_TIME):
            if not self._receive_one(0.0):
                return
            self._beat()

    def _receive_one(self, timeout_s: float) -> bool:
        asked_s = self._clock()
        message = self._wire.receive(timeout_s)
        if message is None:
            self.latency.queue_empty(asked_s)
            return False
        # The time a frame waited is host latency, and part of its age.
        waited_s = self.latency.frame_read(message.timestamp)
        came_s, late_s = self._clock() - waited_s, self.latency.late_s - waited_s
        identifier: int = message.arbitration_id
        if self.sampler.note(identifier, message.data, came_s, late_s):
            return True
        asked = objects.node_of(identifier, objects.COB_SDO_TO_SERVER)  # by another program
        answered = objects.node_of(identifier, objects.COB_SDO_FROM_SERVER)
        if asked or answered:
            self._on_sdo(identifier, bytes(message.data))
        if not answered:
            if self._watching:
                self.nodes.note_command(identifier, message.data)
            self.nodes.note(identifier, message.data, self.sample.sync_count)
        return True

    def _beat(self) -> None:
        now = self._clock()
        if self._beating and now >= self._next_beat_s:
            self._next_beat_s = now + objects.HEARTBEAT_PERIOD_S
            identifier = objects.COB_HEARTBEAT + objects.OPERATOR_NODE
            self._wire.send(identifier, bytes([NmtState.OPERATIONAL]))

    def _wait_for_tick(self) -> None:
        """Receive frames until the next control period begins; after a late period the schedule restarts from now."""
        now = self._clock()
        if now > self._next_tick_s + self._timing.tick_s:
            self._next_tick_s = now
        while now < self._next_tick_s and not self._closing:
            self._receive_one(self._next_tick_s - now)
            self._beat()
            now = self._clock()
        self._next_tick_s += self._timing.tick_s
