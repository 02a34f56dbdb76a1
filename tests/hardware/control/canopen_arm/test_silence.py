"""Silent, restarted and faulty nodes on a fake bus: they are named, and no call hangs."""

import struct

import can
import pytest

from hardware.errors import BusError, CommandRefused, NodeRestarted
from tests.hardware.on_fake_bus import PER_RAD, capture_for_ever, wait_for


def test_joint_without_tpdo_ends_move(driven, bus):
    bus.without_tpdo = {6}
    with pytest.raises(BusError, match="no answer to SYNC from node 6"):
        driven.move({2: 0.5}, speed_rad_per_s=0.5)
    assert bus.drives[2].target < 0.1 * PER_RAD
    bus.without_tpdo = set()
    joints = driven.snapshot().joints
    assert joints[5].age_s > joints[0].age_s


def test_answers_of_wrong_length_are_not_called_silence(driven, bus, approve):
    bus.short_tpdo = {6}
    with pytest.raises(BusError) as refused:
        driven.move({2: 0.5}, speed_rad_per_s=0.5)
    approve(str(refused.value))
    bus.short_tpdo = set()
    assert driven.capture(2).samples == 2


def test_close_after_silence_reports_unknown_state(driven, bus):
    bus.offline = {16}
    with pytest.raises(BusError, match="no heartbeat from node 16"):
        capture_for_ever(driven)
    driven.stop()
    assert not driven.close()


@pytest.mark.parametrize("kind", [can.CanOperationError, RuntimeError])
def test_bus_failure_raises_bus_error_in_every_call(driven, bus, kind):
    """Drivers raise errors of any kind."""
    bus.io_error = kind("cable cut")
    with pytest.raises(BusError, match="cable cut"):
        driven.capture(5)
    with pytest.raises(BusError):
        driven.active_parameters()
    with pytest.raises(BusError, match="emergency stop"):
        driven.stop()
    driven.close()


@pytest.mark.parametrize(
    ("state", "error", "message"),
    [
        (b"\x7f", BusError, "Node 3 has left operation"),
        (b"\x05", NodeRestarted, r"joint 3 \(node 3\) has restarted"),
    ],
)
def test_restarted_node_is_named(driven, bus, state, error, message):
    bus.inject(0x703, b"\x00")
    bus.inject(0x703, state)
    with pytest.raises(error, match=message) as raised:
        capture_for_ever(driven)
    assert error is BusError or raised.value.nodes == (3,)


def test_refused_target_raises_command_refused(driven, bus):
    bus.inject(0x82, struct.pack("<HB5x", 0x8612, 0x81))
    with pytest.raises(CommandRefused, match="joint 2: target refused"):
        capture_for_ever(driven)
    bus.inject(0x82, struct.pack("<HB5x", 0x0000, 0x00))
    wait_for(lambda: driven.snapshot().faults == ())
    driven.capture(1)


def test_single_lost_tpdo_does_not_end_move(driven, bus):
    start = bus.syncs

    def lose_one(sync: int) -> None:
        bus.without_tpdo = {4} if sync == start + 20 else set()

    bus.on_sync = lose_one
    assert driven.move({2: 0.2}, speed_rad_per_s=0.5).reached


def test_malformed_and_unknown_frames_are_ignored(driven, bus):
    for identifier, data in (
        (0x181, b""),  # a TPDO1 of another length
        (0x703, b"\x05\x05"),
        (0x083, b"\x11"),
        (0x583, b"\x00"),
        (0x585, bytes(8)),
        (0x7FF, bytes(8)),
        (0x730, b"\x05"),  # heartbeat and emergency of another node
        (0x0B0, bytes(8)),
    ):
        bus.inject(identifier, data)
    reading = driven.capture(5)
    assert reading.mean_counts.tolist()[:6] == [1000.0 * j for j in range(1, 7)]
    assert driven.snapshot().faults == ()
    assert driven.active_parameters() == b""
