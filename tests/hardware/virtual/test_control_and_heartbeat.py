"""Who may command, and what happens when they fall silent; seen from the bus, with a clock of our own."""

import struct

import pytest

from hardware.arm import JointMode
from tests.oracles.raw_can import RawAbort
from tests.oracles.virtual_rig import Rig, rig

STATE = 0x006F
FREE = b"\0\0\0\0"


def token(node: int) -> bytes:
    return struct.pack("<I", node)


def take(arm: Rig, node: int) -> int | None:
    """Abort code, None if the token was given."""
    try:
        arm.peer.write(16, 0x2010, 0, token(node))
    except RawAbort as refused:
        return refused.code
    return None


def words(arm: Rig) -> list[int]:
    return [word for word, _, _ in arm.peer.sync()]


def test_the_token_is_free_taken_kept_and_given_back(arm):
    assert arm.peer.read(16, 0x2010) == FREE
    arm.peer.beat()
    assert take(arm, 127) is None
    assert take(arm, 127) is None
    assert arm.peer.unsigned(16, 0x2010) == 127
    assert take(arm, 0) is None
    assert arm.peer.read(16, 0x2010) == FREE


def test_nobody_takes_it_from_its_holder(arm):
    arm.peer.beat()
    arm.peer.beat(126)
    assert take(arm, 127) is None
    assert take(arm, 126) == 0x08000022
    assert arm.peer.unsigned(16, 0x2010) == 127
    assert b"node 127" in arm.peer.read(16, 0x2004)


@pytest.mark.parametrize("node", [127, 126, 1, 16])
def test_a_node_that_is_not_heard_gets_no_token(arm, node):
    assert take(arm, node) == 0x08000022
    assert arm.peer.read(16, 0x2010) == FREE


@pytest.mark.parametrize(("age_s", "code"), [(0.5, None), (0.501, 0x08000022)])
def test_heard_means_within_the_timeout(arm, age_s, code):
    arm.peer.beat()
    arm.settled()
    arm.passes(age_s)
    assert take(arm, 127) == code


def test_without_the_token_no_drive_can_be_enabled(arm):
    arm.peer.start()
    states = arm.peer.enable([8] * 7)
    assert [word & 0x4F for word, _, _ in states] == [0x40] * 7
    assert not states[0][0] & 1 << 9


def test_giving_it_back_leaves_all_drives_holding_without_a_fault(arm):
    arm.operational([8, 10, 10, 10, 8, 10, 10])
    assert take(arm, 0) is None
    assert [word & STATE for word in words(arm)] == [0x07] * 7
    assert {c.mode for c in arm.plant.commands} == {JointMode.POSITION}
    arm.passes(5.0)  # and the heartbeat may end now
    assert [word & STATE for word in words(arm)] == [0x07] * 7
    assert not [n for n, _ in arm.peer.log if 0x80 < n < 0x100]
    arm.peer.command(1, 0x0F, 0, 8)
    assert words(arm)[0] & STATE == 0x07


def lose_operator(arm: Rig) -> None:
    arm.passes(0.51)
    for joint in range(1, 8):
        arm.peer.wait_for(lambda number, _, joint=joint: number == 0x80 + joint)


def test_heartbeats_in_time_keep_control(arm):
    arm.operational()
    for _ in range(10):
        arm.passes(0.49)
        arm.peer.beat()
        assert [word & STATE for word in words(arm)] == [0x27] * 7


def test_a_lost_heartbeat_holds_all_joints_raises_8130h_and_frees_the_token(arm):
    states = arm.operational([8, 10, 10, 10, 8, 10, 10])
    lose_operator(arm)
    for joint in range(1, 8):
        assert [d[:3] for d in arm.peer.seen(0x80 + joint)] == [b"\x30\x81\x11"]
        assert arm.peer.unsigned(joint, 0x1001) == 0x11
        assert arm.peer.unsigned(joint, 0x1003, 1) == 0x8130
        assert arm.peer.signed(joint, 0x6061) == 8
    assert arm.peer.read(16, 0x2010) == FREE
    after = arm.peer.sync()
    assert [word & 0x4F for word, _, _ in after] == [0x08] * 7
    assert {c.mode for c in arm.plant.commands} == {JointMode.POSITION}
    assert [counts for _, counts, _ in after] == [counts for _, counts, _ in states]


def test_nothing_moves_after_a_lost_heartbeat_until_reset_and_enabled_again(arm):
    states = arm.operational()
    here = states[0][1]
    lose_operator(arm)
    arm.peer.beat()
    for step in range(1, 6):  # the operator wakes up and streams on
        arm.peer.command(1, 0x0F, here + 20 * step, 8)
        assert arm.peer.sync()[0][1] == here
    arm.peer.take_control()
    arm.peer.command(1, 0x0F, here + 20, 8)
    assert arm.peer.sync()[0][1] == here
    for joint in range(1, 8):
        arm.peer.command(joint, 0x80, here, 8)
    assert [word & 0x4F for word in words(arm)] == [0x40] * 7
    arm.peer.command(1, 0x0F, here + 20, 8)
    assert arm.peer.sync()[0][1] == here
    states = arm.peer.enable([8] * 7)
    assert [word & STATE for word, _, _ in states] == [0x27] * 7
    arm.peer.command(1, 0x0F, here + 20, 8)
    assert arm.peer.sync()[0][1] == here + 20
    assert arm.peer.unsigned(1, 0x1001) == 0


@pytest.mark.parametrize("waits", [200, 0], ids=["behind other frames", "not sent yet"])
def test_a_heartbeat_that_waits_as_this_loop_is_late_is_not_lost(arm, waits):
    """Where nothing waits, who sends it shares the processor: it is given its time once more."""
    arm.operational()
    arm.controller.hang()
    for _ in range(waits):
        arm.peer.send(0x080)
    if waits:
        arm.peer.beat()
    arm.clock.time_s += 3.0
    arm.controller.resume_loop()
    assert arm.peer.unsigned(16, 0x2010) == 127
    arm.passes(0.3)
    assert [word & STATE for word in words(arm)] == [0x27] * 7
    arm.passes(0.3)
    assert arm.peer.read(16, 0x2010) == FREE


def test_other_nodes_heartbeats_do_not_count_for_the_holder(arm):
    arm.operational()
    for _ in range(4):
        arm.passes(0.2)
        arm.peer.beat(126)
        arm.settled()
    assert arm.peer.read(16, 0x2010) == FREE


def test_the_timeout_can_be_set():
    with rig(heartbeat_timeout_s=2.0) as arm:
        arm.operational()
        assert arm.peer.unsigned(3, 0x1016, 1) == 127 << 16 | 2000
        arm.passes(1.99)
        assert arm.peer.unsigned(16, 0x2010) == 127
        arm.passes(0.02)
        arm.peer.wait_for(lambda number, _: number == 0x87)
        assert arm.peer.read(16, 0x2010) == FREE


def test_quick_stop_to_all_drives_stops_on_the_spot_and_stays(arm):
    states = arm.operational([8, 10, 10, 10, 8, 10, 10])
    here = states[0][1]
    arm.peer.command(1, 0x0F, here + 100, 8)
    arm.peer.sync()
    for joint in range(1, 8):
        arm.peer.command(joint, 0x02, 0, 8)
    arm.peer.command(1, 0x0F, here + 200, 8)  # was already on its way
    states = arm.peer.sync()
    assert [word & STATE for word, _, _ in states] == [0x07] * 7
    assert states[0][1] == here + 100
    assert [arm.peer.signed(joint, 0x6061) for joint in range(1, 8)] == [8] * 7


def test_history_1003h_is_newest_first_and_can_be_cleared(arm):
    arm.operational()
    here = arm.peer.sync()[0][1]
    arm.peer.command(1, 0x0F, here + 5000, 8)
    lose_operator(arm)
    assert [arm.peer.unsigned(1, 0x1003, sub) for sub in range(3)] == [2, 0x8130, 0x8612]
    arm.peer.write(1, 0x1003, 0, b"\0")
    assert arm.peer.unsigned(1, 0x1003, 0) == 0
