"""Tests that an arm added by a package, simulated or real, meets the requirements of `sarcal`.

::

    CAN_INTERFACE=my_arm CAN_CHANNEL=127.0.0.1:7400 pytest --pyargs sarcal.arm_contract

The arm is found as `sarcal run` finds it. `SARCAL_PROCEDURE` names the procedure with its arm, fixture and speeds
(default: ``hinge``). **The arm moves**, and must be free to: the drive joints move by `STEP_RAD` and back, and STOP is
tested. An arm that is moved by hand skips these motions. Without CAN_INTERFACE the embedded virtual arm is used.

The requirements are in `hardware.commissioning.clauses` and `.checks`; `sarcal arm-check` tests the same.
"""

import math
import os
from collections.abc import Callable, Iterable, Iterator, Mapping

import pytest

from hardware.arm import ArmIdentity, ArmInterface, ArmSnapshot, JointMode
from hardware.commissioning import checks, clauses
from hardware.commissioning.clauses import Bounds, Clause
from operator_app.composition import describe, open_arm
from operator_app.config.procedure import Procedure
from operator_app.session.workflow.opening import Choices, begin
from solver.chain.parameters import nominal_vector
from solver.design.drive_joints import rank_at_pose

STEP_RAD = math.radians(2.0)
BOUNDS = Bounds(samples=10, still_rad=math.radians(0.5), near_rad=math.radians(0.5))
"""Step of a drive joint, and limits of comparisons; both suit an arm in a fixture, in which free joints follow."""


class _ConnectedArm:
    def __init__(self, arm: ArmInterface, procedure: Procedure, identity: ArmIdentity) -> None:
        self.arm, self.procedure, self.identity = arm, procedure, identity
        self.n = procedure.arm.joint_count
        self.speed_rad_per_s = procedure.capture.speed_rad_per_s

    @property
    def drives(self) -> tuple[int, ...]:
        """Joints (from 1) in position mode.

        In an open chain, these are all joints. In a closed loop, the procedure names them, or the best set is used.
        """
        fixture = self.procedure.fixture.fixture
        if not fixture.holds_hand:
            return tuple(range(1, self.n + 1))
        if self.procedure.position_joints is not None:
            return self.procedure.position_joints
        model = fixture.model(self.procedure.arm)
        q_rad = self.arm.snapshot().positions_rad
        return rank_at_pose(model, nominal_vector(model.parameters), q_rad)[0].drives

    def ready(self) -> tuple[int, ...]:
        drives = self.drives
        self.arm.take_control()
        self.arm.set_modes(self.modes(drives))
        return drives

    def modes(self, drives: tuple[int, ...]) -> list[JointMode]:
        numbers = range(1, self.n + 1)
        return [JointMode.POSITION if j in drives else JointMode.FREE for j in numbers]

    def away(self, joint: int) -> float:
        """Return a target angle, rad: `STEP_RAD` from the joint's position, towards the farther end of its range."""
        position_rad = self.arm.snapshot().joints[joint - 1].position_rad
        limits = self.procedure.arm.joints[joint - 1]
        up = limits.upper_rad - position_rad > position_rad - limits.lower_rad
        return position_rad + (STEP_RAD if up else -STEP_RAD)

    def turn(self, joint: int, target_rad: float, speed_rad_per_s: float) -> checks.Turn:
        return checks.Turn(
            arm=self.arm,
            joint=joint,
            target_rad=target_rad,
            speed_rad_per_s=speed_rad_per_s,
            bounds=BOUNDS,
        )

    def require_moved(self) -> None:
        if self.identity.by_hand:
            pytest.skip("this arm is moved by hand")


@pytest.fixture(scope="module")
def bench(tmp_path_factory: pytest.TempPathFactory) -> Iterator[_ConnectedArm]:
    """Connect the arm once for all tests; every test leaves it ready for the next one."""
    named = os.environ.get("SARCAL_PROCEDURE", "hinge")
    opening = begin(named, Choices(), root=tmp_path_factory.mktemp("contract"))
    with open_arm(opening) as rig:
        yield _ConnectedArm(rig.arm, rig.opening.procedure, rig.arm.connect())


def fulfils(tried: Clause | Iterable[Clause]) -> None:
    """Fail the test if a clause in `tried` is broken. Skip the test if none is broken, but one could not be tested."""
    count, unknown = 0, []
    for clause in [tried] if isinstance(tried, Clause) else tried:
        count += 1
        assert clause.passed is not False, f"{clause.name}: {clause.text}"
        if clause.passed is None:
            unknown.append(f"{clause.name}: {clause.text}")
    assert count, "nothing was tried"
    if unknown:
        pytest.skip("; ".join(unknown))


REQUIREMENTS_AT_REST: Mapping[str, Callable[[_ConnectedArm], Iterable[Clause]]] = {
    "identity": lambda b: clauses.identifies_itself(b.identity, b.procedure.arm.name, b.n),
    "snapshot": lambda b: clauses.has_valid_snapshot(b.arm, b.n),
    "samples": lambda b: clauses.goes_on(b.arm),
    "reading": lambda b: clauses.reads(b.arm, b.n, BOUNDS),
    "settling": lambda b: clauses.settles(b.arm, b.n, BOUNDS),
    "control": lambda b: clauses.is_enabled_unmoved(b.arm, BOUNDS),
    "modes": lambda b: clauses.reads_modes_back(b.arm, b.modes(b.ready())),
}


@pytest.mark.parametrize("requirement", REQUIREMENTS_AT_REST)
def test_requirement_at_rest(bench: _ConnectedArm, requirement: str) -> None:
    fulfils(REQUIREMENTS_AT_REST[requirement](bench))


def test_a_drive_joint_goes_where_it_is_told_and_back(bench: _ConnectedArm) -> None:
    bench.require_moved()
    joint = bench.ready()[0]
    start_rad, target_rad = bench.arm.snapshot().joints[joint - 1].position_rad, bench.away(joint)
    turns = (bench.turn(joint, target, bench.speed_rad_per_s) for target in (target_rad, start_rad))
    fulfils(clause for turn in turns for clause in checks.goes(turn))


def test_a_watch_sees_the_move_and_its_sentence_ends_it(bench: _ConnectedArm) -> None:
    drives = bench.ready()
    snapshots: list[ArmSnapshot] = []

    def watch(snapshot: ArmSnapshot) -> str | None:
        snapshots.append(snapshot)
        return "that is enough" if len(snapshots) == 3 else None

    targets = {j: bench.away(j) for j in drives}
    outcome = bench.arm.move(targets, speed_rad_per_s=bench.speed_rad_per_s / 4.0, watch=watch)
    assert len(snapshots) >= 3 or bench.identity.by_hand
    if len(snapshots) >= 3:
        assert (outcome.reached, outcome.reason) == (False, "that is enough")


def test_a_joint_that_is_free_is_not_moved(bench: _ConnectedArm) -> None:
    drives = bench.ready()
    free = next((j for j in range(1, bench.n + 1) if j not in drives), None)
    if free is None:
        pytest.skip("every joint drives")
    fulfils(clauses.refuses_to_move_free(bench.arm, free, bench.speed_rad_per_s))


def test_a_target_outside_the_range_is_refused(bench: _ConnectedArm) -> None:
    joint = bench.ready()[0]
    ranged = describe(bench.procedure.arm).joints[joint - 1]
    fulfils(clauses.keeps_within_limits(bench.arm, joint, ranged, bench.speed_rad_per_s))


def test_stop_ends_a_move_latches_and_its_reset_moves_nothing(bench: _ConnectedArm) -> None:
    bench.require_moved()
    joint = bench.ready()[0]
    slowly = bench.speed_rad_per_s / 4.0
    fulfils(checks.is_stopped(bench.turn(joint, bench.away(joint), slowly)))
    bench.ready()


def test_it_keeps_a_document_or_refuses_it(bench: _ConnectedArm) -> None:
    bench.arm.take_control()
    fulfils(clauses.keeps_its_document(bench.arm))


def test_it_closes_with_its_drives_off_closes_twice_and_connects_again(
    bench: _ConnectedArm,
) -> None:
    bench.ready()
    fulfils(clauses.leaves_and_returns(bench.arm, bench.identity))
