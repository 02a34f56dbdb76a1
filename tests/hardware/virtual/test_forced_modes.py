"""The wrong number of drives, forced on the controller with the real plant behind it, past all guards."""

import math
from collections.abc import Iterator

import pytest

from hardware.virtual.axis import arm_axes
from hardware.virtual.scenarios import scenario
from solver.chain.arm_model import ArmModel
from tests.oracles.virtual_rig import Rig, rig

STATE = 0x006F
COUNTS_PER_DEG = 400_000 / 360
POSITION, FREE = 8, 10
TWO = [POSITION, FREE, FREE, FREE, POSITION, FREE, FREE]
THREE = [POSITION, FREE, POSITION, FREE, POSITION, FREE, FREE]
ONE = [POSITION, FREE, FREE, FREE, FREE, FREE, FREE]


@pytest.fixture
def arm(sarcos: ArmModel) -> Iterator[Rig]:
    exact = scenario("exact")
    carried = exact.arm(sarcos)
    with rig(plant=exact.build(carried), axes=arm_axes(carried)) as made:
        yield made


def move_joint_1(arm: Rig, here: int, degrees: float, mode: int = POSITION) -> list[list[int]]:
    """20 deg/s, one step a SYNC; positions of all joints after every SYNC."""
    steps = round(abs(degrees) / 0.2)
    positions = []
    for step in range(1, steps + 1):
        target = here + round(degrees * step / steps * COUNTS_PER_DEG)
        arm.peer.command(1, 0x0F, target, mode)
        positions.append([counts for _, counts, _ in arm.peer.sync()])
    return positions


def settled(arm: Rig) -> list[int]:
    for _ in range(60):
        states = arm.peer.sync()
    return [counts for _, counts, _ in states]


def emergencies(arm: Rig) -> dict[int, int]:
    return {
        number & 0x7F: int.from_bytes(data[:2], "little")
        for number, data in arm.peer.log
        if 0x80 < number < 0x100
    }


def test_two_drives_move_the_chain_and_it_comes_back(arm: Rig) -> None:
    arm.operational(TWO)
    here, start = arm.peer.signed(1, 0x607A), settled(arm)
    move_joint_1(arm, here, 10.0)
    out = settled(arm)
    # The load leans on the servo: hundredths of a degree.
    assert out[0] == pytest.approx(start[0] + 10 * COUNTS_PER_DEG, abs=0.02 * COUNTS_PER_DEG)
    moved_deg = [abs(a - b) / COUNTS_PER_DEG for a, b in zip(out, start, strict=True)]
    assert min(moved_deg[j] for j in (1, 2, 3, 5, 6)) > 0.1  # the free joints follow
    move_joint_1(arm, here + round(10 * COUNTS_PER_DEG), -10.0)
    assert settled(arm) == pytest.approx(start, abs=2)
    assert emergencies(arm) == {}


def test_a_third_drive_builds_up_torque_until_8311h_trips(arm: Rig) -> None:
    states = arm.operational(THREE)
    positions = move_joint_1(arm, states[0][1], 15.0)
    tripped = emergencies(arm)
    assert tripped
    assert set(tripped.values()) == {0x8311}
    words = [word for word, _, _ in arm.peer.sync()]
    for joint, word in enumerate(words, start=1):
        assert word & (0x4F if joint in tripped else STATE) == (8 if joint in tripped else 7)
    still = [counts for _, counts, _ in arm.peer.sync()]
    assert still == pytest.approx(positions[-1], abs=3)


def test_a_single_drive_lets_the_arm_sag(arm: Rig) -> None:
    states = arm.operational(ONE)
    start = [counts for _, counts, _ in states]
    for _ in range(300):
        now = [counts for _, counts, _ in arm.peer.sync()]
    sagged_deg = max(abs(a - b) for a, b in zip(now, start, strict=True)) / COUNTS_PER_DEG
    assert sagged_deg > 0.5
    assert abs(now[0] - start[0]) / COUNTS_PER_DEG < 1.0


def test_torque_stays_far_from_its_trip_in_a_normal_move(arm: Rig) -> None:
    states = arm.operational(TWO)
    here, largest = states[0][1], 0.0
    for step in range(1, 101):
        arm.peer.command(1, 0x0F, here + round(step * 0.2 * COUNTS_PER_DEG), POSITION)
        largest = max(largest, *(abs(torque) for _, _, torque in arm.peer.sync()))
    assert 0.0 < largest < 600  # per mille of 100 N m
    assert math.isfinite(largest)
