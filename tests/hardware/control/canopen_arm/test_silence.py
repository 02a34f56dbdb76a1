"""What goes silent on a fake bus, restarts, or talks nonsense: it is named, and nothing hangs."""

import struct

import can
import pytest

from hardware.errors import BusError, CommandRefused
from tests.hardware.on_fake_bus import PER_RAD, capture_for_ever, wait_for


def test_a_joint_that_stops_answering_is_named_and_nothing_hangs(driven, bus):
    bus.silent = {6}
    with pytest.raises(BusError, match="no answer to SYNC from node 6"):
        driven.move({2: 0.5}, speed_rad_per_s=0.5)
    assert bus.drives[2].target < 0.1 * PER_RAD
    bus.silent = set()
    driven_again = driven.snapshot()
    assert driven_again.joints[5].age_s > driven_again.joints[0].age_s


def test_an_arm_that_was_stopped_and_then_fell_silent_is_not_said_to_be_held(driven, bus):
    bus.dead = {16}
    with pytest.raises(BusError, match="no heartbeat from node 16"):
        capture_for_ever(driven)
    driven.stop()
    assert not driven.close()


def test_a_broken_bus_is_a_bus_error_everywhere(driven, bus):
    bus.broken = can.CanOperationError("cable cut")
    with pytest.raises(BusError, match="cable cut"):
        driven.capture(5)
    with pytest.raises(BusError):
        driven.active_parameters()
    with pytest.raises(BusError, match="emergency stop"):
        driven.stop()
    driven.close()


def test_a_node_that_restarts_is_named(driven, bus):
    bus.restart(3)
    with pytest.raises(BusError, match="Node 3 has left operation"):
        capture_for_ever(driven)


def test_a_target_the_drive_refuses_is_no_trip(driven, bus):
    bus.say(0x82, struct.pack("<HB5x", 0x8612, 0x81))
    with pytest.raises(CommandRefused, match="joint 2: target refused"):
        capture_for_ever(driven)
    bus.say(0x82, struct.pack("<HB5x", 0x0000, 0x00))
    wait_for(lambda: driven.snapshot().faults == ())
    driven.capture(1)


def test_one_lost_answer_does_not_end_a_move(driven, bus):
    start = bus.syncs

    def lose_one(sync: int) -> None:
        bus.silent = {4} if sync == start + 20 else set()

    bus.on_sync = lose_one
    assert driven.move({2: 0.2}, speed_rad_per_s=0.5).reached


def test_frames_that_mean_nothing_are_passed_over(driven, bus):
    for identifier, data in (
        (0x181, b""),  # a TPDO1 of another length
        (0x703, b"\x05\x05"),
        (0x083, b"\x11"),
        (0x583, b"\x00"),
        (0x585, bytes(8)),
        (0x7FF, bytes(8)),
        (0x730, b"\x05"),  # heartbeat and emergency of a stranger
        (0x0B0, bytes(8)),
    ):
        bus.say(identifier, data)
    reading = driven.capture(5)
    assert reading.mean_counts.tolist()[:6] == [1000.0 * j for j in range(1, 7)]
    assert driven.snapshot().faults == ()
    assert driven.active_parameters() == b""
