"""The one thread that owns all cyclic traffic: SYNC, samples, commands, heartbeat. Knows no calibration.

It also receives every frame, so that nothing hops between threads: SDO answers are handed on to the
callers that wait for them. What the arm is to do comes as steps (`hardware.tasks.Steps`), one at a
time.

How fast it goes, and how long anybody is waited for, is `hardware.timing`'s affair.

The next SYNC does not overtake a late answer: a sample is closed when all joints have answered, or
when their time is up and nothing more has come.

STOP does not come through here. It presses `latch` and sends its frames by itself; the loop looks
at the latch before and after the commands it sends, so that the last word on the bus is quick stop.
"""

from __future__ import annotations

import sys
import threading
import time
from collections.abc import Callable, Sequence
from typing import Any, Protocol

from hardware.alarms import Seen, find_alarm
from hardware.attention import Attention
from hardware.continuity import Continuity, Jump
from hardware.cyclic import Abandoned, Sample, Setpoint, Setpoints, frames_of
from hardware.errors import BusError, HardwareError
from hardware.following import Astray, Following
from hardware.node_watch import NodeWatch
from hardware.objects import (
    COB_HEARTBEAT,
    COB_SDO_FROM_SERVER,
    COB_SYNC,
    OPERATOR_NODE,
    NmtState,
)
from hardware.priority import ahead_of_its_program
from hardware.profile import BusProfile
from hardware.sampling import Sampler, View
from hardware.stop_line import StopLatch
from hardware.tasks import Steps, Task, TaskQueue
from hardware.timing import Pace, Timing

SWITCH_INTERVAL_S = 0.0005
"""Python's default of 5 ms would let a busy thread of this process delay a SYNC by as much."""


FRAMES_AT_A_TIME = 200
"""Frames looked at before what is due is seen to: on a bus with a frame always waiting, heartbeat and SYNC
must not wait for the last of them."""

SYNCS_AFTER_STOP = 20
"""In fast forward, so that the drives come to rest and say that they have stopped."""


class Link(Protocol):
    """What the loop needs of a `hardware.wire.Wire`."""

    def send(self, identifier: int, data: bytes) -> None:
        """Send a frame."""
        ...

    def receive(self, timeout_s: float) -> Any:
        """Next frame or None."""
        ...


def _moves_on(before: Setpoint | None, command: Setpoint) -> bool:
    """Whether nothing but the target is another: a move on its way."""
    return before is not None and (before.controlword, before.mode) == (
        command.controlword,
        command.mode,
    )


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
    allowed_counts
        By joint: how far a reading may seem to jump between two SYNCs by noise alone; empty: joints
        are not watched for it.
    quick_stop
        Sends quick stop to all drives; must not wait.
    clock
        Monotonic time, s.

    Attributes
    ----------
    attention
        How late this loop itself has been: silences of the nodes are measured without that.
    commands
        Sent last, or None before control was taken.
    latch
        Of STOP. Whoever has one that outlives the connection sets it before `start`.
    moving
        Steps are moving the arm.
    failure
        Why the thread has ended.
    heartbeat_timeout_s
        Silence after which a node is lost; set before `begin_sync`.
    jump, astray
        The first jump of a joint's reading that was no motion, and the first joint that was not where it
        was told to be; None if there was none.
    following
        Watches for the latter; set before `begin_sync`.
    """

    def __init__(
        self,
        wire: Link,
        *,
        profile: BusProfile,
        pace: Pace,
        on_sdo: Callable[[int, bytes], None],
        allow: Callable[[Sample, Setpoints | None, Setpoints], None],
        quick_stop: Callable[[], None],
        timing: Timing,
        allowed_counts: Sequence[float] = (),
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.nodes = NodeWatch(profile)
        self.commands: Setpoints | None = None
        self.latch = StopLatch()
        self.moving = False
        self.failure: HardwareError | None = None
        self.jump: Jump | None = None
        self.astray: Astray | None = None
        self.following = Following()
        self._watched = bool(allowed_counts)
        self._continuity = Continuity(allowed_counts)
        self._wire, self._frames, self._pace = wire, frames_of(profile), pace
        self._on_sdo, self._allow, self._quick_stop = on_sdo, allow, quick_stop
        self._timing, self._clock = timing, clock
        self.heartbeat_timeout_s = timing.heartbeat_timeout_s
        self.attention = Attention(clock)
        self._answer_timeout_s = timing.answer_timeouts_s[pace]
        self._sampler = Sampler(self._frames, patience=timing.misses(pace), now_s=clock())
        self._sent: list[Setpoint | None] = [None] * len(self._frames)
        self._thread = threading.Thread(target=self._run, name="sarcal-control", daemon=True)
        self._tasks = TaskQueue(self._thread.is_alive, self._gone)
        self._syncing = False
        self._watching = False
        self._syncs_owed = SYNCS_AFTER_STOP
        self._beating = False
        self._next_beat_s = 0.0
        self._next_tick_s = 0.0
        self._closing = False

    # ---- for other threads -----------------------------------------------------------------------

    @property
    def stop_latched(self) -> bool:
        """STOP was pressed: nothing but quick stop goes to the drives."""
        return self.latch.latched

    @property
    def view(self) -> View:
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
        self.jump = self.astray = None

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
        return self._tasks.run(Task(steps, despite))

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
            Seen(
                stop_latched=self.stop_latched,
                lost_joints=self._sampler.lost(),
                doubled_joints=self._sampler.doubled(),
                jump=self.jump,
                astray=self.astray,
            ),
            now_s=self.attention.listened_s,
            heartbeat_timeout_s=self.heartbeat_timeout_s,
            despite=() if task is None else task.despite,
        )
        if found is None and task is not None and task.abandoned:
            return Abandoned("the command was given up")
        return found

    # ---- the thread ------------------------------------------------------------------------------

    def _run(self) -> None:
        ahead_of_its_program()
        try:
            self._drain()  # what an adapter still had: whoever said it may be gone
            self._watching = True
            while not self._closing:
                task = self._tasks.first
                if task is not None:
                    self._advance(task)
                elif self._syncing and (self._pace is Pace.REAL_TIME or self._owes_sync()):
                    self._cycle()
                else:
                    self._receive_one(self._timing.idle_poll_s)
                self._beat()
        except HardwareError as error:
            self.failure = error
        finally:
            self._tasks.finish_all(self._gone())

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

    def _advance(self, task: Task) -> None:
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
        self._send_commands()
        self._sampler.open()
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
        if self.jump is None and self._watched:
            if self._sampler.answered_late:
                self._continuity.interrupt()
            self.jump = self._continuity.see(self.sample)
        if self.astray is None and not self.stop_latched:
            self.astray = self.following.see(self.sample, self.commands)

    def _drain(self) -> None:
        """Look at what has arrived, as far as there is time for it."""
        for _ in range(FRAMES_AT_A_TIME):
            if not self._receive_one(0.0):
                return
            self._beat()

    def _send_commands(self) -> None:
        """Send what changed, and one joint's command again in turn in case a frame was lost."""
        if self.commands is None:
            return
        again = self.sample.sync_count % len(self._frames)
        for joint, command in enumerate(self.commands):
            if command == self._sent[joint] and joint != again:
                continue
            if self.stop_latched:
                break
            before = self._sent[joint]
            if before != command and not (self.moving and _moves_on(before, command)):
                self._continuity.disturb()
            for identifier, data in self._frames[joint].pack(command):
                self._wire.send(identifier, data)
            self._sent[joint] = command
        if self.stop_latched:
            self._sent = [None] * len(self._frames)
            self._quick_stop()

    def _receive_one(self, timeout_s: float) -> bool:
        """Take one frame off the bus and see to it; false if there was none."""
        message = self._wire.receive(timeout_s)
        self.attention.look()
        if message is None:
            return False
        identifier: int = message.arbitration_id
        if self._sampler.note(identifier, message.data, self._clock(), self.attention.late_s):
            return True
        if COB_SDO_FROM_SERVER < identifier <= COB_SDO_FROM_SERVER + OPERATOR_NODE:
            self._on_sdo(identifier, bytes(message.data))
        else:
            if self._watching:
                self.nodes.note_command(identifier, message.data)
            self.nodes.note(
                identifier, message.data, self.attention.listened_s, self.sample.sync_count
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
