"""One's own lateness is not the arm's silence: on a machine so busy that the loop is not run for seconds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import can
import pytest

from hardware.attention import LONGEST_LOOK_S, Attention
from hardware.control_loop import ControlLoop
from hardware.errors import BusError
from hardware.objects import COB_HEARTBEAT, NmtState
from hardware.timing import Pace, Timing
from oracles.profiles import sarcos

JOINTS = 2
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

    def send(self, identifier: int, data: bytes) -> None:
        pass

    def receive(self, timeout_s: float) -> can.Message | None:
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
def bus() -> Bus:
    return Bus(Clock())


@pytest.fixture
def loop(bus: Bus) -> ControlLoop:
    made = ControlLoop(
        bus,
        profile=sarcos(JOINTS),
        pace=Pace.REAL_TIME,
        on_sdo=lambda *_: None,
        allow=lambda *_: None,
        quick_stop=lambda: None,
        timing=Timing(heartbeat_timeout_s=1.0),
        clock=bus.clock,
    )
    bus.beat()
    listen(made, looks=4)
    return made


def listen(loop: ControlLoop, *, looks: int) -> None:
    for _ in range(looks):
        loop._receive_one(0.05)


def test_a_loop_that_was_kept_from_running_does_not_call_the_arm_silent(bus, loop) -> None:
    bus.kept_from_running_s = 5.0
    loop._receive_one(0.05)
    assert loop.alarm() is None
    bus.beat()
    listen(loop, looks=4)
    assert loop.alarm() is None
    assert loop.attention.late_s == pytest.approx(5.0 - LONGEST_LOOK_S + 0.05)


def test_a_loop_that_only_ever_gets_short_turns_still_hears_who_speaks(bus, loop) -> None:
    for _ in range(50):
        bus.kept_from_running_s = 0.7
        bus.beat()
        listen(loop, looks=4)
        assert loop.alarm() is None


def test_a_silent_arm_is_found_however_late_we_are(bus, loop) -> None:
    bus.kept_from_running_s = 5.0
    listen(loop, looks=25)
    alarm = loop.alarm()
    assert isinstance(alarm, BusError)
    assert "no heartbeat from node 1, 2, 16" in str(alarm)


def test_listening_never_counts_for_more_than_the_time_that_passed() -> None:
    clock = Clock()
    attention = Attention(clock)
    for gap_s in (0.01, LONGEST_LOOK_S, 0.3, 2.0, 0.0):
        clock.now_s += gap_s
        attention.look()
    assert attention.late_s == pytest.approx(0.2 + 1.9)
    clock.now_s += 1.0  # nobody has looked since
    assert attention.late_s == pytest.approx(3.0)
    assert clock.now_s - attention.listened_s == pytest.approx(3.0)
