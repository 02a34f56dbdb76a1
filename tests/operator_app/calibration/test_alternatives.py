"""Mistakes in an arm file or among the rows of a poses file are named; poses of another arm are refused."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.alternatives import poses_in_radians
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.experiment import Experiment
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.messages.finding import FindingKind
from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.as_shipped import ARM, BALL, panda_poses
from tests.oracles.open_arm import write_measured_poses
from tests.oracles.shop_floor import session

EXCHANGED, ZEROS = ARM.table.s_m[[0, 1, 4, 3, 2, 5, 6]], np.deg2rad(ARM.table.theta_off_rad)


@pytest.mark.parametrize(
    ("seed", "columns", "code"),
    [
        (61, {"s_m": EXCHANGED}, "EXCHANGED_s_3_s_5"),
        pytest.param(64, {"s_m": EXCHANGED}, "EXCHANGED_s_3_s_5", marks=pytest.mark.campaign),
        pytest.param(62, {"theta_off_rad": ZEROS}, "RADIANS_OFFSETS", marks=pytest.mark.campaign),
        (61, {"theta_off_rad": ARM.table.theta_off_rad + np.pi * np.eye(7)[3]}, "ZERO_JOINT_4"),
    ],
)
def test_mistake_in_the_arm_file_is_named(seed, columns, code):
    result = outcome(session(seed), arm=replace(ARM, table=replace(ARM.table, **columns)))
    assert result.causes[0] == code, result.text


def test_panda_poses_do_not_fit_an_iiwa_and_blame_no_joint():
    vague = replace(load_arm("kuka_iiwa7"), offset_tolerance_rad=np.deg2rad(5.0))
    solution = calibrate(vague, BALL, panda_poses(1, 2))
    assert solution.verdict is Verdict.NOT_ACCEPTED
    (cause,) = [c for c in solution.causes if c.blocking]
    assert (cause.kind, cause.probability) == (FindingKind.POSES_DO_NOT_FIT, 1.0)


@pytest.mark.parametrize(
    ("sockets", "misread", "code"),
    [
        ((1, 2), lambda q: np.where(np.arange(7) == 3, q[0], q), "FROZEN_JOINT_4"),
        ((1,), np.deg2rad, "RADIANS"),
        # This socket is 1.2 m from the place that the fixture file states.
        ((1,), lambda q: q * (1.0 - 2.0 * np.eye(7)[4]), "SIGN_JOINT_5"),
    ],
)
def test_misread_poses_are_named(sockets, misread, code):
    arm, poses = load_arm("franka_panda"), panda_poses(*sockets)
    poses = replace(poses, q_rad=misread(poses.q_rad))
    solution = calibrate(arm, BALL, poses, drop=True)
    assert solution.verdict is Verdict.NOT_ACCEPTED
    assert solution.causes[0].code == code
    # Joint 4 is out of its range as read: radians are named even if degrees fit almost as well.
    named = poses_in_radians(Experiment(arm=arm, fixture=BALL, poses=poses), 3.0)
    assert ("RADIANS" in {c.code for c in named}) is (code == "RADIANS")


@pytest.mark.parametrize(("rows", "where"), [(1, "further up"), (-1, "further down")])
def test_endpoints_in_other_rows_are_named(tmp_path, rows, where):
    poses = load_poses(write_measured_poses(tmp_path / "open.csv")).poses
    shifted = replace(poses, endpoint=np.roll(poses.endpoint, -rows, axis=0))
    kept = np.arange(len(poses))[:-1] if rows > 0 else np.arange(len(poses))[1:]
    solution = calibrate(ARM, load_fixture("tracker").fixture, shifted.at_poses(kept), drop=True)
    assert solution.causes[0].kind is FindingKind.ENDPOINTS_SHIFTED
    assert where in solution.causes[0].text


@pytest.mark.parametrize("rows", [(2,), (10, 25)], ids=["200 mm off", "exchanged"])
def test_gross_outliers_are_named(tmp_path, rows):
    poses = load_poses(write_measured_poses(tmp_path / "open.csv")).poses
    endpoint = poses.endpoint.copy()
    if len(rows) == 1:
        endpoint[rows] += [0.1, -0.1, 0.14]
    endpoint[list(rows)] = endpoint[list(rows)[::-1]]
    tracker, named = load_fixture("tracker").fixture, {poses.label[k] for k in rows}
    solution = calibrate(ARM, tracker, replace(poses, endpoint=endpoint), drop=True)
    assert solution.causes[0].kind is FindingKind.OUTLIERS
    assert {*solution.causes[0].poses} == {*solution.outliers} == named


def test_sign_is_named_beside_the_zero_that_explains_the_same_points(tmp_path):
    poses = load_poses(write_measured_poses(tmp_path / "open.csv")).poses
    reversed_sign = replace(poses, q_rad=poses.q_rad * [-1, 1, 1, 1, 1, 1, 1])
    solution = calibrate(ARM, load_fixture("tracker").fixture, reversed_sign, drop=True)
    assert {"SIGN_JOINT_1", "ZERO_JOINT_2"} <= {c.code for c in solution.causes if c.blocking}
