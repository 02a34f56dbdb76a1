"""An encoder's spread within a pose is looked at: an arm that moved while it was sampled is said to have."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.findings import excluded_poses
from solver.diagnostics.range_checks import range_findings
from tests.benchmarks.shop_floor_outcome import ACCEPTED, WARNED, outcome
from tests.oracles.as_shipped import ARM, poses_of
from tests.oracles.shop_floor import session


@pytest.mark.parametrize("poses", [slice(None), slice(4, 6)])
def test_an_encoder_that_moved_while_it_was_read_is_named(poses):
    """1 deg in all poses, and in two: ACCEPTED without a word before."""
    found = session(61)
    spread = found.spread.copy()
    spread[poses, 2] = np.deg2rad(1.0)
    said = outcome(replace(found, spread=spread))
    assert said.verdict == WARNED
    assert said.causes == ("UNSTEADY_3",)
    assert "UNSTEADY_3" in said.warnings
    assert "spread by up to 1.000 deg within pose" in said.said


def test_a_spread_as_of_its_sensor_is_nothing():
    assert outcome(session(61)).verdict == ACCEPTED


@pytest.mark.parametrize(
    ("rows", "code"), [(slice(7, 8), "RANGE_RADIANS"), (slice(20, 40), "RADIANS_POSES")]
)
def test_rows_in_radians_are_named_as_such(rows, code):
    found = session(21)
    read = found.readings.copy()
    read[rows] = np.deg2rad(read[rows])
    said = outcome(replace(found, readings=read))
    assert said.causes == (code,), said.said
    assert not {"FLIPPED_BRANCH", "RANGE"} & set(said.warnings)


def test_each_pose_that_was_left_out_says_why():
    poses = poses_of(session(21))
    q = np.array(poses.q_rad)
    q[3, 1:4] -= 3.0
    wrong = replace(poses, q_rad=q)
    range_pose, flipped = excluded_poses((3, 5), range_findings(ARM, wrong), ARM, wrong)
    assert (range_pose.code, flipped.code) == ("RANGE_POSE", "FLIPPED_BRANCH")
    assert range_pose.joints == (2, 3, 4)
    assert flipped.poses == (poses.label[5],)
    (both,) = excluded_poses((4, 5), (), ARM, poses)
    assert both.poses == (poses.label[4], poses.label[5])
