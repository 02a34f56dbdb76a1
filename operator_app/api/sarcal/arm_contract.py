"""What `sarcal` relies on of an arm, as tests that a package runs on its own: its simulator, or a free arm.

::

    CAN_INTERFACE=my_arm CAN_CHANNEL=127.0.0.1:7400 pytest --pyargs sarcal.arm_contract

The arm is found as `sarcal run` finds it. `SARCAL_PROCEDURE` names the procedure whose arm, fixture and speeds
it has (default hinge). **The arm moves**: the joints that drive go `STEP_RAD` away and back, and STOP is tried.
An arm that is moved by hand stays where it is. Without CAN_INTERFACE it is the embedded virtual arm.
"""

from __future__ import annotations

import math
import os
from collections.abc import Iterator
from threading import Thread

import numpy as np
import pytest

from hardware.arm import Arm, ArmIdentity, ArmSnapshot, DriveState, JointMode
from hardware.errors import CommandRefused, HardwareError, Stopped
from operator_app.composition import open_arm
from operator_app.config.procedure import Procedure
from operator_app.session.opening import Choices, begin
from solver.chain.parameters import nominal_vector
from solver.design.drive_joints import rank_at_pose

STEP_RAD = math.radians(2.0)
NEAR_RAD = math.radians(0.5)
STILL_RAD = math.radians(0.5)
SAMPLES = 10


class Bench:
    """A connected arm, what it said of itself, and the procedure it is used by."""

    def __init__(self, arm: Arm, procedure: Procedure, identity: ArmIdentity) -> None:
        self.arm, self.procedure, self.identity = arm, procedure, identity
        self.n = procedure.arm.joint_count

    @property
    def drives(self) -> tuple[int, ...]:
        """Joints in position mode: as the procedure says, else those that move the others most here."""
        fixture = self.procedure.fixture.fixture
        if not fixture.holds_hand:
            return tuple(range(1, self.n + 1))
        if self.procedure.position_joints is not None:
            return self.procedure.position_joints
        model = fixture.model(self.procedure.arm)
        here = self.arm.snapshot().positions_rad
        return rank_at_pose(model, nominal_vector(model.parameters), here)[0].drives

    def ready(self) -> tuple[int, ...]:
        """Drives enabled, in the modes of a capture; the joints that drive."""
        drives = self.drives
        self.arm.take_control()
        self.arm.set_modes(self.modes(drives))
        return drives

    def modes(self, drives: tuple[int, ...]) -> list[JointMode]:
        """Position mode for `drives`, free for the others."""
        numbers = range(1, self.n + 1)
        return [JointMode.POSITION if j in drives else JointMode.FREE for j in numbers]

    @property
    def speed_rad_per_s(self) -> float:
        """Of the procedure."""
        return self.procedure.capture.speed_rad_per_s

    def away(self, joint: int) -> float:
        """A target `STEP_RAD` away, on the side where the joint's range is longer."""
        here, limits = self.arm.snapshot().joints[joint - 1], self.procedure.arm.joints[joint - 1]
        up = limits.upper_rad - here.position_rad > here.position_rad - limits.lower_rad
        return here.position_rad + (STEP_RAD if up else -STEP_RAD)

    def require_moved(self) -> None:
        """Skip what an arm cannot show that a person moves."""
        if self.identity.by_hand:
            pytest.skip("this arm is moved by hand")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Bench]:
    """The arm, connected once; every test leaves it as it may be found."""
    named = os.environ.get("SARCAL_PROCEDURE", "hinge")
    opening = begin(named, Choices(), root=tmp_path_factory.mktemp("contract"))
    with open_arm(opening) as rig:
        yield Bench(rig.arm, rig.opening.procedure, rig.arm.connect())


def test_it_says_who_it_is(bench: Bench) -> None:
    identity = bench.identity
    assert identity.model == bench.procedure.arm.name
    assert identity.serial_number.strip(), "poses of two arms must not get into one session"
    assert [node.role for node in identity.nodes if node.role.startswith("joint")] == [
        f"joint {j}" for j in range(1, bench.n + 1)
    ]


def test_a_snapshot_is_a_fresh_picture_of_every_joint(bench: Bench) -> None:
    found = bench.arm.snapshot()
    assert [joint.joint for joint in found.joints] == list(range(1, bench.n + 1))
    assert np.all(np.isfinite(found.positions_rad))
    assert np.all(np.isfinite(found.torques_nm))
    assert np.abs(found.positions_rad).max() < 4.0 * math.pi, "angles are in radians"
    assert all(0.0 <= joint.age_s < 1.0 for joint in found.joints)
    assert not found.stopped


def test_samples_go_on(bench: Bench) -> None:
    before = bench.arm.snapshot().sync_count
    bench.arm.capture(2)
    assert bench.arm.snapshot().sync_count > before


def test_a_reading_is_statistics_over_samples(bench: Bench) -> None:
    reading = bench.arm.capture(SAMPLES)
    assert reading.samples == SAMPLES
    for values in (reading.mean_counts, reading.mean_rad, reading.sd_rad):
        assert values.shape == (bench.n,)
        assert np.all(np.isfinite(values))
    assert np.all(reading.sd_rad >= 0.0)
    assert reading.mean_rad == pytest.approx(bench.arm.snapshot().positions_rad, abs=STILL_RAD)


def test_an_arm_at_rest_settles_and_one_that_may_not_spread_does_not(bench: Bench) -> None:
    wide, window = [STILL_RAD] * bench.n, 5
    assert bench.arm.settle(window=window, spread_rad=wide, timeout_syncs=500)
    assert not bench.arm.settle(window=window, spread_rad=[-1.0] * bench.n, timeout_syncs=20)


def test_taking_control_enables_the_drives_and_moves_nothing(bench: Bench) -> None:
    before = bench.arm.capture(SAMPLES).mean_rad
    bench.arm.take_control()
    assert {j.drive for j in bench.arm.snapshot().joints} == {DriveState.OPERATION_ENABLED}
    assert bench.arm.capture(SAMPLES).mean_rad == pytest.approx(before, abs=STILL_RAD)


def test_modes_are_read_back(bench: Bench) -> None:
    drives = bench.ready()
    assert [j.mode for j in bench.arm.snapshot().joints] == bench.modes(drives)
    bench.arm.hold()
    assert {j.mode for j in bench.arm.snapshot().joints} == {JointMode.POSITION}


def test_a_drive_joint_goes_where_it_is_told_and_back(bench: Bench) -> None:
    bench.require_moved()
    joint = bench.ready()[0]
    here, there = bench.arm.snapshot().joints[joint - 1].position_rad, bench.away(joint)
    for target in (there, here):
        moved = bench.arm.move({joint: target}, speed_rad_per_s=bench.speed_rad_per_s)
        assert moved.reached, moved.reason
        assert bench.arm.settle(window=5, spread_rad=[STILL_RAD] * bench.n, timeout_syncs=1000)
        assert bench.arm.capture(SAMPLES).mean_rad[joint - 1] == pytest.approx(target, abs=NEAR_RAD)


def test_a_watch_sees_the_move_and_its_sentence_ends_it(bench: Bench) -> None:
    drives = bench.ready()
    seen: list[ArmSnapshot] = []

    def watch(snapshot: ArmSnapshot) -> str | None:
        seen.append(snapshot)
        return "that is enough" if len(seen) == 3 else None

    targets = {j: bench.away(j) for j in drives}
    moved = bench.arm.move(targets, speed_rad_per_s=bench.speed_rad_per_s / 4.0, watch=watch)
    assert len(seen) >= 3 or bench.identity.by_hand
    if len(seen) >= 3:
        assert (moved.reached, moved.reason) == (False, "that is enough")


def test_a_joint_that_is_free_is_not_moved(bench: Bench) -> None:
    drives = bench.ready()
    free = next((j for j in range(1, bench.n + 1) if j not in drives), None)
    if free is None:
        pytest.skip("every joint drives")
    with pytest.raises(CommandRefused):
        bench.arm.move({free: bench.away(free)}, speed_rad_per_s=bench.speed_rad_per_s)


def test_a_target_outside_the_range_is_refused(bench: Bench) -> None:
    joint = bench.ready()[0]
    beyond = bench.procedure.arm.joints[joint - 1].upper_rad + STEP_RAD
    with pytest.raises(CommandRefused):
        bench.arm.move({joint: beyond}, speed_rad_per_s=bench.speed_rad_per_s)


def test_stop_ends_a_move_latches_and_its_reset_moves_nothing(bench: Bench) -> None:
    bench.require_moved()
    joint = bench.ready()[0]
    target, calls = bench.away(joint), 0

    def watch(snapshot: ArmSnapshot) -> str | None:
        nonlocal calls
        calls += 1
        if calls == 2:
            # From another thread: the one that moves the arm is busy.
            presser = Thread(target=bench.arm.stop)
            presser.start()
            presser.join()
        return None

    with pytest.raises(Stopped):
        bench.arm.move({joint: target}, speed_rad_per_s=bench.speed_rad_per_s / 4.0, watch=watch)
    assert bench.arm.snapshot().stopped
    with pytest.raises(Stopped):
        bench.arm.move({joint: target}, speed_rad_per_s=bench.speed_rad_per_s)
    before = bench.arm.snapshot().positions_rad
    bench.arm.reset_stop()
    found = bench.arm.snapshot()
    assert not found.stopped
    assert DriveState.OPERATION_ENABLED not in {j.drive for j in found.joints}
    assert bench.arm.capture(SAMPLES).mean_rad == pytest.approx(before, abs=STILL_RAD)
    bench.ready()


def test_it_keeps_a_document_or_refuses_it(bench: Bench) -> None:
    assert isinstance(bench.arm.active_parameters(), bytes)
    bench.arm.take_control()
    with pytest.raises(HardwareError):
        bench.arm.upload_parameters(b"no parameter document")


def test_it_closes_with_its_drives_off_closes_twice_and_connects_again(bench: Bench) -> None:
    bench.ready()
    assert bench.arm.close()
    assert bench.arm.close()
    with pytest.raises(HardwareError):
        bench.arm.snapshot()
    assert bench.arm.connect() == bench.identity
    found = bench.arm.snapshot()
    assert len(found.joints) == bench.n
    # Between the two a person may have unbolted the hand.
    assert DriveState.OPERATION_ENABLED not in {joint.drive for joint in found.joints}
