"""Traffic of each SYNC: sends commands or quick stop, and collects the answers in a sample."""

from collections import deque
from collections.abc import Callable, Sequence
from dataclasses import dataclass, replace

from hardware.canopen.bus_profile import FEEDBACK_OBJECTS
from hardware.canopen.cia402 import CONTROLWORD_DISABLE_VOLTAGE
from hardware.canopen.cyclic import MAX_LATE_SYNCS, JointFrames, Sample, Setpoint, Setpoints
from hardware.control.stop_line import StopLatch
from hardware.monitors.joint_monitor import JointMonitor


class CommandSender:
    """Sends commands in the control loop's thread. `quick_stop` must not wait.

    STOP sends its own frames in another thread. The STOP latch is therefore checked before and after the commands are
    sent, so that quick stop is the last command on the bus. A stop also switches off the drives of the joints in
    `JointMonitor.switched_off`, so that their valves block: joints that moved without a command and, when the arm is
    released, those that have not obeyed STOP. A drive that was switched off at the drive itself is not enabled again.
    """

    def __init__(
        self,
        send: Callable[[int, bytes], None],
        frames: Sequence[JointFrames],
        latch: StopLatch,
        watch: JointMonitor,
        quick_stop: Callable[[], None],
    ) -> None:
        self._send, self._frames = send, tuple(frames)
        self._latch, self._watch, self._quick_stop = latch, watch, quick_stop
        self._sent: list[Setpoint | None] = [None] * len(self._frames)

    def send(self, commands: Setpoints, sync_count: int, *, moving: bool) -> None:
        """Send the commands that changed, and repeat the command of one joint (in turn), since frames may be lost."""
        repeated = sync_count % len(self._frames)
        dropout = self._watch.dropout
        for joint, joint_command in enumerate(commands):
            before, command = self._sent[joint], dropout.command(joint + 1, joint_command)
            if command is None or (command == before and joint != repeated):
                continue
            if self._latch.latched:
                break
            retargeted = before and replace(before, target_counts=command.target_counts)
            if before != command and not (moving and command == retargeted):
                self._watch.continuity.expect_jerk()
            for identifier, data in self._frames[joint].pack(command):
                self._send(identifier, data)
            self._sent[joint] = command
        if self._latch.latched:
            self.stop_all(commands)

    def stop_all(self, commands: Setpoints | None) -> None:
        """Switch off the drives of the joints in `watch.switched_off`, then send quick stop to all drives.

        Raises `BusError` if a frame could not be sent; quick stop is sent in any case.
        """
        self._sent = [None] * len(self._frames)
        try:
            for at, command in enumerate(commands or ()):
                if at + 1 not in self._watch.switched_off:
                    continue
                switch_off = replace(command, controlword=CONTROLWORD_DISABLE_VOLTAGE)
                # Not through STOP's handle: commands from there other than quick stop count as another master's.
                for identifier, data in self._frames[at].pack_controlword(switch_off):
                    self._send(identifier, data)
        finally:
            self._quick_stop()


DUPLICATE_SYNCS = 10
"""Number of surplus answers that show two devices with the node number of a joint; fewer may be doubled frames."""
SURPLUS_DECAY = 0.75
"""Amount by which a single answer to a SYNC reduces the number of surplus answers. A second device that answers every
other SYNC is found after 0.8 s; with 10 % of all frames doubled, a joint has one false alarm in thousands of hours."""

SPEED_SYNCS = 5
"""Speeds are means over this many control periods."""


@dataclass(frozen=True, slots=True)
class CyclicView:
    """Latest sample, for other threads. The object never changes: the next sample comes in a new object.

    `earlier`: the sample `SPEED_SYNCS` SYNCs before, or the first. `late_at_s`: host latency up to each joint's answer.
    """

    sample: Sample
    earlier: Sample
    answered_at_s: tuple[float, ...]
    late_at_s: tuple[float, ...]


class Sampler:
    """Collects the answers of joints 1..n; a joint has answered when all of its TPDOs have come.

    A joint that missed `max_misses` samples in a row is lost: no sample waits for that joint until it answers again.
    """

    def __init__(self, frames: Sequence[JointFrames], *, max_misses: int, now_s: float) -> None:
        joints = len(frames)
        self._max_misses = max_misses
        self._parts = {
            identifier: (at, part, answer)
            for at, joint in enumerate(frames)
            for part, (identifier, answer) in enumerate(joint.answers.items())
        }
        self._blank = [(0,) * len(joint.answers) for joint in frames]
        self._received = [list(none) for none in self._blank]
        self._closed = [list(none) for none in self._blank]
        self._states = [dict.fromkeys(FEEDBACK_OBJECTS, 0) for _ in frames]
        self._answered_at_s = [now_s] * joints
        self._late_at_s = [0.0] * joints
        self._missed = [0] * joints
        self._awaited = [False] * joints
        self._surplus = [0.0] * joints
        self._overdue = [0] * joints
        self._wrong_lengths: dict[int, tuple[int, str]] = {}
        blank = Sample(sync_count=0, **self._columns(), missing=tuple(range(1, joints + 1)))
        self._history: deque[Sample] = deque(maxlen=SPEED_SYNCS)
        self.view = CyclicView(blank, blank, tuple(self._answered_at_s), tuple(self._late_at_s))
        """The latest sample and when each joint answered, to be read from any thread."""
        self.waiting = 0
        """Number of joints whose answer to the current SYNC is still expected."""
        self.answered_late = False
        """Whether a joint answered after the previous sample closed: that sample may hold answers to earlier SYNCs."""

    def open(self) -> None:
        """Begin a sample, just before its SYNC is sent."""
        self.answered_late = self._received != self._closed
        # A second answer may come after its sample was closed and, if it comes after the next SYNC, counts in the next
        # sample. So the surplus of answers is accumulated, and reduced for each sample with one answer.
        for at, received in enumerate(self._received):
            answers = max(received)
            # A delayed node delivers overdue answers later, all at once or one by one: they are no surplus.
            late = min(self._overdue[at], max(answers - 1, 0))
            self._overdue[at] = min(self._overdue[at] - late + (answers == 0), MAX_LATE_SYNCS)
            surplus = answers - 1 - late if answers - late > 1 else -SURPLUS_DECAY
            # One more, so that a report persists while every other SYNC is answered twice.
            self._surplus[at] = min(max(self._surplus[at] + surplus, 0.0), DUPLICATE_SYNCS + 1.0)
            received[:] = self._blank[at]
        self._awaited = [missed < self._max_misses for missed in self._missed]
        self.waiting = sum(self._awaited)

    def note(
        self, identifier: int, data: bytes | bytearray, now_s: float, late_s: float = 0.0
    ) -> bool:
        """Take in a frame; return whether the frame is a TPDO of a joint. `late_s`: accumulated host latency, s.

        A TPDO of the wrong length does not count as an answer; see `wrong_lengths`.
        """
        part_read = self._parts.get(identifier)
        if part_read is None:
            return False
        at, part, answer = part_read
        values = answer.unpack(data)
        if values is None:
            text = f"its TPDO {identifier:03X}h has {len(data)} bytes, expected {answer.size}"
            self._wrong_lengths[identifier] = at + 1, text
            return True
        self._wrong_lengths.pop(identifier, None)
        self._states[at].update(values)
        self._answered_at_s[at] = now_s
        self._late_at_s[at] = late_s
        received = self._received[at]
        received[part] += 1
        if self._missed[at] >= self._max_misses:
            self._missed[at] = 0  # a lost joint is back, even if its sample was closed
        elif self._awaited[at] and received[part] == min(received) == 1:
            self.waiting -= 1
        return True

    def close(self) -> None:
        """End the collection of answers to this SYNC, and put the sample into `view`."""
        self._closed = [list(received) for received in self._received]
        for at, received in enumerate(self._received):
            self._missed[at] = 0 if min(received) else self._missed[at] + 1
        sample = Sample(
            sync_count=self.view.sample.sync_count + 1,
            **self._columns(),
            # If a joint answered twice, one of its answers belongs to another SYNC.
            missing=tuple(
                j
                for j, received in enumerate(self._received, 1)
                if not min(received) == max(received) == 1
            ),
            overdue=tuple(self._overdue),
        )
        earlier = self._history[0] if self._history else sample
        self._history.append(sample)
        self.view = CyclicView(sample, earlier, tuple(self._answered_at_s), tuple(self._late_at_s))

    def duplicates(self) -> tuple[int, ...]:
        """Return the joints that repeatedly answer a SYNC more than once."""
        return tuple(j for j, times in enumerate(self._surplus, 1) if times >= DUPLICATE_SYNCS)

    def lost(self) -> tuple[int, ...]:
        """Return the joints that have missed so many samples that no sample waits for them any more."""
        return tuple(j for j, missed in enumerate(self._missed, 1) if missed >= self._max_misses)

    def wrong_lengths(self) -> dict[int, str]:
        """Describe, by joint, the last TPDO whose length differs from the profile's."""
        return dict(self._wrong_lengths.values())

    def _columns(self) -> dict[str, tuple[int, ...]]:
        statuswords, counts, torques = zip(*(state.values() for state in self._states), strict=True)
        return {"statuswords": statuswords, "counts": counts, "torques_per_mille": torques}
