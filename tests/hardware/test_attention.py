"""One's own lateness is not the arm's silence: on a machine so busy that the loop is not run for seconds."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field

import can
import pytest

from hardware.attention import LONGEST_LOOK_S, Attention, Waiting
from hardware.control_loop import ControlLoop
from hardware.errors import BusError
from hardware.objects import COB_HEARTBEAT, NmtState
from hardware.timing import Pace, Timing
from oracles.profiles import sarcos

JOINTS = 2
ANOTHER_ZERO_S = 1.7e9
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
        """Every SYNC is answered at once; frames are stamped by a clock with another zero."""
        if identifier == 0x080:
            stamp = self.clock.now_s + ANOTHER_ZERO_S
            self.waiting.extend(
                can.Message(arbitration_id=0x180 + joint, data=bytes(8), timestamp=stamp)
                for joint in (1, 2)
            )

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
        stamped=True,
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


# ---- how old what we look at is ------------------------------------------------------------------------


def test_an_answer_that_waited_for_us_is_as_old_as_its_stamp(bus, loop) -> None:
    for _ in range(3):
        loop._cycle()
    assert bus.clock.now_s - min(loop.view.answered_at_s) < 0.02
    bus.kept_from_running_s = 0.7
    bus.waiting.clear()
    loop._send_commands()
    loop._sampler.open()
    bus.send(0x080, b"")
    listen(loop, looks=2)
    loop._sampler.close()
    ages = [bus.clock.now_s - at for at in loop.view.answered_at_s]
    assert ages == pytest.approx([0.7, 0.7], abs=0.02)
    # All of it is our own lateness, none of it the arm's silence.
    late = [loop.attention.late_s - at for at in loop.view.late_at_s]
    assert late == pytest.approx(ages, abs=1e-9)
    loop._cycle()
    assert bus.clock.now_s - min(loop.view.answered_at_s) < 0.02


@pytest.mark.parametrize("zero_s", [0.0, 1.7e9, -98.0])
@pytest.mark.parametrize("per_s", [0.0, 1e-3, -1e-3])
def test_a_stamp_of_any_clock_says_how_long_a_frame_waited(zero_s: float, per_s: float) -> None:
    """Every 10 ms three frames come, 1 ms apart, and are looked at when the third is there; once much later."""
    waiting = Waiting(stamped=True, now_s=100.0)
    now_s = 100.0
    for cycle in range(600):
        waiting.nothing(now_s)
        came = [now_s + 1e-3 * k for k in (1, 2, 3)]
        seen_s = came[-1] + (0.6 if cycle == 400 else 0.0)
        ages = [waiting.waited_s(zero_s + (1 + per_s) * at, seen_s) for at in came]
        if cycle:
            assert ages == pytest.approx([seen_s - at for at in came], abs=0.003)
        now_s = seen_s + 0.007


def test_a_clock_set_anew_makes_no_frame_older_than_it_can_be() -> None:
    waiting = Waiting(stamped=True, now_s=100.0)
    for cycle in range(200):
        now_s = 100.0 + 0.01 * cycle
        waiting.nothing(now_s)
        zero_s = 1e9 if cycle < 100 else 1e9 - 3600.0 if cycle < 150 else 1e9 + 3600.0
        age_s = waiting.waited_s(zero_s + now_s + 0.001, now_s + 0.002)
        assert -1e-9 <= age_s <= 0.002 + 1e-6


@pytest.mark.parametrize(("stamped", "stamp_s"), [(True, 0.0), (False, 1.7e9)])
def test_without_a_stamp_a_frame_is_as_old_as_it_may_be(stamped: bool, stamp_s: float) -> None:
    waiting = Waiting(stamped=stamped, now_s=100.0)
    waiting.nothing(100.5)
    assert waiting.waited_s(stamp_s, 101.2) == pytest.approx(0.7)


# ---- what the operator is told ---------------------------------------------------------------------------


def test_lateness_is_told_in_a_sentence_and_no_flood() -> None:
    clock = Clock()
    attention = Attention(clock)
    clock.now_s += 5.0  # before anything is to be heard
    attention.begin()
    told = []
    for gap_s in (0.1, 0.3, 0.8, 0.8, 0.5, 1.2, *[0.9] * 50, 3.0, 3.0):
        clock.now_s += gap_s
        attention.look()
        told += [attention.words] if attention.words not in ("", *told) else []
    assert [text.split(" nobody")[0] for text in told] == [
        "this computer was too busy: for 0.7 s",
        "this computer was too busy: for 2.9 s",
    ]
    assert attention.late_s == pytest.approx(0.2 + 2 * 0.7 + 0.4 + 1.1 + 50 * 0.8 + 2 * 2.9)
