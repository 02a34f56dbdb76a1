"""The one thread that owns all cyclic traffic: SYNC, samples, commands, heartbeat. Knows no calibration.

It also receives every frame, so that nothing hops between threads: SDO answers are handed on to the
callers that wait for them. What the arm is to do comes as steps (`hardware.control.tasks.Steps`), one at a
time.

How fast it goes, and how long anybody is waited for, is `hardware.timing`'s affair.

The next SYNC does not overtake a late answer: a sample is closed when all joints have answered, or
when their time is up and nothing more has come.

STOP does not come through here: it presses `latch` and sends its frames by itself. A joint that goes where it
was not told to, its drive saying all is well, is the one thing that the loop stops by itself, as STOP would.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable
from typing import Any, Protocol

from hardware.canopen.bus_profile import BusProfile
from hardware.canopen.cyclic import Abandoned, Sample, Setpoints, frames_of
from hardware.canopen.objects import (
    COB_HEARTBEAT,
    COB_SDO_FROM_SERVER,
    COB_SYNC,
    OPERATOR_NODE,
    NmtState,
)
from hardware.control.command_sender import CommandSender
from hardware.control.process_priority import raise_loop_priority
from hardware.control.sampling import CyclicView, Sampler
from hardware.control.stop_line import StopLatch
from hardware.control.tasks import LoopTask, Steps, TaskQueue
from hardware.errors import BusError, HardwareError
from hardware.monitors.alarms import Observations, find_alarm
from hardware.monitors.joint_monitor import JointMonitor
from hardware.monitors.latency import LatencyMonitor
from hardware.monitors.node_monitor import NodeMonitor
from hardware.timing import Pace, Timing

SWITCH_INTERVAL_S = 0.0005
"""Python's default of 5 ms would let a busy thread of this process delay a SYNC by as much."""


FRAMES_AT_A_TIME = 200
"""Frames looked at before what is due is seen to: on a bus with a frame always waiting, heartbeat and SYNC
must not wait for the last of them."""

OLD_SAMPLE_S = 0.1
"""Joints latched longer ago say nothing of where to go on from: as long as nobody here was late, it is a few
milliseconds, and a joint that does not answer is waited for for a third of it."""

IDLE_GROWTH, LONGEST_IDLE_POLL_S = 1.1, 0.02
"""Who waits on a bus is not woken by a task. Tasks often follow each other, so the first look is soon; each
one in vain makes the next wait a tenth longer, so that a task waits a tenth of the idle time before it at most."""

SYNCS_AFTER_STOP = 20
"""In fast forward, so that the drives come to rest and say that they have stopped."""


class FrameLink(Protocol):
    """What the loop needs of a `hardware.buses.shared_bus.SharedBus`."""

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        ...

    def receive(self, timeout_s: float) -> Any:
        """Next frame or None."""
        ...


class ControlLoop:
    """Runs the cyclic traffic of an arm.

    Parameters
    ----------
    wire
        The bus.
    profile
        Its nodes and their frames.
    pace
        See `hardware.timing`.
    on_sdo
        Called in the loop's thread with identifier and data of every SDO answer; must not wait.
    allow
        Called before commands go out with the present sample, the commands sent last and the new
        ones; raises `CommandRefused` for what may not be sent.
    watch
        Looks at the joints' samples.
    latch
        Of STOP; it may outlive the connection.
    quick_stop
        Sends quick stop to all drives; must not wait.
    clock
        Monotonic time, s.
    stamps
        The clock by which frames are stamped as they come, if it is one of this computer's.

    Attributes
    ----------
    latency
        How late this loop itself has been: silences of the nodes are measured without that.
    commands
        Sent last, or None before control was taken.
    moving
        Steps are moving the arm.
    failure
        Why the thread has ended.
    heartbeat_timeout_s
        Silence after which a node is lost; set before `begin_sync`.
    """

    def __init__(
        self,
        wire: FrameLink,
        *,
        profile: BusProfile,
        pace: Pace,
        on_sdo: Callable[[int, bytes], None],
        allow: Callable[[Sample, Setpoints | None, Setpoints], None],
        quick_stop: Callable[[], None],
        timing: Timing,
        watch: JointMonitor | None = None,
        latch: StopLatch | None = None,
        clock: Callable[[], float] = time.monotonic,
        stamps: Callable[[], float] | None = None,
    ) -> None:
        self.latency = LatencyMonitor(clock, stamps, arm_waits=pace is Pace.FAST_FORWARD)
        self.nodes = NodeMonitor(profile, lambda: self.latency.listened_s)
        self.commands: Setpoints | None = None
        self.latch = latch or StopLatch()
        self.watch = watch or JointMonitor()
        self.moving = False
        self.failure: HardwareError | None = None
        self._wire, self._pace = wire, pace
        self._on_sdo, self._allow = on_sdo, allow
        frames = frames_of(profile)
        self._sender = CommandSender(
            wire.send, frames, latch=self.latch, watch=self.watch, quick_stop=quick_stop
        )
        self._timing, self._clock = timing, clock
        self.heartbeat_timeout_s = timing.heartbeat_timeout_s
        self._answer_timeout_s = timing.answer_timeouts_s[pace]
        self._sampler = Sampler(frames, patience=timing.misses(pace), now_s=clock())
        self._thread = threading.Thread(target=self._run, name="sarcal-control", daemon=True)
        self._tasks = TaskQueue(self._thread.is_alive, self._gone)
        self._syncing = False
        self._watching = False
        self._syncs_owed = SYNCS_AFTER_STOP
        self._beating = False
        self._next_beat_s = 0.0
        self._next_tick_s = 0.0
        self._synced_s = clock()
        self._looking_again = False
        self._idle_poll_s = timing.idle_poll_s
        self._closing = False

    # ---- for other threads -----------------------------------------------------------------------

    @property
    def stop_latched(self) -> bool:
        """STOP was pressed: nothing but quick stop goes to the drives."""
        return self.latch.latched

    @property
    def view(self) -> CyclicView:
        """The latest sample and what belongs to it."""
        return self._sampler.view

    def start(self) -> None:
        """Begin to receive; sends nothing yet."""
        sys.setswitchinterval(min(sys.getswitchinterval(), SWITCH_INTERVAL_S))
        self._thread.start()

    def begin_heartbeat(self) -> None:
        """Be heard as the operator from now on."""
        self._beating = True

    def begin_sync(self) -> None:
        """Let SYNCs go out from now on."""
        self._syncing = True

    def forget_faults(self) -> None:
        """Forget emergencies, and what was seen of sensors and of other programs, so far."""
        self.nodes.forget_faults()
        self.watch.reset()

    def close(self) -> None:
        """Stop everything that is sent and end the thread. Safe to call twice."""
        self._closing = True
        if self._thread.ident is not None:
            self._thread.join(5.0)

    def run(self, steps: Steps, *, despite: tuple[type[HardwareError], ...] = ()) -> Any:
        """Run steps to their end and return their result; `despite` names alarms not to mind.

        If this call is interrupted (Ctrl-C), the steps are told, bring the arm to rest, and only
        then does the interrupt go on.

        Raises
        ------
        HardwareError
            What ended the steps early.
        """
        return self._tasks.run(LoopTask(steps, despite))

    # ---- for steps, in the loop's own thread -----------------------------------------------------

    @property
    def sample(self) -> Sample:
        """The latest sample."""
        return self._sampler.view.sample

    def alarm(self) -> HardwareError | None:
        """Why the present steps should end, if anything; they bring the arm to rest first."""
        task = self._tasks.first
        found = find_alarm(
            self.nodes,
            Observations(
                stop_latched=self.stop_latched,
                lost_joints=self._sampler.lost(),
                duplicate_joints=self._sampler.doubled(),
                jump=self.watch.jump,
                divergence=self.watch.divergence,
                dropouts=self.watch.dropout.dropouts,
            ),
            now_s=self.latency.listened_s,
            heartbeat_timeout_s=self.heartbeat_timeout_s,
            despite=() if task is None else task.despite,
        )
        if found is None and task is not None and task.abandoned:
            return Abandoned("the command was given up")
        return found

    # ---- the thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        raise_loop_priority()
        self.latency.begin()
        try:
            self._drain()  # what an adapter still had: whoever said it may be gone
            self._watching = True
            while not self._closing:
                self._work()
        except HardwareError as error:
            self.failure = error
        finally:
            self._tasks.finish_all(self._gone())

    def _work(self) -> None:
        """Do the next thing, and be heard."""
        task = self._tasks.first
        if task is not None and not self._must_look_again():
            self._idle_poll_s = self._timing.idle_poll_s
            self._advance(task)
        elif self._syncing and (self._pace is Pace.REAL_TIME or self._owes_sync()):
            self._cycle()
        else:
            self._receive_one(self._idle_poll_s)
            self._idle_poll_s = min(IDLE_GROWTH * self._idle_poll_s, LONGEST_IDLE_POLL_S)
        self._beat()

    def _must_look_again(self) -> bool:
        """Whether the sample is too old, as we were late ourselves, to say what is commanded next: once in turn.

        The drives hold meanwhile. Only once: steps that are never asked end by no alarm and no cancelling.
        """
        late = (
            self._pace is Pace.REAL_TIME
            and self._syncing
            and self._clock() - self._synced_s > OLD_SAMPLE_S
        )
        self._looking_again = late and not self._looking_again
        return self._looking_again

    def _gone(self) -> HardwareError:
        return self.failure or BusError("The connection to the arm is closed.")

    def _owes_sync(self) -> bool:
        """Whether a simulated arm still has to live through the moments after STOP."""
        if not self.stop_latched:
            self._syncs_owed = SYNCS_AFTER_STOP
        elif self._syncs_owed > 0:
            self._syncs_owed -= 1
            return True
        return False

    def _advance(self, task: LoopTask) -> None:
        """Run a task until its next SYNC has been answered, or to its end."""
        try:
            commands = task.advance(self.sample)
            if commands is not None:
                self._allow(self.sample, self.commands, commands)
        except StopIteration as stop:
            self._tasks.finish_first(result=stop.value)
            return
        except Exception as error:  # noqa: BLE001 - handed to the caller, who raises it
            self._tasks.finish_first(error=error)
            return
        if commands is not None:
            self.commands = commands
        self._cycle()

    def _cycle(self) -> None:
        """One SYNC: commands out, SYNC, wait for the answers."""
        if self._pace is Pace.REAL_TIME:
            self._wait_for_tick()
        self._drain()  # late answers, to no sample any more, and second ones
        if self.commands is not None:
            self._sender.send(self.commands, self.sample.sync_count, moving=self.moving)
        self._sampler.open()
        self._synced_s = self._clock()
        self._wire.send(COB_SYNC, b"")
        deadline = self._clock() + self._answer_timeout_s
        overtime = FRAMES_AT_A_TIME
        while self._sampler.waiting > 0 and not self._closing and overtime > 0:
            left = deadline - self._clock()
            # Late ourselves, we look at what has come meanwhile before we call anybody silent.
            wait_s = min(max(left, 0.0), 0.5 * self._timing.heartbeat_period_s)
            if left <= 0.0:
                overtime -= 1
            if not self._receive_one(wait_s) and left <= 0.0:
                break
            self._beat()
        self._sampler.close()
        before = self.watch.dropout.dropouts
        if self.watch.update(
            self.sample,
            self.commands,
            answered_late=self._sampler.answered_late,
            stopped=self.latch.latched,
        ):
            self.latch.press(self.watch.divergence)
            self._sender.stop_all(self.commands)
        elif self.commands is not None and self.watch.dropout.dropouts != before:
            self._sender.send(self.commands, self.sample.sync_count, moving=False)  # at once

    def _drain(self) -> None:
        """Look at what has arrived, as far as there is time for it."""
        for _ in range(FRAMES_AT_A_TIME):
            if not self._receive_one(0.0):
                return
            self._beat()

    def _receive_one(self, timeout_s: float) -> bool:
        """Take one frame off the bus and see to it; false if there was none."""
        asked_s = self._clock()
        message = self._wire.receive(timeout_s)
        if message is None:
            self.latency.queue_empty(asked_s)
            return False
        # What a frame waited for us is our own lateness, and makes it old all the same.
        waited_s = self.latency.frame_read(message.timestamp)
        came_s, late_s = self._clock() - waited_s, self.latency.late_s - waited_s
        identifier: int = message.arbitration_id
        if self._sampler.note(identifier, message.data, came_s, late_s):
            return True
        if COB_SDO_FROM_SERVER < identifier <= COB_SDO_FROM_SERVER + OPERATOR_NODE:
            self._on_sdo(identifier, bytes(message.data))
        else:
            if self._watching:
                self.nodes.note_command(identifier, message.data)
            self.nodes.note(
                identifier, message.data, self.latency.listened_s, self.sample.sync_count
            )
        return True

    def _beat(self) -> None:
        now = self._clock()
        if self._beating and now >= self._next_beat_s:
            self._next_beat_s = now + self._timing.heartbeat_period_s
            self._wire.send(COB_HEARTBEAT + OPERATOR_NODE, bytes([NmtState.OPERATIONAL]))

    def _wait_for_tick(self) -> None:
        """Receive until the next control period begins; a late one starts a new count."""
        now = self._clock()
        if now > self._next_tick_s + self._timing.tick_s:
            self._next_tick_s = now
        while now < self._next_tick_s and not self._closing:
            self._receive_one(self._next_tick_s - now)
            self._beat()
            now = self._clock()
        self._next_tick_s += self._timing.tick_s
