"""What can be broken on the way between the arm's nodes and whoever commands it, seen from the bus."""

import threading

import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.objects import EmergencyCode
from hardware.virtual.disturbances import FrameFaults
from hardware.virtual.faults import disturb_frames
from tests.oracles.virtual_rig import Rig

STATE, FAULT, QUICK_STOPPED = 0x006F, 0x08, 0x07


def test_a_silent_node_neither_sends_nor_hears(arm):
    arm.operational()
    arm.broken("silent-node", 4)
    arm.peer.log.clear()
    arm.peer.send(0x604, b"\x40\x00\x10\x00\x00\x00\x00\x00")
    arm.peer.command(4, 0x00, 0, 8)
    arm.peer.send(0x080)
    arm.settled()
    arm.clock.time_s += 0.2
    arm.peer.beat()
    arm.peer.wait_for(lambda number, _: number == 0x710)
    assert [n for n, _ in arm.peer.log if n & 0x7F == 4] == []
    assert len([n for n, _ in arm.peer.log if 0x180 < n < 0x190]) == 6
    arm.mended("cut_since_s", 4)
    assert arm.peer.sync()[3][0] & STATE == 0x27


def test_a_cut_off_drive_holds_when_the_heartbeat_cannot_reach_it(arm):
    arm.operational([10] * 7)
    arm.broken("silent-node", 4)
    for _ in range(6):
        arm.clock.time_s += 0.1
        arm.peer.beat()
        arm.settled()
    arm.peer.send(0x080)
    arm.settled()
    modes = [command.mode for command in arm.plant.commands]
    assert modes[3] is JointMode.POSITION
    arm.mended("cut_since_s", 4)
    states = arm.peer.sync()
    assert states[3][0] & 0x4F == FAULT
    assert {word & STATE for k, (word, _, _) in enumerate(states) if k != 3} == {QUICK_STOPPED}
    assert arm.peer.unsigned(4, 0x1003, 1) == 0x8130


def test_lost_tpdos_are_lost_and_then_come_again(arm):
    arm.peer.start()
    arm.broken("missed-answers", 3)
    for _ in range(11):
        arm.peer.send(0x080)
    arm.settled()
    arm.peer.quiet()
    assert [len(arm.peer.seen(0x180 + j)) for j in range(1, 8)] == [11, 11, 1, 11, 11, 11, 11]


def test_stopped_heartbeats_of_one_node(arm):
    arm.broken("no-heartbeat", 2)
    arm.peer.log.clear()
    for _ in range(3):
        arm.clock.time_s += 0.1
        arm.peer.wait_for(lambda number, _: number == 0x710)
    assert len(arm.peer.seen(0x701)) == 3
    assert arm.peer.seen(0x702) == []
    arm.mended("no_heartbeat", 2)
    arm.clock.time_s += 0.1
    arm.peer.wait_for(lambda number, _: number == 0x702)


def test_another_map_is_in_the_frames_and_not_only_read_back(arm):
    arm.peer.start()
    where = arm.peer.sync()[2][1]
    arm.settled(lambda: arm.plant.speed_rad_per_s.__setitem__(2, 0.5))
    arm.broken("other-map", 3)
    states = arm.peer.sync()
    assert states[2][1] == round(0.5 * arm.plant.scales[2]) != where
    assert states[1][1] == round(arm.plant.angles_rad[1] * arm.plant.scales[1])
    assert arm.peer.unsigned(3, 0x1A00, 2) == 0x606C0020


def test_another_heartbeat_is_on_the_bus_and_not_only_read_back(arm):
    arm.broken("other-heartbeat", 3)
    arm.peer.log.clear()
    for _ in range(100):
        arm.clock.time_s += 0.1
        arm.peer.wait_for(lambda number, _: number == 0x710)
    assert len(arm.peer.seen(0x702)) == 100
    assert len(arm.peer.seen(0x703)) == 2
    assert arm.peer.unsigned(3, 0x1017) == 5000


def test_a_drive_that_answers_as_the_next_one_leaves_its_own_number_silent(arm):
    arm.peer.start()
    arm.broken("wrong-node", 7)
    arm.peer.log.clear()
    arm.peer.send(0x080)
    arm.settled()
    arm.peer.quiet()
    assert [len(arm.peer.seen(0x180 + j)) for j in range(1, 8)] == [2, 1, 1, 1, 1, 1, 0]


def spoil(arm: Rig, shares: dict[str, float], *, whole: str) -> None:
    def act() -> None:
        disturb_frames(arm.controller, FrameFaults(**shares))
        setattr(arm.controller.disturbances, whole, None)

    arm.settled(act)


def bad_on_the_way_in(arm: Rig, **shares: float) -> None:
    """Spoil what the operator sends from now on, and nothing that the arm says."""
    spoil(arm, shares, whole="wire_out")


def bad_on_the_way_out(arm: Rig, **shares: float) -> None:
    """Spoil what the arm says from now on, and nothing that the operator sends."""
    spoil(arm, shares, whole="wire_in")


def taken_in(arm: Rig) -> None:
    """Wait until what was sent has been taken in, without a frame that the wire could spoil."""
    arm.peer.quiet()
    # A turn of the loop takes in one frame at most, and then does what was posted.
    for _ in range(15):
        done = threading.Event()
        arm.controller.post(done.set)
        assert done.wait(5.0)


def test_a_stop_that_comes_twice_or_late_is_obeyed_and_one_that_is_lost_is_not(arm):
    """NMT's stop quick-stops every drive: what the wire does to it is seen in what the drives do."""
    arm.operational()
    bad_on_the_way_in(arm, lost=1.0)
    arm.peer.send(0x000, b"\x02\x00")
    taken_in(arm)
    assert {node.drive.state for node in arm.controller.drives} == {DriveState.OPERATION_ENABLED}
    arm.controller.post(lambda: disturb_frames(arm.controller, FrameFaults()))
    taken_in(arm)
    bad_on_the_way_in(arm, late=1.0)
    arm.peer.send(0x000, b"\x02\x00")
    taken_in(arm)
    assert {node.drive.state for node in arm.controller.drives} == {DriveState.OPERATION_ENABLED}
    arm.clock.time_s += 0.06
    taken_in(arm)
    assert {node.drive.state for node in arm.controller.drives} == {DriveState.QUICK_STOP_ACTIVE}


def test_frames_to_the_arm_come_twice_and_are_flipped_as_well(arm):
    states = arm.operational()
    bad_on_the_way_in(arm, doubled=1.0)
    before = arm.controller.sync_count
    arm.peer.send(0x080)
    taken_in(arm)
    assert arm.controller.sync_count == before + 2
    arm.controller.post(lambda: disturb_frames(arm.controller, FrameFaults()))
    taken_in(arm)
    bad_on_the_way_in(arm, flipped=1.0)
    sent = (0x0F, states[0][1], 8)
    for _ in range(10):
        arm.peer.command(1, *sent)
    taken_in(arm)
    drive = arm.controller.drives[0].drive
    had = (drive.controlword, drive.target_counts, drive.mode_request)
    # A target that is far away is refused; whatever bit it was, something else was heard or refused.
    assert had != sent or EmergencyCode.REFERENCE_LIMIT in drive.errors


@pytest.mark.parametrize(
    ("fault", "joints"),
    [("doubled", [k for j in range(1, 8) for k in (j, j)]), ("swapped", [2, 1, 4, 3, 6, 5])],
)
def test_frames_of_the_arm_come_twice_or_in_another_order(arm, fault, joints):
    arm.peer.start()
    bad_on_the_way_out(arm, **{fault: 1.0})
    arm.peer.send(0x080)
    taken_in(arm)
    arm.peer.quiet()
    assert [number - 0x180 for number, _ in arm.peer.log if 0x180 < number < 0x190] == joints


def test_frames_of_the_arm_come_late_and_all_of_them(arm):
    arm.peer.start()
    bad_on_the_way_out(arm, late=1.0)
    arm.peer.send(0x080)
    taken_in(arm)
    for waited_s, came in ((0.0, 0), (0.06, 7)):
        arm.clock.time_s += waited_s
        taken_in(arm)
        arm.peer.quiet()
        assert sum(0x180 < number < 0x190 for number, _ in arm.peer.log) == came
