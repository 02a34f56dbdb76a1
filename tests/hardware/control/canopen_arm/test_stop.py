"""STOP on a fake bus has the last word, waits for nothing, and stays until it is reset."""

import struct
import threading
import time

import can
import pytest

from hardware.buses.python_can import BusSettings
from hardware.errors import BusError, CommandRefused, Stopped
from tests.hardware.fake_arm import JOINTS, FakeArmBus
from tests.hardware.on_fake_bus import (
    PER_RAD,
    TWO_DRIVEN,
    capture_for_ever,
    frames,
    hasty,
    make,
    wait_for,
)


def test_stop_reaches_all_drives_and_latches(driven, bus):
    driven.stop()
    assert bus.statuses == {0x07}
    assert driven.snapshot().stopped
    for refused in (
        lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
        driven.take_control,
        driven.hold,
    ):
        with pytest.raises(Stopped):
            refused()
    assert bus.statuses == {0x07}


def test_stop_during_transmission_overrides_late_setpoint(driven, bus):
    """STOP strikes from another thread between the loop's look at the latch and its frame, and waits for no lock."""
    presses: list[threading.Thread] = []

    def strike(identifier: int, _data: bytes) -> None:
        if identifier == 0x202 and bus.drives[2].target > 0.1 * PER_RAD and not presses:
            presses.append(threading.Thread(target=driven.stop))
            presses[0].start()
            presses[0].join(10.0)
            assert not presses[0].is_alive()

    bus.on_send = strike
    with pytest.raises(Stopped):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert {bus.words(j)[-1] for j in bus.drives} == {0x0002}
    assert bus.statuses == {0x07}
    words = bus.words(2)
    late = len(words) - 1 - words[::-1].index(0x000F)
    assert words[late - 1] == 0x0002, "the late frame of this test did not come late"
    assert set(words[late + 1 :]) == {0x0002}


STAGES = {
    "listening": lambda identifier, _: identifier == -1,
    "the reset": lambda identifier, data: identifier == 0x000 and data[0] == 0x82,
    "reading": lambda identifier, data: identifier == 0x604 and data[1:3] == b"\x00\x1a",
    "the start": lambda identifier, data: identifier == 0x000 and data[0] == 0x01,
    "SYNC": lambda identifier, _: identifier == 0x080,
}


@pytest.mark.parametrize("stage", STAGES)
def test_stop_while_connecting_is_sent_and_latched(stage):
    """By the time a STOP is pressed the bus may be open, and a drive may be moving for whoever was before us."""

    class Pressed(FakeArmBus):
        pressed = False

        def press(self, now: bool) -> None:
            if now and not self.pressed:
                self.pressed = True
                arm.stop()

        def _handle(self, identifier: int, data: bytes) -> None:
            super()._handle(identifier, data)
            self.press(STAGES[stage](identifier, data))

        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            self.press(stage == "listening")
            return super()._recv_internal(timeout)

    bus = Pressed()
    arm = make(bus, timing=hasty(listen_s=2.0 if stage == "listening" else 0.02))
    begun = time.monotonic()
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert stage != "listening" or time.monotonic() - begun < 1.9
    assert [data[:2] for _, data in frames(bus, 0x200)] == [b"\x02\x00"] * JOINTS
    with pytest.raises(BusError, match="not connected"):
        arm.stop()
    arm.connect()
    assert arm.snapshot().stopped
    with pytest.raises(Stopped):
        arm.take_control()
    arm.close()


def test_stop_before_bus_opens_ends_connecting(bus):
    def opened(_: BusSettings) -> can.BusABC:
        arm.stop()
        return bus

    arm = make(bus, opener=opened)
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
    """On a busy machine it may still wait to be looked at when RESET has its turn."""
    driven.stop()
    first = bus.syncs + 1
    bus.on_sync = lambda sync: bus.trip(3, 0x7305) if sync == first else None
    driven.reset_stop()
    assert bus.statuses == {0x40}
    assert driven.snapshot().faults == ()
    driven.take_control()


def test_an_external_stop_is_a_stop(driven, bus):
    bus.say(0x90, struct.pack("<HB5x", 0x5441, 0x81))
    with pytest.raises(Stopped, match="external stop"):
        capture_for_ever(driven)


def test_reset_forgets_an_emergency_that_nobody_says_is_over(driven, bus):
    bus.say(0x90, struct.pack("<HB5x", 0x5441, 0x81))
    wait_for(lambda: bool(driven.snapshot().faults))
    driven.reset_stop()
    assert driven.snapshot().faults == ()
    driven.take_control()


def test_stop_during_reset_stays_latched(driven, bus):
    driven.stop()
    start = bus.syncs
    bus.on_sync = lambda sync: driven.stop() if sync == start + 2 else None
    with pytest.raises(Stopped):
        driven.reset_stop()
    assert driven.snapshot().stopped


def test_stop_survives_reconnection(driven, bus):
    driven.stop()
    driven.close()
    driven.connect()
    assert driven.snapshot().stopped
    for refused in (driven.take_control, lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1)):
        with pytest.raises(Stopped):
            refused()
    driven.reset_stop()
    assert not driven.snapshot().stopped
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    assert driven.move({2: 0.1}, speed_rad_per_s=0.1).reached


def test_second_connect_raises_value_error(arm):
    with pytest.raises(ValueError, match="already"):
        arm.connect()
