"""STOP on a fake bus: it overrides every command, waits for nothing, and stays latched until reset."""

import threading
from dataclasses import replace
from types import SimpleNamespace

import can
import pytest

from hardware.buses.python_can import BusSettings
from hardware.control import motion_steps
from hardware.control.stop_line import StopLatch
from hardware.errors import BusError, CommandRefused, Stopped
from tests.hardware.control.canopen_arm.conftest import PER_RAD, drive, make, short_timing
from tests.hardware.fake_arm import JOINTS


def test_stop_during_transmission_overrides_late_setpoint(driven, bus):
    """STOP comes from another thread after the loop has read the latch and before it sends; it waits for no lock."""
    presses: list[threading.Thread] = []

    def press_stop(identifier: int, _data: bytes) -> None:
        if identifier == 0x202 and bus.drives[2].target > 0.1 * PER_RAD and not presses:
            presses.append(threading.Thread(target=driven.stop))
            presses[0].start()
            presses[0].join(10.0)
            assert not presses[0].is_alive()

    bus.on_send = press_stop
    with pytest.raises(Stopped):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert {bus.controlwords(j)[-1] for j in bus.drives} == {0x0002}
    assert bus.statuses == {0x07}
    words = bus.controlwords(2)
    late = len(words) - 1 - words[::-1].index(0x000F)
    assert words[late - 1] == 0x0002, "the set-point was not late"
    assert set(words[late + 1 :]) == {0x0002}


STAGES = {
    "listening": lambda identifier, _: identifier == -1,
    "the reset": lambda identifier, data: identifier == 0x000 and data[0] == 0x82,
    "reading": lambda identifier, data: identifier == 0x604 and data[1:3] == b"\x00\x1a",
    "the start": lambda identifier, data: identifier == 0x000 and data[0] == 0x01,
    "SYNC": lambda identifier, _: identifier == 0x080,
}


@pytest.mark.parametrize("stage", STAGES)
def test_stop_while_connecting_is_sent_and_latched(bus, stage):
    """The bus may be open already, and a drive may be moving for the program before."""

    pressed = []

    def press_if_due(identifier: int, data: bytes = b"") -> None:
        if STAGES[stage](identifier, data) and not pressed:
            pressed.append(identifier)
            arm.stop()

    def press_and_receive(timeout: float | None) -> tuple[can.Message | None, bool]:
        press_if_due(-1)
        return receive(timeout)

    bus.on_send, receive, bus._recv_internal = press_if_due, bus._recv_internal, press_and_receive
    # Listening would not end by itself.
    arm = make(bus, timing=short_timing(listen_s=1e4 if stage == "listening" else 0.02))
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert [data[:2] for data in bus.commands] == [b"\x02\x00"] * JOINTS
    with pytest.raises(BusError, match="not connected"):
        arm.stop()
    arm.on_bus = replace(arm.on_bus, timing=short_timing())
    arm.connect()
    assert arm.snapshot().stopped
    with pytest.raises(Stopped):
        arm.take_control()
    arm.close()


def test_stop_before_bus_opens_ends_connecting(bus):
    def open_after_stop(_: BusSettings) -> can.BusABC:
        arm.stop()
        return bus

    arm = make(bus, opener=open_after_stop)
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert bus.sent == []


def test_reset_clears_all_earlier_stops_without_motion(driven, bus):
    for _ in range(3):
        driven.stop()
    bus.trip(3, 0x7305)
    positions = [drive.counts for drive in bus.drives.values()]
    driven.reset_stop()
    assert bus.statuses == {0x40}
    snapshot = driven.snapshot()
    assert not snapshot.stopped
    assert snapshot.faults == ()
    assert [drive.counts for drive in bus.drives.values()] == positions
    with pytest.raises(CommandRefused):
        driven.move({2: 0.1}, speed_rad_per_s=0.1)
    driven.take_control()
    assert bus.statuses == {0x27}
    assert [drive.counts for drive in bus.drives.values()] == positions


def test_emergency_received_during_reset_is_cleared(driven, bus):
    """On a busy machine it may still be in the queue when the reset is executed."""
    driven.stop()
    bus.at(1, lambda: bus.trip(3, 0x7305))
    driven.reset_stop()
    assert (bus.statuses, driven.snapshot().faults) == ({0x40}, ())
    driven.take_control()


def test_stop_during_reset_stays_latched(driven, bus):
    driven.stop()
    bus.at(2, driven.stop)
    with pytest.raises(Stopped):
        driven.reset_stop()
    assert driven.snapshot().stopped


def test_stop_pressed_after_reset_request_stays_latched():
    latch, cleared = StopLatch(), list[None]()
    latch.press()
    press_to_reset = latch.last_press
    latch.press()
    nodes = SimpleNamespace(faults=("tripped",))
    watch = SimpleNamespace(reset=lambda: cleared.append(None))
    loop = SimpleNamespace(latch=latch, commands=(), nodes=nodes, watch=watch)
    steps = motion_steps.reset(loop, press=press_to_reset)
    with pytest.raises(Stopped, match="again"):
        next(steps)
    assert latch.latched
    assert (cleared, loop.commands, nodes.faults) == ([], (), ("tripped",))


def test_stop_reaches_all_drives_and_survives_reconnection(driven, bus):
    driven.stop()
    assert bus.statuses == {0x07}
    for reconnects in (False, True):
        if reconnects:
            driven.close()
            driven.connect()
        assert driven.snapshot().stopped
        for command in (
            lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
            driven.take_control,
            driven.hold,
        ):
            with pytest.raises(Stopped):
                command()
        assert bus.statuses == {0x07}
    driven.reset_stop()
    assert not driven.snapshot().stopped
    drive(driven)
    assert driven.move({2: 0.1}, speed_rad_per_s=0.1).reached


def test_second_connect_raises_value_error(arm):
    with pytest.raises(ValueError, match="already"):
        arm.connect()
