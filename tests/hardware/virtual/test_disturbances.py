"""Faults of frames and of single nodes: the wire alone, then a controller seen from the bus."""

import threading

import can
import pytest

from hardware.arm import JointMode
from hardware.virtual.disturbances import FaultyWire, FrameFaults
from hardware.virtual.faults import disturb_frames
from tests.oracles.virtual_rig import FakeClock, Rig

STATE, FAULT, QUICK_STOPPED = 0x006F, 0x08, 0x07


@pytest.mark.parametrize(
    ("fault", "in_time", "late"),
    [
        ("lost", [], []),
        ("doubled", [0, 0, 1, 1, 2, 2, 3, 3, 4, 4], []),
        ("swapped", [1, 0, 3, 2], []),
        ("late", [], [0, 1, 2, 3, 4]),
    ],
)
def test_wire_loses_doubles_swaps_and_delays_frames(fault, in_time, late):
    clock = FakeClock()
    wire = FaultyWire(FrameFaults(**{fault: 1.0}), clock=clock)
    sent = [can.Message(arbitration_id=k, is_extended_id=False) for k in range(5)]
    assert [m.arbitration_id for frame in sent for m in wire.passed(frame)] == in_time
    assert list(wire.overdue()) == []
    clock.time_s += 0.06
    assert sorted(message.arbitration_id for message in wire.overdue()) == late


def test_wire_flips_one_bit_of_a_copy():
    wire = FaultyWire(FrameFaults(flipped=1.0))
    for _ in range(20):
        sent = can.Message(arbitration_id=0x201, data=bytes(7), is_extended_id=False)
        (received,) = wire.passed(sent)
        assert int.from_bytes(received.data, "little").bit_count() == 1
        assert sent.data == bytes(7)


def tpdo_counts(arm: Rig) -> list[int]:
    return [len(arm.peer.seen(0x180 + joint)) for joint in range(1, 8)]


@pytest.mark.parametrize(
    ("kind", "joint", "tpdos", "heartbeats"),
    [
        ("silent-node", 4, [11, 11, 11, 0, 11, 11, 11], [3, 3, 3, 0, 3, 3, 3]),
        ("missed-answers", 3, [11, 11, 1, 11, 11, 11, 11], [3] * 7),
        ("wrong-node", 7, [22, 11, 11, 11, 11, 11, 0], [3] * 7),
        ("no-heartbeat", 2, [11] * 7, [3, 0, 3, 3, 3, 3, 3]),
        ("other-heartbeat", 3, [11] * 7, [3, 3, 1, 3, 3, 3, 3]),
    ],
)
def test_node_fault_changes_frames_of_its_node(arm, kind, joint, tpdos, heartbeats):
    arm.peer.start()
    arm.inject_fault(kind, joint)
    arm.peer.log.clear()
    for _ in range(11):
        arm.peer.send(0x080)
    # A turn of the loop receives one frame; without this wait, heartbeats may come before the last SYNC.
    arm.run_in_loop()
    for _ in range(3):
        arm.clock.time_s += 0.1
        arm.peer.wait_for(lambda number, _: number == 0x710)
    assert tpdo_counts(arm) == tpdos
    assert [len(arm.peer.seen(0x700 + node)) for node in range(1, 8)] == heartbeats
    if kind == "other-heartbeat":
        assert arm.peer.unsigned(3, 0x1017) == 5000


def test_silent_node_receives_nothing_and_holds_after_heartbeat_timeout(arm):
    arm.operational([10] * 7)
    arm.inject_fault("silent-node", 4)
    arm.peer.command(4, 0x00, 0, 8)
    arm.peer.send(0x080)
    arm.run_in_loop()
    assert arm.plant.commands[3][0] is JointMode.FREE
    for _ in range(6):
        arm.clock.time_s += 0.1
        arm.peer.beat()
        arm.run_in_loop()
    arm.peer.send(0x080)
    arm.run_in_loop()
    assert arm.plant.commands[3][0] is JointMode.POSITION
    arm.run_in_loop(lambda: arm.controller.cut_since_s.pop(4))
    states = arm.peer.sync()
    assert states[3][0] & 0x4F == FAULT
    assert {word & STATE for k, (word, _, _) in enumerate(states) if k != 3} == {QUICK_STOPPED}
    assert arm.peer.unsigned(4, 0x1003, 1) == 0x8130


def test_other_map_changes_frames_and_object(arm):
    arm.peer.start()
    counts = arm.peer.sync()[2][1]
    arm.run_in_loop(lambda: arm.plant.speed_rad_per_s.__setitem__(2, 0.5))
    arm.inject_fault("other-map", 3)
    states = arm.peer.sync()
    assert states[2][1] == round(0.5 * arm.plant.scales[2]) != counts
    assert states[1][1] == round(arm.plant.angles_rad[1] * arm.plant.scales[1])
    assert arm.peer.unsigned(3, 0x1A00, 2) == 0x606C0020


@pytest.mark.parametrize("data", [b"", bytes(7)])
def test_node_that_refuses_object_access_ignores_frames_of_another_length(arm, data):
    arm.inject_fault("sdo-abort", 1)
    arm.peer.send(0x601, data)
    arm.run_in_loop()
    assert arm.peer.seen(0x581) == []
    arm.peer.send(0x601, bytes([0x40, 0x00, 0x10, *bytes(5)]))
    aborted = bytes.fromhex("8000100000000008")
    assert arm.peer.wait_for(lambda number, _: number == 0x581)[1] == aborted


def disturb(arm: Rig, *, intact: str, **fractions: float) -> None:
    """Disturb frames in one direction; `intact` is the other: "wire_in" (to the arm) or "wire_out"."""

    def act() -> None:
        disturb_frames(arm.controller, FrameFaults(**fractions))
        setattr(arm.controller, intact, FaultyWire())

    arm.controller.post(act)
    wait_for_loop(arm)


def wait_for_loop(arm: Rig) -> None:
    """Wait until all frames sent have been received, without sending a frame that may be disturbed."""
    arm.peer.quiet()
    # A turn of the loop receives one frame at most, and then runs what was posted.
    for _ in range(15):
        done = threading.Event()
        arm.controller.post(done.set)
        assert done.wait(60.0)


@pytest.mark.parametrize("intact", ["wire_in", "wire_out"])
@pytest.mark.parametrize(
    ("fault", "at_once", "later"), [("lost", 0, 0), ("doubled", 2, 2), ("late", 0, 1)]
)
def test_syncs_or_their_answers_are_lost_doubled_or_late(arm, intact, fault, at_once, later):
    arm.peer.start()
    disturb(arm, intact=intact, **{fault: 1.0})
    arm.peer.send(0x080)
    for wait_s, expected in ((0.0, at_once), (0.06, later)):
        arm.clock.time_s += wait_s
        wait_for_loop(arm)
        arm.peer.quiet()
        assert tpdo_counts(arm) == [expected] * 7
