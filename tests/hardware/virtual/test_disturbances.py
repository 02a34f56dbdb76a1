"""Faults of nodes and frames, seen from the bus."""

import threading

import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.objects import EmergencyCode
from hardware.virtual.disturbances import FrameFaults
from hardware.virtual.faults import disturb_frames
from tests.oracles.virtual_rig import Rig

STATE, FAULT, QUICK_STOPPED = 0x006F, 0x08, 0x07


def tpdo_counts(arm: Rig) -> list[int]:
    """Number of TPDO1 in the log, joint by joint."""
    return [len(arm.peer.seen(0x180 + joint)) for joint in range(1, 8)]


def test_silent_node_neither_sends_nor_receives(arm):
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
    assert tpdo_counts(arm) == [1, 1, 1, 0, 1, 1, 1]
    arm.mended("cut_since_s", 4)
    assert arm.peer.sync()[3][0] & STATE == 0x27


def test_silent_node_holds_after_the_heartbeat_timeout(arm):
    arm.operational([10] * 7)
    arm.broken("silent-node", 4)
    for _ in range(6):
        arm.clock.time_s += 0.1
        arm.peer.beat()
        arm.settled()
    arm.peer.send(0x080)
    arm.settled()
    assert arm.plant.commands[3].mode is JointMode.POSITION
    arm.mended("cut_since_s", 4)
    states = arm.peer.sync()
    assert states[3][0] & 0x4F == FAULT
    assert {word & STATE for k, (word, _, _) in enumerate(states) if k != 3} == {QUICK_STOPPED}
    assert arm.peer.unsigned(4, 0x1003, 1) == 0x8130


def test_missed_answers_lose_ten_tpdos(arm):
    arm.peer.start()
    arm.broken("missed-answers", 3)
    for _ in range(11):
        arm.peer.send(0x080)
    arm.settled()
    arm.peer.quiet()
    assert tpdo_counts(arm) == [11, 11, 1, 11, 11, 11, 11]


def test_no_heartbeat_stops_heartbeats_of_one_node(arm):
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


def test_other_map_changes_frames_and_object(arm):
    arm.peer.start()
    counts = arm.peer.sync()[2][1]
    arm.settled(lambda: arm.plant.speed_rad_per_s.__setitem__(2, 0.5))
    arm.broken("other-map", 3)
    states = arm.peer.sync()
    assert states[2][1] == round(0.5 * arm.plant.scales[2]) != counts
    assert states[1][1] == round(arm.plant.angles_rad[1] * arm.plant.scales[1])
    assert arm.peer.unsigned(3, 0x1A00, 2) == 0x606C0020


def test_other_heartbeat_period_changes_frames_and_object(arm):
    arm.broken("other-heartbeat", 3)
    arm.peer.log.clear()
    for _ in range(100):
        arm.clock.time_s += 0.1
        arm.peer.wait_for(lambda number, _: number == 0x710)
    assert len(arm.peer.seen(0x702)) == 100
    assert len(arm.peer.seen(0x703)) == 2
    assert arm.peer.unsigned(3, 0x1017) == 5000


def test_wrong_node_answers_with_the_number_of_another(arm):
    arm.peer.start()
    arm.broken("wrong-node", 7)
    arm.peer.log.clear()
    arm.peer.send(0x080)
    arm.settled()
    arm.peer.quiet()
    assert tpdo_counts(arm) == [2, 1, 1, 1, 1, 1, 0]


def disturb(arm: Rig, *, intact: str, **fractions: float) -> None:
    """Disturb frames in one direction; `intact` is the other: "wire_in" (to the arm) or "wire_out"."""

    def act() -> None:
        disturb_frames(arm.controller, FrameFaults(**fractions))
        setattr(arm.controller.disturbances, intact, None)

    arm.settled(act)


def clear_disturbances(arm: Rig) -> None:
    arm.controller.post(lambda: disturb_frames(arm.controller, FrameFaults()))
    wait_for_loop(arm)


def wait_for_loop(arm: Rig) -> None:
    """Wait until all frames sent have been received, without sending a frame that may be disturbed."""
    arm.peer.quiet()
    # A turn of the loop receives one frame at most, and then runs what was posted.
    for _ in range(15):
        done = threading.Event()
        arm.controller.post(done.set)
        assert done.wait(5.0)


def test_lost_nmt_stop_is_not_obeyed_and_late_one_is_when_it_arrives(arm):
    def drive_states() -> set[DriveState]:
        wait_for_loop(arm)
        return {node.drive.state for node in arm.controller.drives}

    arm.operational()
    for fault in ("lost", "late"):
        clear_disturbances(arm)
        disturb(arm, intact="wire_out", **{fault: 1.0})
        arm.peer.send(0x000, b"\x02\x00")
        assert drive_states() == {DriveState.OPERATION_ENABLED}
    arm.clock.time_s += 0.06
    assert drive_states() == {DriveState.QUICK_STOP_ACTIVE}


def test_frames_to_the_arm_are_doubled_or_have_a_flipped_bit(arm):
    states = arm.operational()
    disturb(arm, intact="wire_out", doubled=1.0)
    before = arm.controller.sync_count
    arm.peer.send(0x080)
    wait_for_loop(arm)
    assert arm.controller.sync_count == before + 2
    clear_disturbances(arm)
    disturb(arm, intact="wire_out", flipped=1.0)
    command = (0x0F, states[0][1], 8)
    for _ in range(10):
        arm.peer.command(1, *command)
    wait_for_loop(arm)
    drive = arm.controller.drives[0].drive
    received = (drive.controlword, drive.target_counts, drive.mode_request)
    # A target that is far away is refused; whichever bit it was, the drive received or refused something else.
    assert received != command or EmergencyCode.REFERENCE_LIMIT in drive.errors


@pytest.mark.parametrize(
    ("fault", "joints"),
    [("doubled", [k for j in range(1, 8) for k in (j, j)]), ("swapped", [2, 1, 4, 3, 6, 5])],
)
def test_frames_of_the_arm_are_doubled_or_swapped(arm, fault, joints):
    arm.peer.start()
    disturb(arm, intact="wire_in", **{fault: 1.0})
    arm.peer.send(0x080)
    wait_for_loop(arm)
    arm.peer.quiet()
    assert [number - 0x180 for number, _ in arm.peer.log if 0x180 < number < 0x190] == joints


def test_late_frames_of_the_arm_all_arrive(arm):
    arm.peer.start()
    disturb(arm, intact="wire_in", late=1.0)
    arm.peer.send(0x080)
    wait_for_loop(arm)
    for wait_s, expected in ((0.0, 0), (0.06, 1)):
        arm.clock.time_s += wait_s
        wait_for_loop(arm)
        arm.peer.quiet()
        assert tpdo_counts(arm) == [expected] * 7
