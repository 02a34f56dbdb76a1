"""Which poses are new to a calibration: by readings, and for an instrument by its measurements as well."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.verification import NoTestError, require_new, verify_new_poses
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from tests.oracles.open_arm import write_measured_poses

SIGMA_M = 5e-5


@pytest.fixture(scope="module")
def measured(tmp_path_factory):
    path = write_measured_poses(tmp_path_factory.mktemp("open") / "open.csv", sigma_m=SIGMA_M)
    return load_poses(str(path), joint_count=7).poses


def remeasured(poses, rows=slice(None)):
    """The same readings with endpoints measured again."""
    noise = np.random.default_rng(3).normal(size=poses.endpoint.shape)
    endpoint = poses.endpoint.copy()
    endpoint[rows] += SIGMA_M * noise[rows]
    return replace(poses, endpoint=endpoint)


def test_remeasured_pose_is_new_and_verifies(measured):
    arm, tracker = load_arm("sarcos_dextrous"), load_fixture("tracker").fixture
    solution = calibrate(arm, tracker, measured, drop=True)
    result = verify_new_poses(arm, tracker, solution, made_from=measured, new=remeasured(measured))
    assert result.holds
    assert result.poses == len(measured)
    moved = remeasured(measured)
    moved = replace(moved, endpoint=moved.endpoint + np.array([0.0, 0.0, 3e-3]))
    assert not verify_new_poses(arm, tracker, solution, made_from=measured, new=moved).holds


def test_rounded_endpoints_are_not_new_poses(measured):
    tracker = load_fixture("tracker").fixture
    require_new(remeasured(measured), measured, tracker)
    rounded = replace(
        measured,
        q_rad=np.deg2rad(np.rad2deg(measured.q_rad).round(3)),
        endpoint=measured.endpoint.round(6),
    )
    with pytest.raises(NoTestError, match="these are poses that the calibration was made from"):
        require_new(rounded, measured, tracker)
    with pytest.raises(NoTestError, match=r"2 of the 40 poses \(1, 2\)"):
        require_new(remeasured(measured, slice(2, None)), measured, tracker)
    # Without measurements only the readings are compared.
    with pytest.raises(NoTestError, match="these are poses"):
        require_new(replace(measured, endpoint=None), measured, tracker)


def test_poses_in_a_hinge_are_compared_by_readings(measured):
    with pytest.raises(NoTestError, match="these are poses"):
        require_new(remeasured(measured), measured, load_fixture("hinge").fixture)


def test_full_poses_and_points_are_compared_by_points(measured):
    turned = np.hstack((measured.endpoint, np.zeros((len(measured), 3))))
    full = replace(measured, endpoint=turned)
    tracker = load_fixture("tracker").fixture
    with pytest.raises(NoTestError, match="these are poses"):
        require_new(measured, full, tracker)
    require_new(remeasured(measured), full, tracker)


def test_rounded_readings_are_not_new_poses(measured):
    own = replace(measured, endpoint=None)
    hinge = load_fixture("hinge").fixture
    rounded = replace(own, q_rad=np.deg2rad(np.rad2deg(own.q_rad).round(2)))
    for new, made_from in ((rounded, own), (own, rounded)):
        with pytest.raises(NoTestError, match="these are poses that the calibration was made from"):
            require_new(new, made_from, hinge)
    require_new(replace(rounded, q_rad=rounded.q_rad + np.deg2rad(0.02)), own, hinge)
    # With more decimals, poses that differ in the third are different.
    require_new(replace(own, q_rad=own.q_rad + np.deg2rad(0.004)), own, hinge)
