"""Control token and operator heartbeat, seen from the bus, with a fake clock."""

import struct

import pytest

from hardware.arm import JointMode
from tests.hardware.virtual.conftest import write_to_supervisor
from tests.oracles.virtual_rig import Rig, rig

STATE = 0x006F
FREE = b"\0\0\0\0"


def request_token(arm: Rig, node: int) -> int | None:
    """Abort code, None if the token was granted."""
    return write_to_supervisor(arm, 0x2010, struct.pack("<I", node))


def statuswords(arm: Rig) -> list[int]:
    return [word for word, _, _ in arm.peer.sync()]


def test_token_is_taken_refused_to_another_node_and_returned(arm):
    assert arm.peer.read(16, 0x2010) == FREE
    for node in (126, 127):
        arm.peer.beat(node)
    for node, code in ((127, None), (127, None), (126, 0x08000022)):
        assert request_token(arm, node) == code
        assert arm.peer.unsigned(16, 0x2010) == 127
    assert b"node 127" in arm.peer.read(16, 0x2004)
    assert request_token(arm, 0) is None
    assert arm.peer.read(16, 0x2010) == FREE


@pytest.mark.parametrize("node", [127, 126, 1, 16])
def test_node_without_heartbeat_gets_no_token(arm, node):
    assert request_token(arm, node) == 0x08000022
    assert arm.peer.read(16, 0x2010) == FREE


@pytest.mark.parametrize(("age_s", "code"), [(0.5, None), (0.501, 0x08000022)])
def test_token_needs_a_heartbeat_within_the_timeout(arm, age_s, code):
    arm.peer.beat()
    arm.run_in_loop()
    arm.advance_time(age_s)
    assert request_token(arm, 127) == code


def test_without_token_no_drive_is_enabled(arm):
    arm.peer.start()
    states = arm.peer.enable([8] * 7)
    assert [word & 0x4F for word, _, _ in states] == [0x40] * 7
    assert not states[0][0] & 1 << 9


def test_returned_token_leaves_drives_holding_without_fault(arm):
    arm.operational([8, 10, 10, 10, 8, 10, 10])
    assert request_token(arm, 0) is None
    assert [word & STATE for word in statuswords(arm)] == [0x07] * 7
    assert {mode for mode, _ in arm.plant.commands} == {JointMode.POSITION}
    arm.advance_time(5.0)  # no heartbeat is needed any more
    assert [word & STATE for word in statuswords(arm)] == [0x07] * 7
    assert not [n for n, _ in arm.peer.log if 0x80 < n < 0x100]
    arm.peer.command(1, 0x0F, 0, 8)
    assert statuswords(arm)[0] & STATE == 0x07


def lose_operator(arm: Rig) -> None:
    arm.advance_time(0.51)
    for joint in range(1, 8):
        arm.peer.wait_for(lambda number, _, joint=joint: number == 0x80 + joint)


def test_lost_heartbeat_holds_joints_raises_8130h_and_frees_token(arm):
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
    assert {mode for mode, _ in arm.plant.commands} == {JointMode.POSITION}
    assert [counts for _, counts, _ in after] == [counts for _, counts, _ in states]


def test_after_lost_heartbeat_joints_move_only_once_reset_and_enabled(arm):
    counts = arm.operational()[0][1]
    lose_operator(arm)
    arm.peer.beat()
    for step in range(1, 6):  # the operator returns and keeps sending
        arm.peer.command(1, 0x0F, counts + 20 * step, 8)
        assert arm.peer.sync()[0][1] == counts
    arm.peer.take_control()
    arm.peer.command(1, 0x0F, counts + 20, 8)
    assert arm.peer.sync()[0][1] == counts
    arm.peer.command_all(0x80)
    assert [word & 0x4F for word in statuswords(arm)] == [0x40] * 7
    arm.peer.command(1, 0x0F, counts + 20, 8)
    assert arm.peer.sync()[0][1] == counts
    states = arm.peer.enable([8] * 7)
    assert [word & STATE for word, _, _ in states] == [0x27] * 7
    arm.peer.command(1, 0x0F, counts + 20, 8)
    assert arm.peer.sync()[0][1] == counts + 20
    assert arm.peer.unsigned(1, 0x1001) == 0


@pytest.mark.parametrize("queued", [200, 0], ids=["behind other frames", "not sent yet"])
def test_controller_latency_is_excluded_from_the_heartbeat_timeout(arm, queued):
    """With an empty queue, the sender may have been delayed by the same processor: one timeout is added."""
    arm.operational()
    arm.controller.running.clear()
    for _ in range(queued):
        arm.peer.send(0x080)
    if queued:
        arm.peer.beat()
    arm.clock.time_s += 3.0
    arm.controller.running.set()
    assert arm.peer.unsigned(16, 0x2010) == 127
    arm.advance_time(0.3)
    assert [word & STATE for word in statuswords(arm)] == [0x27] * 7
    arm.advance_time(0.3)
    assert arm.peer.read(16, 0x2010) == FREE


def test_heartbeats_of_other_nodes_do_not_keep_the_token(arm):
    arm.operational()
    for _ in range(4):
        arm.advance_time(0.2)
        arm.peer.beat(126)
        arm.run_in_loop()
    assert arm.peer.read(16, 0x2010) == FREE


def test_heartbeat_timeout_is_configurable():
    with rig(heartbeat_timeout_s=2.0) as arm:
        arm.operational()
        assert arm.peer.unsigned(3, 0x1016, 1) == 127 << 16 | 2000
        arm.advance_time(1.99)
        assert arm.peer.unsigned(16, 0x2010) == 127
        arm.advance_time(0.02)
        arm.peer.wait_for(lambda number, _: number == 0x87)
        assert arm.peer.read(16, 0x2010) == FREE


def test_quick_stop_of_all_drives_stops_at_the_position_and_stays(arm):
    counts = arm.operational([8, 10, 10, 10, 8, 10, 10])[0][1]
    arm.peer.command(1, 0x0F, counts + 100, 8)
    arm.peer.sync()
    arm.peer.command_all(0x02)
    arm.peer.command(1, 0x0F, counts + 200, 8)  # sent before the stop arrived
    states = arm.peer.sync()
    assert [word & STATE for word, _, _ in states] == [0x07] * 7
    assert states[0][1] == counts + 100
    assert [arm.peer.signed(joint, 0x6061) for joint in range(1, 8)] == [8] * 7


def test_error_history_1003h_is_newest_first_and_clearable(arm):
    counts = arm.operational()[0][1]
    arm.peer.command(1, 0x0F, counts + 5000, 8)
    assert arm.peer.unsigned(1, 0x1001) == 0x21
    lose_operator(arm)
    assert [arm.peer.unsigned(1, 0x1003, sub) for sub in range(3)] == [2, 0x8130, 0x8612]
    arm.peer.write(1, 0x1003, 0, b"\0")
    assert arm.peer.unsigned(1, 0x1003, 0) == 0
