"""Whoever keeps the time of an arm runs before others, as far as the system allows it."""

import itertools
import os
import threading
import time
from collections import deque
from collections.abc import Callable, Generator, Iterator
from concurrent.futures import ThreadPoolExecutor
from dataclasses import dataclass, field

import can
import pytest

from hardware.arm import HostLatency
from hardware.buses.python_can import BusSettings, stamping_clock
from hardware.canopen.cyclic import Sample
from hardware.canopen.objects import COB_HEARTBEAT, COB_SYNC, COB_TPDO1, NmtState
from hardware.control.control_loop import ControlLoop
from hardware.errors import BusError
from hardware.timing import (
    LOOP_PRIORITY,
    MAX_POLL_GAP_S,
    PRIORITY,
    REPORTED_S,
    LatencyMonitor,
    Pace,
    Timing,
    raise_loop_priority,
    real_time_priority,
)
from tests.oracles.profiles import sarcos


def in_a_thread(ask: Callable[[], int]) -> int:
    with ThreadPoolExecutor(1) as side:
        return side.submit(ask).result()


def policy_of_a_thread() -> int:
    return in_a_thread(lambda: os.sched_getscheduler(0))


def priority_of_a_loop() -> int:
    def loop() -> int:
        raise_loop_priority()
        return os.sched_getparam(0).sched_priority

    return in_a_thread(loop)


def allowed() -> bool:
    before = os.sched_getscheduler(0), os.sched_getparam(0)
    try:
        os.sched_setscheduler(0, os.SCHED_RR, os.sched_param(1))
    except PermissionError:
        return False
    os.sched_setscheduler(0, *before)
    return True


@pytest.mark.skipif(not allowed(), reason="this user may not ask for real-time priority")
def test_threads_started_inside_have_real_time_priority():
    with real_time_priority():
        assert policy_of_a_thread() == os.SCHED_RR
    assert policy_of_a_thread() == os.sched_getscheduler(0) == os.SCHED_OTHER


def test_denied_real_time_priority_is_ignored(monkeypatch):
    def refuse(*_: object) -> None:
        raise PermissionError

    monkeypatch.setattr(os, "sched_setscheduler", refuse)
    with real_time_priority():
        assert policy_of_a_thread() == os.SCHED_OTHER


@pytest.mark.skipif(not allowed(), reason="this user may not ask for real-time priority")
def test_loop_priority_exceeds_program_priority():
    with real_time_priority():
        assert priority_of_a_loop() == LOOP_PRIORITY > PRIORITY
        assert os.sched_getparam(0).sched_priority == PRIORITY
    assert priority_of_a_loop() == 0


JOINTS = 2
TIME_OF_DAY_S = 1.7e9
"""What the clock that stamps frames shows when the monotonic one shows 0."""
NODES = (1, 2, 16)


@dataclass
class Clock:
    now_s: float = 100.0

    def __call__(self) -> float:
        return self.now_s


@dataclass
class Bus:
    """Frames that wait; an empty bus lets the time pass that the receiver is ready to wait."""

    clock: Clock
    waiting: deque[can.Message] = field(default_factory=deque)
    kept_from_running_s: float = 0.0
    kept_from_answering_s: float = 0.0
    sent: list[tuple[int, bytes]] = field(default_factory=list)
    on_sync: Callable[[], None] = lambda: None
    scenario: Iterator[None] = field(default_factory=lambda: iter(()))
    """Goes on by one step before each look at the bus, in the loop's own thread."""
    over: threading.Event = field(default_factory=threading.Event)
    failure: AssertionError | None = None

    def send(self, identifier: int, data: bytes) -> None:
        """Every SYNC is answered at once, while somebody computes for a while, or nobody does."""
        self.sent.append((identifier, data))
        if identifier == COB_SYNC:
            self.on_sync()
            self.waiting.extend(
                can.Message(
                    arbitration_id=COB_TPDO1 + joint, data=bytes(8), timestamp=self.stamps()
                )
                for joint in range(1, JOINTS + 1)
            )
            self.clock.now_s += self.kept_from_answering_s
            self.kept_from_answering_s = 0.0

    def stamps(self) -> float:
        return self.clock.now_s + TIME_OF_DAY_S

    def receive(self, timeout_s: float) -> can.Message | None:
        try:
            next(self.scenario)
        except StopIteration:
            self.over.set()
        except AssertionError as failure:
            self.failure = failure
        self.clock.now_s += self.kept_from_running_s
        self.kept_from_running_s = 0.0
        if self.waiting:
            return self.waiting.popleft()
        self.clock.now_s += timeout_s
        return None

    def beat(self) -> None:
        self.waiting.extend(
            can.Message(arbitration_id=COB_HEARTBEAT + node, data=[NmtState.OPERATIONAL])
            for node in NODES
        )


@pytest.fixture
def bus():
    return Bus(Clock())


@pytest.fixture
def loop(bus):
    return ControlLoop(
        bus,
        profile=sarcos(JOINTS),
        pace=Pace.REAL_TIME,
        on_sdo=lambda *_: None,
        allow=lambda *_: None,
        quick_stop=lambda: None,
        timing=Timing(heartbeat_timeout_s=1.0),
        clock=bus.clock,
        stamps=bus.stamps,
    )


def looks(count: int) -> Iterator[None]:
    yield from itertools.repeat(None, count)


def play(loop: ControlLoop, bus: Bus, scenario: Iterator[None]) -> None:
    """Run the loop's thread until the scenario is over."""
    bus.scenario = scenario
    loop.start()
    assert bus.over.wait(60.0)
    loop.close()
    if bus.failure is not None:
        raise bus.failure


def test_suspended_loop_reports_no_silence(bus, loop):
    def scenario() -> Iterator[None]:
        bus.beat()
        yield from looks(4)
        bus.kept_from_running_s = 5.0
        yield
        assert loop.alarm() is None
        bus.beat()
        yield from looks(4)
        assert loop.alarm() is None
        assert loop.latency.late_s == pytest.approx(5.0 - MAX_POLL_GAP_S, abs=0.03)

    play(loop, bus, scenario())


def test_repeatedly_suspended_loop_reports_no_silence(bus, loop):
    def scenario() -> Iterator[None]:
        for _ in range(50):
            bus.kept_from_running_s = 0.7
            bus.beat()
            yield from looks(4)
            assert loop.alarm() is None

    play(loop, bus, scenario())


def test_silence_is_reported_despite_host_latency(bus, loop):
    def scenario() -> Iterator[None]:
        bus.beat()
        yield from looks(4)
        bus.kept_from_running_s = 5.0
        until_s = bus.clock.now_s + 6.25
        while bus.clock.now_s < until_s:
            yield
        alarm = loop.alarm()
        assert isinstance(alarm, BusError)
        assert "no heartbeat from node 1, 2, 16" in str(alarm)

    play(loop, bus, scenario())


def test_listened_time_never_exceeds_elapsed_time():
    clock = Clock()
    latency = LatencyMonitor(clock)
    for gap_s in (0.01, MAX_POLL_GAP_S, 0.3, 2.0, 0.0):
        clock.now_s += gap_s
        latency.frame_read()
    assert latency.late_s == pytest.approx(0.2 + 1.9)
    clock.now_s += 1.0  # nobody has looked since
    assert latency.late_s == pytest.approx(3.0)
    assert clock.now_s - latency.listened_s == pytest.approx(3.0)


def test_queued_answer_has_age_of_its_stamp(bus, loop):
    ages: list[float] = []
    own: list[float] = []
    """Of the sample before each SYNC, 10 ms later: the oldest age, and how much of it is our own."""
    found: list[HostLatency] = []

    def look() -> None:
        ages.append(max(bus.clock.now_s - at for at in loop.view.answered_at_s))
        own.append(max(loop.latency.late_s - at for at in loop.view.late_at_s))
        found.append(loop.latency.lateness)
        if len(ages) == 4:
            bus.kept_from_answering_s = 0.7
        elif len(ages) == 6:
            bus.over.set()

    bus.on_sync, bus.scenario = look, itertools.repeat(None)
    loop.begin_sync()
    loop.start()
    assert bus.over.wait(60.0)
    loop.close()
    assert ages[1:6] == pytest.approx([0.01, 0.01, 0.01, 0.7, 0.01], abs=0.001)
    # All of it is our own lateness, none of it the arm's silence.
    assert own[4] == pytest.approx(0.7, abs=MAX_POLL_GAP_S + 1e-6)
    late_s = pytest.approx(0.7, abs=1e-6)
    assert found[4] == found[5] == HostLatency(times=1, last_s=late_s, longest_s=late_s)


@pytest.mark.parametrize("set_by_s", [-3600.0, -0.5, -0.02, 0.02, 0.5, 3600.0])
def test_clock_step_does_not_exceed_possible_frame_age(set_by_s):
    clock, set_to_s = Clock(), 0.0

    def stamps() -> float:
        return clock.now_s + TIME_OF_DAY_S + set_to_s

    latency = LatencyMonitor(clock, stamps)
    for cycle in range(30):
        latency.queue_empty(clock.now_s)
        stamp_s = stamps()
        if cycle == 10:  # while the frame is in the queue
            set_to_s = set_by_s
        clock.now_s += 0.010
        waited_s = latency.frame_read(stamp_s)
        # The one that was in the queue is as old as it may be, or new; all others are as old as they are.
        expected_s = min(max(0.010 + set_by_s, 0.0), 0.010) if cycle == 10 else 0.010
        assert waited_s == pytest.approx(expected_s, abs=1e-6)
    assert latency.lateness == HostLatency()


def test_backlog_is_measured_by_stamps():
    """A frame every millisecond, and 1.2 ms for each: nothing is ever not waiting, and nobody fails to look."""
    clock = Clock()
    latency = LatencyMonitor(clock, lambda: clock.now_s + TIME_OF_DAY_S)
    latency.queue_empty(clock.now_s)
    came_s = clock.now_s
    for _ in range(3000):
        came_s += 0.001
        clock.now_s = max(clock.now_s + 0.0012, came_s)
        assert latency.frame_read(came_s + TIME_OF_DAY_S) == pytest.approx(
            clock.now_s - came_s, abs=1e-6
        )
    assert latency.late_s == 0.0
    assert latency.lateness.times == 1
    assert latency.lateness.last_s == pytest.approx(0.6, abs=1e-3)


@pytest.mark.parametrize(
    ("ours", "stamp_s"), [(False, 0.0), (False, 12.5), (False, TIME_OF_DAY_S), (True, 0.0)]
)
def test_frame_without_own_stamp_has_no_latency(ours, stamp_s):
    clock = Clock()
    latency = LatencyMonitor(clock, clock if ours else None)
    latency.queue_empty(clock.now_s)
    clock.now_s += 5.0
    assert latency.frame_read(stamp_s) == 0.0


@pytest.mark.parametrize(
    ("interfaces", "known"),
    [
        (("socketcan", "loopback", "udp_multicast", "virtual"), True),
        (("slcan", "kvaser", "pcan", "gs_usb", "socketcand", "vector"), False),
    ],
)
def test_only_local_interfaces_have_a_stamping_clock(interfaces, known):
    for interface in interfaces:
        clock = stamping_clock(BusSettings(interface=interface))
        assert (clock is not None) is known, interface
        assert clock is None or clock() == pytest.approx(time.time(), abs=1.0)


def test_waiting_arm_has_no_latency():
    clock = Clock()
    for arm_waits, times in ((False, 1), (True, 0)):
        latency = LatencyMonitor(clock, arm_waits=arm_waits)
        clock.now_s += 2.0
        latency.frame_read()
        assert latency.lateness.times == times


def test_each_latency_is_counted_once():
    clock = Clock()
    latency = LatencyMonitor(clock)
    clock.now_s += 5.0  # before anything is to be heard
    latency.begin()
    for gap_s in (0.1, REPORTED_S - 0.01, 0.8, 0.05, 0.4, *[0.05] * 50, 0.5):
        clock.now_s += gap_s
        latency.frame_read()
        latency.queue_empty(clock.now_s)
    assert latency.lateness == HostLatency(
        times=3, last_s=pytest.approx(0.5), longest_s=pytest.approx(0.8)
    )


def test_stale_sample_is_not_passed_to_steps(bus, loop):
    """Steps that count up with every sample they are given: the one after a lateness is given to nobody."""
    asked: list[int] = []

    def steps() -> Generator[None, Sample, None]:
        for k in range(6):
            if k == 3:
                bus.kept_from_answering_s = 0.4
            asked.append((yield None).sync_count)

    loop.begin_sync()
    loop.start()
    loop.run(steps())
    loop.close()
    assert [count - asked[0] for count in asked] == [0, 1, 2, 4, 5, 6]


def test_steps_proceed_under_permanent_latency(bus, loop):
    """So that an alarm, or Ctrl-C, still ends them."""
    asked: list[int] = []

    def be_late() -> None:
        bus.kept_from_answering_s = 0.4

    def steps() -> Generator[None, Sample, None]:
        for _ in range(3):
            asked.append((yield None).sync_count)

    bus.on_sync = be_late
    loop.begin_sync()
    loop.start()
    loop.run(steps())
    loop.close()
    assert len(asked) == 3
    assert asked[-1] - asked[0] < 20
