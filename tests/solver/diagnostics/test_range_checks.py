"""Readings outside what the arm can read: named, or refused, before anything is solved."""

import numpy as np
import pytest

from solver.chain.poses import PoseSet
from solver.diagnostics.range_checks import (
    RangeFinding,
    ReadingFault,
    ReadingsOutOfRangeError,
    mistakes,
    mostly_in_range,
    range_findings,
)
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.simulated_loops import LSB_RAD, Simulation
from tests.solver.conftest import paper_arm

ARM = paper_arm(paper_truth())


def found_in(q: np.ndarray, **options: tuple[int, ...]) -> tuple[RangeFinding, ...]:
    labels = tuple(str(k) for k in range(1, len(q) + 1))
    poses = PoseSet(placement=np.ones(len(q), dtype=int), label=labels, q_rad=q)
    return range_findings(ARM, poses, **options)


@pytest.fixture
def q():
    return Simulation(poses=30).readings(5)


def test_sound_readings_are_inside(q):
    assert found_in(q) == ()


@pytest.mark.parametrize("side", [-1.0, 1.0])
def test_readings_slightly_out_of_range_are_noise_and_farther_are_named(q, side):
    end = ARM.upper_rad[2] if side > 0 else ARM.lower_rad[2]
    q[7, 2] = end + side * np.deg2rad(0.9)
    assert found_in(q) == ()
    q[7, 2] = end + side * np.deg2rad(2.0)
    (result,) = found_in(q)
    assert (result.joint, result.fault, result.poses) == (3, ReadingFault.OUTSIDE, (7,))


def test_readings_of_another_arm_are_refused_by_joint_and_pose(q):
    q[:, 5] += np.deg2rad(100.0)
    with pytest.raises(ReadingsOutOfRangeError, match=r"joint 6 reads .* deg in pose") as error:
        found_in(q)
    assert error.value.code == "RANGE_6"


def test_an_encoder_off_by_a_turn_is_named_and_an_rvdt_is_not(q):
    q[:, 1] -= 2.0 * np.pi
    (result,) = found_in(q)
    assert (result.joint, result.fault) == (2, ReadingFault.WHOLE_TURN)
    q[:, 1] += 2.0 * np.pi
    q[:, 6] -= 2.0 * np.pi
    with pytest.raises(ReadingsOutOfRangeError, match="joint 7"):
        found_in(q)


def test_an_rvdt_at_its_end_in_several_poses_is_saturated(q):
    middle = ARM.joints[5].middle_rad
    q[[3, 9], 5] = middle + np.deg2rad(60.0) - LSB_RAD
    assert found_in(q) == ()
    q[[3, 9, 20], 5] = middle + np.deg2rad(60.0) - LSB_RAD
    (result,) = found_in(q)
    assert (result.joint, result.fault, result.poses) == (6, ReadingFault.SATURATED, (3, 9, 20))


def test_unused_readings_are_not_tested(q):
    q[:, 5] += np.deg2rad(100.0)
    assert found_in(q, unsensed_joints=(6,)) == ()


def test_wrong_sign_and_exchanged_columns_are_named_if_ranges_show_them(q):
    turned = q.copy()
    turned[:, 1] *= -1.0
    with pytest.raises(ReadingsOutOfRangeError, match="sign of joint 2"):
        found_in(turned)
    exchanged = q[:, [0, 1, 3, 2, 4, 5, 6]]
    with pytest.raises(ReadingsOutOfRangeError, match="joints 3 and 4 are exchanged") as error:
        found_in(exchanged)
    assert error.value.code == "EXCHANGED_3_4"
    listed = [m.code for m in mistakes(ARM, exchanged) if mostly_in_range(ARM, m.q_rad)]
    assert listed == ["EXCHANGED_3_4"]
