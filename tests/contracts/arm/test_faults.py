"""An overloaded arm and a duplicate one, on every transport; single faults have a campaign of their own."""

import pytest

from hardware.arm import DriveState
from hardware.errors import DriveFault, DuplicateNodeId
from tests.contracts.arm.bench import FREE, POSITION, controller_on, operator_on


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
