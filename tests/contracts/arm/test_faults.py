"""What a session may lose on every transport, and is told by name: counts, a drive, the one device of a number."""

import threading

import pytest

from hardware.arm import ArmSnapshot, DriveState
from hardware.errors import BusError, DriveFault, DuplicateNodeId, SensorFault
from hardware.virtual.faults import inject, lose_counts
from tests.contracts.arm.bench import FREE, POSITION, controller_on, operator_on


def test_a_third_driven_joint_trips_the_torque_limit(arm):
    arm.take_control()
    arm.set_modes([FREE, POSITION, POSITION, FREE, POSITION, FREE, FREE])
    start = arm.snapshot().positions_rad
    with pytest.raises(DriveFault) as fault:
        arm.move({3: start[2] + 0.3}, speed_rad_per_s=0.3)
    assert fault.value.code == 0x8311
    snapshot = arm.snapshot()
    assert 0x8311 in {found.code for found in snapshot.faults}
    assert DriveState.OPERATION_ENABLED not in {joint.drive for joint in snapshot.joints}
    arm.reset_stop()
    arm.take_control()
    assert {joint.drive for joint in arm.snapshot().joints} == {DriveState.OPERATION_ENABLED}


@pytest.mark.sample(2)
@pytest.mark.parametrize("counts", [5, 500, -1111])
def test_counts_lost_at_rest_are_noticed_before_the_pose_counts(driven, controller, counts):
    driven.settle(window=10, spread_rad=[0.01] * 7, timeout_syncs=300)
    driven.capture(20)
    controller.post(lambda: lose_counts(controller, 3, counts))
    with pytest.raises(SensorFault, match="joint 3 jumped") as told:
        driven.capture(40)
    assert told.value.joint == 3
    assert f"by {counts:+d} counts" in str(told.value)


@pytest.mark.sample(1)
@pytest.mark.parametrize("counts", [500, -1111])
def test_counts_lost_in_a_move_are_noticed(driven, controller, counts):
    here = driven.snapshot().positions_rad
    lost = threading.Event()

    def watch(snapshot: ArmSnapshot) -> None:
        if abs(snapshot.positions_rad[1] - here[1]) > 0.1 and not lost.is_set():
            controller.post(lambda: lose_counts(controller, 4, counts))
            lost.set()

    with pytest.raises(SensorFault, match="joint 4 jumped") as told:
        driven.move({2: here[1] + 0.3}, speed_rad_per_s=0.5, watch=watch)
    assert lost.is_set()
    assert told.value.joint == 4


def test_a_drive_that_restarts_with_its_counter_at_zero_is_named(driven, controller):
    inject(controller, "restart-node", 5)
    with pytest.raises(BusError, match="5") as told:
        driven.capture(2000)
    assert "restart" in str(told.value) or "left operation" in str(told.value)


def test_a_joint_that_answers_twice_is_two_devices(driven, controller):
    inject(controller, "double-answers", 7)
    with pytest.raises(DuplicateNodeId, match="node 7"):
        driven.capture(2000)


def test_two_controllers_on_one_bus_are_named(controller, settings):
    with controller_on(settings):
        arm = operator_on(settings)
        with pytest.raises(DuplicateNodeId, match="two devices answer as node"):
            arm.connect()
