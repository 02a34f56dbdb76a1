import itertools
import os
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field
from types import SimpleNamespace

import can
import numpy as np
import pytest

from hardware import timing
from hardware.arm import HostLatency
from hardware.buses.python_can import ArmOnBus, BusSettings, stamping_clock
from hardware.canopen.cyclic import Sample
from hardware.canopen.objects import COB_HEARTBEAT, COB_SYNC, COB_TPDO1, NmtState
from hardware.control import control_loop
from hardware.control.control_loop import ControlLoop
from hardware.control.stop_line import StopLatch
from hardware.errors import BusError
from hardware.monitors.joint_monitor import JointMonitor
from tests.oracles.profiles import sarcos


def priority_of_a_thread(**options: Callable[[], None]) -> tuple[int, int]:
    with ThreadPoolExecutor(1, **options) as pool:
        policy, parameter = pool.submit(os.sched_getscheduler, 0), pool.submit(os.sched_getparam, 0)
        return policy.result(), parameter.result().sched_priority


def priority_of_a_loop() -> int:
    return priority_of_a_thread(initializer=timing.raise_loop_priority)[1]


def real_time_is_allowed() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


@pytest.mark.skipif(
    not real_time_is_allowed(), reason="this user may not ask for real-time priority"
)
def test_real_time_priority_applies_inside_context_only():
    with timing.real_time_priority():
        assert priority_of_a_thread() == (os.SCHED_RR, timing.PRIORITY)
        assert priority_of_a_loop() == timing.LOOP_PRIORITY > timing.PRIORITY
    assert priority_of_a_thread() == (os.sched_getscheduler(0), 0) == (os.SCHED_OTHER, 0)
    assert priority_of_a_loop() == 0


def test_denied_real_time_priority_is_ignored(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with timing.real_time_priority():
        assert priority_of_a_thread() == (os.SCHED_OTHER, 0)


JOINTS = 2
TIME_OF_DAY_S = 1.7e9
"""Time of the stamping clock when the monotonic clock shows 0."""
NODES = (1, 2, 16)


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s

    def stamps(self) -> float:
        return self.now_s + TIME_OF_DAY_S


@dataclass
class Bus:
    """Queue of received frames; on an empty queue, the receiver's time-out passes at once."""

    clock: Clock
    queue: deque[can.Message] = field(default_factory=deque)
    suspended_for_s: float = 0.0
    """Latency before the next poll."""
    suspended_after_sync_for_s: float = 0.0
    """Latency after the next SYNC, with its answers in the queue."""
    on_sync: Callable[[], None] = lambda: None
    sent: list[tuple[int, float]] = field(default_factory=list)
    """Identifiers and times of the frames."""
    flooded: bool = False
    """Whether a frame of another device is always waiting, one every 0.1 ms; the arm does not answer SYNC."""
    scenario: Iterator[None] = field(default_factory=lambda: itertools.repeat(None))
    """Advances by one step before each poll."""

    def send(self, identifier: int, _data: bytes) -> None:
        """Answer every SYNC at once."""
        self.sent.append((identifier, self.clock.now_s))
        if identifier == COB_SYNC:
            self.on_sync()
            answering = () if self.flooded else range(1, JOINTS + 1)
            self.queue.extend(
                can.Message(
                    arbitration_id=COB_TPDO1 + joint, data=bytes(8), timestamp=self.clock.stamps()
                )
                for joint in answering
            )
            self.clock.now_s += self.suspended_after_sync_for_s
            self.suspended_after_sync_for_s = 0.0

    def receive(self, timeout_s: float) -> can.Message | None:
        next(self.scenario)
        self.clock.now_s += self.suspended_for_s
        self.suspended_for_s = 0.0
        if self.flooded:
            self.clock.now_s += 1e-4
            return can.Message(arbitration_id=0x555, timestamp=self.clock.stamps())
        if self.queue:
            return self.queue.popleft()
        self.clock.now_s += timeout_s
        return None

    def beat(self) -> Iterator[None]:
        """Queue a heartbeat of each node, and let the loop receive them."""
        self.queue.extend(
            can.Message(arbitration_id=COB_HEARTBEAT + node, data=[NmtState.OPERATIONAL])
            for node in NODES
        )
        yield from itertools.repeat(None, len(NODES) + 1)


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def bus(clock):
    return Bus(clock)


@pytest.fixture
def loop(bus, monkeypatch):
    monkeypatch.setattr(control_loop, "stamping_clock", lambda _: bus.clock.stamps)
    return ControlLoop(
        bus,
        ArmOnBus(SimpleNamespace(), BusSettings(), sarcos(JOINTS)),
        on_sdo=lambda *_: None,
        allow=lambda *_: None,
        quick_stop=lambda: None,
        watch=JointMonitor([4.0] * JOINTS),
        latch=StopLatch(),
        clock=bus.clock,
    )


def play(loop: ControlLoop, bus: Bus, scenario: Iterator[None]) -> None:
    """Run the loop in this thread until the scenario ends."""

    def to_the_end() -> Iterator[None]:
        yield from scenario
        loop.close()
        yield from itertools.repeat(None)

    bus.scenario = to_the_end()
    loop._run()


@pytest.mark.parametrize(
    ("flooded", "identifier", "shortest_s", "longest_s"),
    [
        (False, COB_SYNC, 0.01 - 1e-6, 0.01 + 1e-6),
        (False, 0x77F, 0.1 - 1e-6, 0.1 + 1e-6),
        (True, COB_SYNC, 0.0, 0.1),
        (True, 0x77F, 0.0, 0.101),
    ],
)
def test_sync_and_heartbeat_keep_their_periods(
    bus, loop, flooded, identifier, shortest_s, longest_s
):
    def two_seconds() -> Iterator[None]:
        until_s = bus.clock.now_s + 2.0
        while bus.clock.now_s < until_s:
            yield

    bus.flooded = flooded
    loop.begin_sync()
    loop.begin_heartbeat()
    play(loop, bus, two_seconds())
    gaps_s = np.diff([time_s for sent, time_s in bus.sent if sent == identifier])
    assert len(gaps_s) >= 18
    assert shortest_s < gaps_s.min() <= gaps_s.max() < longest_s


@pytest.mark.parametrize(("times", "suspended_s"), [(1, 5.0), (50, 0.7)])
def test_suspended_loop_reports_no_silence(bus, loop, times, suspended_s):
    def scenario() -> Iterator[None]:
        for _ in range(times):
            yield from bus.beat()
            bus.suspended_for_s = suspended_s
            yield
            assert loop.alarm() is None
        yield from bus.beat()
        assert loop.alarm() is None
        late_s = suspended_s - timing.MAX_POLL_GAP_S
        assert loop.latency.late_s == pytest.approx(times * late_s, abs=times * 0.03)

    play(loop, bus, scenario())


def test_silence_is_reported_despite_host_latency(bus, loop):
    def scenario() -> Iterator[None]:
        yield from bus.beat()
        bus.suspended_for_s = 5.0
        until_s = bus.clock.now_s + 6.25
        while bus.clock.now_s < until_s:
            yield
        alarm = loop.alarm()
        assert isinstance(alarm, BusError)
        assert "no heartbeat from nodes 1, 2, 16" in str(alarm)

    play(loop, bus, scenario())


def test_queued_answer_has_age_of_its_stamp(bus, loop):
    """Before each SYNC, 10 ms after the last: the greatest age of an answer, and the host's share of it."""
    ages: list[float] = []
    host_shares: list[float] = []
    latencies: list[HostLatency] = []

    def record() -> None:
        ages.append(max(bus.clock.now_s - at for at in loop.sampler.view.answered_at_s))
        host_shares.append(max(loop.latency.late_s - at for at in loop.sampler.view.late_at_s))
        latencies.append(loop.latency.lateness)
        if len(ages) == 4:
            bus.suspended_after_sync_for_s = 0.7
        elif len(ages) == 6:
            loop.close()

    bus.on_sync = record
    loop.begin_sync()
    play(loop, bus, itertools.repeat(None))
    assert ages[1:6] == pytest.approx([0.01, 0.01, 0.01, 0.7, 0.01], abs=0.001)
    assert host_shares[4] == pytest.approx(0.7, abs=timing.MAX_POLL_GAP_S + 1e-6)
    late_s = pytest.approx(0.7, abs=1e-6)
    assert latencies[4] == latencies[5] == HostLatency(times=1, last_s=late_s, longest_s=late_s)


def sync_counts_of_steps(
    loop: ControlLoop, count: int, before: Callable[[int], None] = lambda _: None
) -> list[int]:
    """Return the SYNC counts of the samples that so many motion steps get."""
    sync_counts: list[int] = []

    def steps() -> Generator[None, Sample, None]:
        for k in range(count):
            before(k)
            sync_counts.append((yield None).sync_count)

    loop.begin_sync()
    loop.start()
    loop.run(steps())
    loop.close()
    return sync_counts


def test_stale_sample_is_not_passed_to_steps(bus, loop):
    def suspend(step: int) -> None:
        bus.suspended_after_sync_for_s = 0.4 if step == 3 else 0.0

    first, *others = sync_counts_of_steps(loop, 6, suspend)
    assert [count - first for count in others] == [1, 2, 4, 5, 6]


def test_steps_proceed_under_permanent_latency(bus, loop):
    """So that an alarm, or Ctrl-C, still ends them."""
    bus.on_sync = lambda: setattr(bus, "suspended_after_sync_for_s", 0.4)
    sync_counts = sync_counts_of_steps(loop, 3)
    assert len(sync_counts) == 3
    assert sync_counts[-1] - sync_counts[0] < 20


def test_listened_time_never_exceeds_elapsed_time(clock):
    latency = timing.LatencyMonitor(clock)
    for gap_s in (0.01, timing.MAX_POLL_GAP_S, 0.3, 2.0, 0.0):
        clock.now_s += gap_s
        latency.frame_read()
    assert latency.late_s == pytest.approx(0.2 + 1.9)
    clock.now_s += 1.0  # without a poll
    assert latency.late_s == pytest.approx(3.0)
    assert clock.now_s - latency.listened_s == pytest.approx(3.0)


@pytest.mark.parametrize("step_s", [-3600.0, -0.5, -0.02, 0.02, 0.5, 3600.0])
def test_clock_step_does_not_exceed_possible_frame_age(clock, step_s):
    offset_s = 0.0
    latency = timing.LatencyMonitor(clock, lambda: clock.stamps() + offset_s)
    for cycle in range(30):
        latency.queue_empty(clock.now_s)
        stamp_s = clock.stamps() + offset_s
        if cycle == 10:  # while the frame is in the queue
            offset_s = step_s
        clock.now_s += 0.010
        waited_s = latency.frame_read(stamp_s)
        # The frame in the queue gets the greatest possible age, or 0; all others get their true age.
        expected_s = min(max(0.010 + step_s, 0.0), 0.010) if cycle == 10 else 0.010
        assert waited_s == pytest.approx(expected_s, abs=1e-6)
    assert latency.lateness == HostLatency()


def test_backlog_is_measured_by_stamps(clock):
    """A frame every millisecond, and 1.2 ms to process each: the queue is never empty, and polls never pause."""
    latency = timing.LatencyMonitor(clock, clock.stamps)
    latency.queue_empty(clock.now_s)
    arrived_s = clock.now_s
    for _ in range(3000):
        arrived_s += 0.001
        clock.now_s = max(clock.now_s + 0.0012, arrived_s)
        waited_s = latency.frame_read(arrived_s + TIME_OF_DAY_S)
        assert waited_s == pytest.approx(clock.now_s - arrived_s, abs=1e-6)
    assert latency.late_s == 0.0
    assert latency.lateness.times == 1
    assert latency.lateness.last_s == pytest.approx(0.6, abs=1e-3)


@pytest.mark.parametrize(
    ("own_stamps", "stamp_s"), [(False, 0.0), (False, 12.5), (False, TIME_OF_DAY_S), (True, 0.0)]
)
def test_frame_without_own_stamp_has_no_latency(clock, own_stamps, stamp_s):
    latency = timing.LatencyMonitor(clock, clock if own_stamps else None)
    latency.queue_empty(clock.now_s)
    clock.now_s += 5.0
    assert latency.frame_read(stamp_s) == 0.0


@pytest.mark.parametrize(
    ("clock", "interfaces"),
    [
        (time.time, "socketcan loopback udp_multicast virtual"),
        (None, "slcan kvaser pcan gs_usb socketcand vector"),
    ],
)
def test_only_local_interfaces_have_a_stamping_clock(clock, interfaces):
    for interface in interfaces.split():
        assert stamping_clock(BusSettings(interface=interface)) is clock


@pytest.mark.parametrize(("arm_waits", "times"), [(False, 1), (True, 0)])
def test_waiting_arm_has_no_latency(clock, arm_waits, times):
    latency = timing.LatencyMonitor(clock, arm_waits=arm_waits)
    clock.now_s += 2.0
    latency.frame_read()
    assert latency.lateness.times == times


def test_each_latency_is_counted_once(clock):
    latency = timing.LatencyMonitor(clock)
    clock.now_s += 5.0  # before monitoring begins
    latency.begin()
    for gap_s in (0.1, timing.REPORTED_S - 0.01, 0.8, 0.05, 0.4, *[0.05] * 50, 0.5):
        clock.now_s += gap_s
        latency.frame_read()
        latency.queue_empty(clock.now_s)
    assert latency.lateness == HostLatency(
        times=3, last_s=pytest.approx(0.5), longest_s=pytest.approx(0.8)
    )
