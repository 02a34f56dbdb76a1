"""The operator's arm with the virtual controller, on every transport."""

import hashlib
import math
from contextlib import closing

import numpy as np
import pytest

from hardware.arm import ArmSnapshot, DriveState
from hardware.errors import ControlDenied, DriveFault, DuplicateNodeId, Stopped, UploadRefused
from tests.contracts.arm.conftest import controller_on, operator_on
from tests.hardware.control.canopen_arm.conftest import FREE, POSITION, drive, wait_for


@pytest.mark.sample(1)
def test_two_driven_joints_move_closed_chain(driven):
    start = driven.snapshot().positions_rad
    result = driven.move({2: start[1] + 0.1, 5: start[4] - 0.1}, speed_rad_per_s=0.5)
    assert result.reached
    assert driven.settle(window=20, spread_rad=[0.01] * 7, timeout_syncs=500)
    reading = driven.capture(50)
    displacement = reading.mean_rad - start
    assert displacement[1] == pytest.approx(0.1, abs=2e-3)
    assert displacement[4] == pytest.approx(-0.1, abs=2e-3)
    assert np.abs(displacement[[0, 2, 3]]).min() > 1e-3, "a free joint did not follow"
    lsb = math.radians(120) / 4096
    assert np.all(reading.sd_rad[5:] == pytest.approx(2 * lsb, rel=0.5))  # datasheet: 2 LSB
    assert np.all(reading.sd_rad[:5] < 1e-4)


def test_stop_in_a_move_stops_everything(driven):
    start = driven.snapshot().positions_rad

    def watch(snapshot: ArmSnapshot) -> str | None:
        if snapshot.positions_rad[1] > start[1] + 0.05:
            driven.stop()
        return None

    with pytest.raises(Stopped):
        driven.move({2: start[1] + 0.3}, speed_rad_per_s=0.3, watch=watch)
    wait_for(lambda: driven.snapshot().joints[1].drive is DriveState.QUICK_STOP_ACTIVE)
    assert driven.snapshot().positions_rad[1] < start[1] + 0.1
    with pytest.raises(Stopped):
        driven.move({2: start[1]}, speed_rad_per_s=0.3)
    driven.reset_stop()
    assert {j.drive for j in driven.snapshot().joints} == {DriveState.SWITCH_ON_DISABLED}
    drive(driven)
    assert driven.move({2: start[1]}, speed_rad_per_s=0.3).reached


@pytest.mark.sample(1)
def test_uploaded_parameters_are_read_back(driven):
    document = b"SDA-0007 11 -22 33 -44 55 -6 7".ljust(4000)
    receipt = driven.upload_parameters(document)
    assert receipt.home_offset_counts == (11, -22, 33, -44, 55, -6, 7)
    assert receipt.sha256 == hashlib.sha256(document).hexdigest()
    assert driven.active_parameters() == document
    with pytest.raises(UploadRefused, match="invalid literal"):
        driven.upload_parameters(b"SDA-0007 eleven")
    assert driven.active_parameters() == document


def test_two_operators_exclude_each_other(driven, settings):
    second = operator_on(settings)
    with pytest.raises(ControlDenied):
        second.connect()
    assert driven.snapshot().token == 127
    driven.capture(1)


def test_closed_arm_holds_and_accepts_next_operator(driven, settings):
    before = driven.capture(10).mean_rad
    driven.close()
    driven.close()
    with closing(operator_on(settings)) as other:
        other.connect()
        assert other.snapshot().token == 0
        drive(other)
        assert other.capture(10).mean_rad == pytest.approx(before, abs=5e-3)


def test_third_driven_joint_trips_torque_limit(arm):
    arm.take_control()
    arm.set_modes([FREE, POSITION, POSITION, FREE, POSITION, FREE, FREE])
    start = arm.snapshot().positions_rad
    with pytest.raises(DriveFault) as error:
        arm.move({3: start[2] + 0.3}, speed_rad_per_s=0.3)
    assert error.value.code == 0x8311
    snapshot = arm.snapshot()
    assert 0x8311 in {fault.code for fault in snapshot.faults}
    assert DriveState.OPERATION_ENABLED not in {joint.drive for joint in snapshot.joints}
    arm.reset_stop()
    arm.take_control()
    assert {joint.drive for joint in arm.snapshot().joints} == {DriveState.OPERATION_ENABLED}


def test_two_controllers_on_one_bus_raise_duplicate_node_id(controller, settings):
    with controller_on(settings):
        arm = operator_on(settings)
        with pytest.raises(DuplicateNodeId, match="two devices answer as node"):
            arm.connect()
