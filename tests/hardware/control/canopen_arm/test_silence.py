"""Silent, restarted and faulty nodes on a fake bus: they are named, and no call hangs."""

import time
from unittest.mock import Mock

import can
import numpy as np
import pytest

from hardware.control.motion_steps import STANDSTILL_SYNCS
from hardware.control.trajectory import ACCELERATION_RAD_PER_S2
from hardware.errors import BusError, NodeRestarted, TargetRefused
from tests.hardware.control.canopen_arm.conftest import PER_RAD, wait_for
from tests.hardware.fake_arm import FakeArmBus, capture_for_ever


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
    bus.io_error = kind("cable cut")
    with pytest.raises(BusError, match="cable cut"):
        driven.capture(5)
    ended = driven.snapshot()
    time.sleep(0.3)  # longer than the loop may wait; silence is not this computer's latency
    assert driven.snapshot().late_s == ended.late_s
    with pytest.raises(BusError, match="cable cut"):
        driven.active_parameters()
    with pytest.raises(BusError, match="emergency stop"):
        driven.stop()
    bus.on_closing = bus.shutdown = Mock(side_effect=[bus.io_error, bus.io_error, None])
    assert not driven.close()


@pytest.mark.parametrize(
    ("operational", "error", "message"),
    [
        (False, BusError, "Node 3 has left operation"),
        (True, NodeRestarted, r"joint 3 \(node 3\) has restarted"),
    ],
)
def test_restarted_node_is_named(driven, bus, operational, error, message):
    if not operational:
        bus.started.remove(3)  # so that no heartbeat in between says otherwise
    bus.inject(0x703, b"\x00")
    bus.inject(0x703, b"\x05" if operational else b"\x7f")
    with pytest.raises(error, match=message) as raised:
        capture_for_ever(driven)
    assert error is BusError or raised.value.nodes == (3,)


def test_refused_target_raises_command_refused(driven, bus):
    bus.emergency(2, 0x8612)
    with pytest.raises(TargetRefused, match="joint 2: target refused"):
        capture_for_ever(driven)
    bus.inject(0x82, bytes(8))
    wait_for(lambda: driven.snapshot().faults == ())
    driven.capture(1)


def silence_at_speed(bus: FakeArmBus, syncs: int) -> list[int]:
    """Have joint 6 miss SYNCs from the 60th of a move on; return the list of joint 2's targets, SYNC by SYNC."""
    start, targets = bus.syncs, list[int]()

    def on_sync(sync: int) -> None:
        bus.without_tpdo = {6} if 60 <= sync - start < 60 + syncs else set()
        targets.append(bus.drives[2].target)

    bus.on_sync = on_sync
    return targets


def test_move_that_stood_still_ends_where_it_stands(driven, bus):
    targets = silence_at_speed(bus, 10_000)
    with pytest.raises(BusError, match="no answer to SYNC from node 6"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert targets[59] - targets[58] == pytest.approx(0.5 * 0.01 * PER_RAD, abs=1.0)
    assert set(targets[60:]) == {targets[60]}
    joints = driven.snapshot().joints
    assert joints[5].age_s > joints[0].age_s


def test_move_that_stood_still_starts_again_from_rest(driven, bus):
    targets = silence_at_speed(bus, STANDSTILL_SYNCS)
    assert driven.move({2: 1.0, 5: -0.2}, speed_rad_per_s=0.5).reached
    after = targets[60 + STANDSTILL_SYNCS :]
    assert after[0] == targets[60]
    changes_of_speed = np.abs(np.diff(after, n=2))
    assert changes_of_speed.max() <= ACCELERATION_RAD_PER_S2 * 0.01**2 * PER_RAD + 2
    assert np.diff(after).max() == pytest.approx(0.5 * 0.01 * PER_RAD, abs=1.0)
    assert bus.drives[2].target == round(1.0 * PER_RAD)
    assert bus.drives[5].target == round(-0.2 * PER_RAD)


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
    assert driven.capture(5).mean_counts.tolist()[:6] == [1000.0 * j for j in range(1, 7)]
    assert driven.snapshot().faults == ()
    assert driven.active_parameters() == b""
