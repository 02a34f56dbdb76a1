"""A judged calibration: what it names, what it warns of, what it refuses."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.base import Compliance
from fixtures.setup_checks import setup_checks
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.closed_loops import FixtureRefusedError
from operator_app.calibration.notices import outliers_still_used
from operator_app.config.poses_file import load_poses
from solver.chain.poses import PoseSet
from solver.chain.sensors import Encoder
from solver.closing import close_loops
from solver.diagnostics.range_checks import ReadingsOutOfRangeError
from tests.oracles.as_shipped import ARM, HINGE


@pytest.fixture
def poses(reference_data):
    return load_poses(reference_data / "hinge" / "hinge_quantised.csv").poses


def codes(solution):
    return [n.code for n in solution.warnings]


def test_outlier_is_named_and_still_used(poses):
    assert calibrate(ARM, HINGE, poses).outliers == ()
    q = np.array(poses.q_rad)
    q[16, 2] += np.deg2rad(0.2)
    found = calibrate(ARM, HINGE, replace(poses, q_rad=q))
    assert found.outliers == (poses.label[16],)
    assert found.poses == len(poses)
    assert "OUTLIER" in codes(found)


@pytest.mark.campaign
def test_flipped_poses_are_named_and_left_out(poses):
    clean = calibrate(ARM, HINGE, poses, estimator="paper")
    upside_down = clean.estimate.x.copy()
    names = [p.name for p in clean.estimate.parameters]
    upside_down[names.index("alpha_7")] += np.pi
    q = np.array(poses.q_rad)
    flipped = close_loops(clean.model, upside_down, q[[5, 30]], max_iterations=200)
    assert flipped.closed.all()
    q[[5, 30]] = flipped.q
    for search in (False, True):
        found = calibrate(ARM, HINGE, replace(poses, q_rad=q), estimator="paper", search=search)
        assert found.dropped_flipped == (5, 30)
        assert "FLIPPED_BRANCH" in codes(found)
        # What is left is the clean set less two poses.
        np.testing.assert_allclose(found.estimate.x, clean.estimate.x, atol=1e-3)
    # Readings that are not used still tell up from down.
    for unsensed in ((6, 7), (1, 5)):
        found = calibrate(ARM, HINGE, replace(poses, q_rad=q), unsensed_joints=unsensed)
        assert found.dropped_flipped == (5, 30)
        assert found.estimate.converged


@pytest.mark.parametrize(("degrees", "verdict"), [(5.0, "warned"), (0.5, "refused")])
def test_nearly_parallel_axes_warn_or_refuse(poses, degrees, verdict):
    tilted = replace(HINGE, alpha_n_rad=np.deg2rad(degrees))
    checks = setup_checks(tilted, ARM, ARM.home_rad)
    (check,) = (c for c in checks if c.code == "AXIS_ANGLE_7")
    assert check.remedy
    if verdict == "refused":
        with pytest.raises(FixtureRefusedError, match="joint 7"):
            calibrate(ARM, tilted, poses)
    else:
        assert check.severity.value == "warning"


TWISTS = {f"alpha_{j}" for j in range(1, 7)}
LENGTHS = {f"a_{j}" for j in range(1, 7)} | {f"s_{j}" for j in range(2, 7)}


def stated_exact():
    """The same arm and hinge, whose files state that nothing is off."""
    joints = tuple(
        replace(
            joint,
            backlash_rad=0.0,
            sag_rad=0.0,
            sensor=replace(joint.sensor, accuracy_rad=0.0)
            if isinstance(joint.sensor, Encoder)
            else joint.sensor,
        )
        for joint in ARM.joints
    )
    return replace(ARM, joints=joints, tolerances=()), replace(HINGE, compliance=Compliance())


def test_stated_errors_are_estimated_and_in_the_budget(poses):
    exact = calibrate(*stated_exact(), poses)
    found = calibrate(ARM, HINGE, poses)
    assert exact.tolerated == ()
    assert set(found.tolerated) == LENGTHS | TWISTS
    names = [p.name for p in found.identified.parameters]
    assert names == [p.name for p in exact.estimate.parameters]
    # Not knowing the table exactly can only make the rest less certain. Joints 6 and 7 have RVDTs, whose errors are
    # taken as smaller beside other errors that turn out smaller than stated.
    sd = found.identified.standard_deviation
    encoders = np.array([name not in {"theta_off_6", "theta_off_7"} for name in names])
    assert np.all((sd >= exact.estimate.standard_deviation)[encoders])
    assert "instrument" not in found.components.budget
    total = sum(found.components.budget.values())
    assert total == pytest.approx(np.diagonal(found.estimate.covariance), rel=1e-4)
    # By noise alone: what the same poses taken again would give.
    repeatability = np.sqrt(np.diagonal(found.components.repeatability))
    assert np.all(repeatability[:14] < sd)


def test_length_tolerance_option_replaces_that_of_the_arm_file(poses):
    exact_arm, exact_hinge = stated_exact()
    tolerant = calibrate(exact_arm, exact_hinge, poses, length_tolerance_m=1.5e-3)
    assert set(tolerant.tolerated) == LENGTHS
    for name, value in {"s_3": 0.355, "s_5": 0.320}.items():
        error = abs(tolerant.estimate.value(name) - value)
        assert error < 4.0 * tolerant.estimate.sd_by_name[name] < 8e-3


def test_duplicated_poses_do_not_narrow_sigmas(poses):
    m = len(poses)
    pasted = PoseSet(
        placement=np.tile(poses.placement, 4),
        label=tuple(f"{label}_{copy}" for copy in range(4) for label in poses.label),
        q_rad=np.tile(poses.q_rad, (4, 1)),
    )
    one, four = calibrate(ARM, HINGE, poses), calibrate(ARM, HINGE, pasted)
    assert four.poses == 4 * m
    assert len(four.estimate.residual) == 4 * m
    np.testing.assert_allclose(
        four.estimate.standard_deviation, one.estimate.standard_deviation, rtol=0.1
    )


def test_out_of_range_readings_name_joint_pose_and_unit(poses):
    narrow = replace(
        ARM,
        joints=tuple(
            replace(joint, upper_rad=np.deg2rad(85.0)) if j == 1 else joint
            for j, joint in enumerate(ARM.joints, 1)
        ),
    )
    worst = int(np.argmax(poses.q_rad[:, 0]))
    (notice,) = (w for w in calibrate(narrow, HINGE, poses).warnings if w.code == "RANGE")
    assert notice.joint == 1
    assert notice.poses[0] == poses.label[worst]
    assert "-35.0 to 85.0 deg" in notice.text
    with pytest.raises(ReadingsOutOfRangeError, match="taken as radians"):
        calibrate(ARM, HINGE, replace(poses, q_rad=np.deg2rad(poses.q_rad)), search=True)


def test_text_names_five_of_many_outliers_and_counts_the_rest():
    """A log of thousands of rows was a list of numbers over hundreds of lines; JSON has them all."""
    (notice,) = outliers_still_used(tuple(str(k) for k in range(1, 513)))
    assert "poses 1, 2, 3, 4, 5 and 507 more" in notice.text
