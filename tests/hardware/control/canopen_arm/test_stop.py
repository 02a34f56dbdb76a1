"""STOP on a fake bus has the last word, waits for nothing, and stays until it is reset."""

from __future__ import annotations

import struct
import time
from typing import Any

import can
import pytest

from hardware.buses.python_can import BusOpeners, BusSettings
from hardware.control.canopen_arm import CanopenArm
from hardware.control.tasks import Steps
from hardware.errors import (
    BusError,
    CommandRefused,
    Stopped,
)
from tests.hardware.fake_arm import JOINTS, FakeArmBus
from tests.hardware.on_fake_bus import (
    PER_RAD,
    TWO_DRIVEN,
    capture_for_ever,
    describe,
    frames,
    make,
    wait_for,
)
from tests.oracles.profiles import sarcos


def test_stop_reaches_all_drives_and_latches(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    assert driven.snapshot().stopped
    for refused in (
        lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
        driven.take_control,
        driven.hold,
    ):
        with pytest.raises(Stopped):
            refused()
    assert {drive.status for drive in bus.drives.values()} == {0x07}


def test_after_stop_during_a_move_the_last_word_is_quick_stop(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    start = bus.syncs
    bus.on_sync = lambda sync: driven.stop() if sync == start + 30 else None
    with pytest.raises(Stopped):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    last = {i: struct.unpack("<Hib", data)[0] for i, data in frames(bus, 0x200)}
    assert last == {0x200 + j: 0x0002 for j in range(1, JOINTS + 1)}
    assert {drive.status for drive in bus.drives.values()} == {0x07}


def test_a_command_under_way_when_stop_comes_is_followed_by_quick_stop(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP strikes between the loop's look at the latch and its frame."""
    loop = driven._link.loop
    send = loop._sender._send
    struck = []

    def late_send(identifier: int, data: bytes) -> None:
        if identifier == 0x202 and bus.drives[2].target > 0.1 * PER_RAD and not struck:
            struck.append(identifier)
            driven.stop()
        send(identifier, data)

    monkeypatch.setattr(loop._sender, "_send", late_send)
    with pytest.raises(Stopped):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert struck
    words = [struct.unpack("<Hib", data)[0] for i, data in bus.sent if i == 0x202]
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
def test_stop_while_connecting_is_latched_and_sent_and_ends_it(
    stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the time a STOP is pressed the bus may be open, and a drive may be moving for whoever was before us."""

    class Pressed(FakeArmBus):
        pressed = False

        def _handle(self, identifier: int, data: bytes) -> None:
            super()._handle(identifier, data)
            if STAGES[stage](identifier, data) and not self.pressed:
                self.pressed = True
                arm.stop()

        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            if stage == "listening" and not self.pressed:
                self.pressed = True
                arm.stop()
            return super()._recv_internal(timeout)

    monkeypatch.setattr(
        "hardware.control.connection.LISTEN_S", 30.0 if stage == "listening" else 0.02
    )
    bus = Pressed()
    bus.drives[7].counts = 100
    arm = make(bus)
    begun = time.monotonic()
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert time.monotonic() - begun < 10.0
    assert [data[:2] for _, data in frames(bus, 0x200)] == [b"\x02\x00"] * JOINTS
    with pytest.raises(BusError, match="not connected"):
        arm.stop()
    monkeypatch.setattr("hardware.control.connection.LISTEN_S", 0.02)
    arm.connect()
    assert arm.snapshot().stopped
    with pytest.raises(Stopped):
        arm.take_control()
    arm.close()


def test_stop_before_the_bus_is_open_is_latched_and_ends_connecting(bus: FakeArmBus) -> None:
    def opened(_: BusSettings) -> can.BusABC:
        arm.stop()
        return bus

    arm = CanopenArm(
        describe(),
        BusSettings(channel="fake"),
        sarcos(),
        openers=BusOpeners(main=opened, stop=lambda _: bus.stop_handle()),
    )
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert bus.sent == []


def test_stop_needs_no_lock(driven: CanopenArm) -> None:
    with driven._link._wire._send_lock:
        driven.stop()
    assert driven.snapshot().stopped


def test_reset_clears_the_latch_and_moves_nothing(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    bus.trip(3, 0x7305)
    positions = [drive.counts for drive in bus.drives.values()]
    driven.reset_stop()
    assert {drive.status for drive in bus.drives.values()} == {0x40}
    snapshot = driven.snapshot()
    assert not snapshot.stopped
    assert snapshot.faults == ()
    assert [drive.counts for drive in bus.drives.values()] == positions
    with pytest.raises(CommandRefused):
        driven.move({2: 0.1}, speed_rad_per_s=0.1)
    driven.take_control()
    assert {drive.status for drive in bus.drives.values()} == {0x27}
    assert [drive.counts for drive in bus.drives.values()] == positions


def test_an_emergency_that_is_read_after_reset_is_over_when_the_drive_says_so(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """On a busy machine it may still wait to be looked at when RESET has its turn."""
    driven.stop()
    loop = driven._link.loop
    run = loop.run

    def tripped(asked: Steps) -> Steps:
        bus.trip(3, 0x7305)
        return (yield from asked)

    with monkeypatch.context() as patched:
        patched.setattr(loop, "run", lambda asked, **options: run(tripped(asked), **options))
        driven.reset_stop()
    assert {drive.status for drive in bus.drives.values()} == {0x40}
    assert driven.snapshot().faults == ()
    driven.take_control()


def test_an_external_stop_is_a_stop(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.say(0x90, struct.pack("<HB5x", 0x5441, 0x81))
    with pytest.raises(Stopped, match="external stop"):
        capture_for_ever(driven)


def test_reset_forgets_an_emergency_that_nobody_says_is_over(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    bus.say(0x90, struct.pack("<HB5x", 0x5441, 0x81))
    wait_for(lambda: bool(driven.snapshot().faults))
    driven.reset_stop()
    assert driven.snapshot().faults == ()
    driven.take_control()


def test_a_stop_between_reset_and_its_turn_stays(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP strikes after RESET was asked for and before the loop comes to it."""
    driven.stop()
    loop = driven._link.loop
    run = loop.run

    def late_run(asked: Steps, **options: Any) -> Any:
        driven.stop()
        return run(asked, **options)

    with monkeypatch.context() as patched:
        patched.setattr(loop, "run", late_run)
        with pytest.raises(Stopped, match="again"):
            driven.reset_stop()
    assert driven.snapshot().stopped
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    driven.reset_stop()
    assert not driven.snapshot().stopped
    assert {drive.status for drive in bus.drives.values()} == {0x40}


def test_a_stop_while_being_reset_stays(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    start = bus.syncs
    bus.on_sync = lambda sync: driven.stop() if sync == start + 2 else None
    with pytest.raises(Stopped):
        driven.reset_stop()
    assert driven.snapshot().stopped


def test_one_reset_lifts_all_stops_before_it(driven: CanopenArm) -> None:
    for _ in range(3):
        driven.stop()
    driven.reset_stop()
    assert not driven.snapshot().stopped


def test_a_stop_outlives_the_connection(driven: CanopenArm, bus: FakeArmBus) -> None:
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


def test_a_connected_arm_is_not_connected_again(arm: CanopenArm) -> None:
    with pytest.raises(ValueError, match="already"):
        arm.connect()
