"""What a calibration names, warns of and refuses."""

from dataclasses import replace

import numpy as np
import pytest
import sarcal

from fixtures.base import Compliance
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from operator_app.calibration.experiment import FixtureRefusedError
from operator_app.config.poses_file import load_poses
from operator_app.messages.finding import Finding, FindingKind
from solver.chain.sensors import Encoder, NoSensor
from solver.closing import close_loops
from solver.diagnostics.range_checks import ReadingsOutOfRangeError
from tests.oracles.as_shipped import ARM, HINGE, displaced, poses_of
from tests.oracles.shop_floor import session


@pytest.fixture
def poses(reference_data):
    return load_poses(reference_data / "hinge" / "hinge_quantised.csv").poses


def codes(solution):
    return [n.code for n in solution.warnings]


def test_outlier_is_named_and_still_used(poses):
    sound = calibrate(ARM, HINGE, poses)
    assert (sound.outliers, sound.causes) == ((), ())
    solution = calibrate(ARM, HINGE, displaced(poses, (16, 2), 0.2))
    assert solution.outliers == (poses.label[16],)
    assert solution.poses == len(poses)
    assert "OUTLIER" in codes(solution)


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
        solution = calibrate(ARM, HINGE, replace(poses, q_rad=q), estimator="paper", search=search)
        assert solution.dropped_flipped == (5, 30)
        assert "FLIPPED_BRANCH" in codes(solution)
        # The estimate is that of the other poses.
        np.testing.assert_allclose(solution.estimate.x, clean.estimate.x, atol=1e-3)
    # Unsensed joints still tell the branches apart.
    for unsensed in ((6, 7), (1, 5)):
        solution = calibrate(ARM, HINGE, replace(poses, q_rad=q), unsensed_joints=unsensed)
        assert solution.dropped_flipped == (5, 30)
        assert solution.estimate.converged


def test_nearly_parallel_axes_are_refused(poses):
    tilted = replace(HINGE, alpha_n_rad=np.deg2rad(0.5))
    with pytest.raises(FixtureRefusedError, match="joint 7"):
        calibrate(ARM, tilted, poses)


TWISTS = {f"alpha_{j}" for j in range(1, 7)}
LENGTHS = {f"a_{j}" for j in range(1, 7)} | {f"s_{j}" for j in range(2, 7)}


def stated_exact():
    """The same arm and hinge with no stated error."""

    def exact(joint):
        sensor = joint.sensor
        if isinstance(sensor, Encoder):
            sensor = replace(sensor, accuracy_rad=0.0)
        return replace(joint, backlash_rad=0.0, sag_rad=0.0, sensor=sensor)

    joints = tuple(map(exact, ARM.joints))
    arm = replace(ARM.with_length_tolerance(0.0), joints=joints, twist_tolerance_rad=np.zeros(7))
    return arm, replace(HINGE, compliance=Compliance())


def test_stated_errors_are_estimated_and_in_the_budget(poses):
    exact = calibrate(*stated_exact(), poses)
    stated = calibrate(ARM, HINGE, poses)
    assert exact.tolerated == ()
    assert set(stated.tolerated) == LENGTHS | TWISTS
    names = [p.name for p in stated.identified.parameters]
    assert names == [p.name for p in exact.estimate.parameters]
    # An uncertain table widens all other sigmas, except those of RVDTs, whose learned errors are smaller.
    sd = stated.identified.standard_deviation
    encoders = np.array([name not in {"theta_off_6", "theta_off_7"} for name in names])
    assert np.all((sd >= exact.estimate.standard_deviation)[encoders])
    assert "instrument" not in stated.components.budget
    total = sum(stated.components.budget.values())
    assert total == pytest.approx(np.diagonal(stated.estimate.covariance), rel=1e-4)
    repeatability = np.sqrt(np.diagonal(stated.components.repeatability))
    assert np.all(repeatability[:14] < sd)


def test_length_tolerance_option_replaces_that_of_the_arm_file(poses):
    exact_arm, exact_hinge = stated_exact()
    tolerant = calibrate(exact_arm, exact_hinge, poses, length_tolerance_m=1.5e-3)
    assert set(tolerant.tolerated) == LENGTHS
    for name, value in {"s_3": 0.355, "s_5": 0.320}.items():
        error = abs(tolerant.estimate.value(name) - value)
        assert error < 4.0 * tolerant.estimate.sd_by_name[name] < 8e-3


@pytest.mark.parametrize("noise_deg", [0.0, 5e-4], ids=["pasted", "logged at rest"])
def test_repeated_rows_do_not_narrow_sigmas(poses, noise_deg):
    # Pasted behind one another; or four rows of each pose, of which each has noise of its own.
    tiled = np.arange(4 * len(poses)) % len(poses)
    order = np.sort(tiled) if noise_deg else tiled
    noise = np.deg2rad(noise_deg) * np.random.default_rng(3).normal(size=(len(order), 7))
    repeated = sarcal.poses_of(q_rad=poses.q_rad[order] + noise)._set
    once, four_times = calibrate(ARM, HINGE, poses), calibrate(ARM, HINGE, repeated)
    assert four_times.poses == len(four_times.estimate.residual) == 4 * len(poses)
    np.testing.assert_allclose(
        four_times.estimate.standard_deviation, once.estimate.standard_deviation, rtol=0.1
    )
    printed = [s.estimate.sigmas.position_m.as_printed for s in (once, four_times)]
    assert printed[1] == pytest.approx(printed[0] / 2.0, rel=0.1)
    (notice,) = (w for w in four_times.warnings if w.code == "REPEATED_ROWS")
    assert f"count as {len(poses)} poses" in notice.text
    dof = [
        sum(part.dof for part in check(solution, ARM, HINGE, rows).held_out.parts)
        for solution, rows in ((once, poses), (four_times, repeated))
    ]
    assert dof[0] == dof[1]


def test_out_of_range_readings_name_joint_pose_and_unit(poses):
    first, *others = ARM.joints
    narrow = replace(ARM, joints=(replace(first, upper_rad=np.deg2rad(85.0)), *others))
    worst = int(np.argmax(poses.q_rad[:, 0]))
    (notice,) = (w for w in calibrate(narrow, HINGE, poses).warnings if w.code == "RANGE")
    assert notice.joint == 1
    assert notice.poses[0] == poses.label[worst]
    assert "-35.0 to 85.0 deg" in notice.text
    with pytest.raises(ReadingsOutOfRangeError, match="taken as radians") as error:
        calibrate(ARM, HINGE, replace(poses, q_rad=np.deg2rad(poses.q_rad)), search=True)
    assert error.value.code == "RADIANS"


def test_offset_far_beyond_its_tolerance_is_mentioned(poses):
    assert "OFFSET_TOLERANCE" not in codes(calibrate(ARM, HINGE, poses))
    sigma_rad = np.deg2rad(0.3)
    stated = calibrate(replace(ARM, offset_tolerance_rad=sigma_rad), HINGE, poses)
    changes = {j: stated.estimate.value(f"theta_off_{j}") for j in range(1, 8)}
    far = {j for j, x in changes.items() if abs(x - ARM.table.theta_off_rad[j - 1]) > 5 * sigma_rad}
    assert far == {w.joint for w in stated.warnings if w.code == "OFFSET_TOLERANCE"} != set()


def test_text_names_five_of_many_outliers_and_counts_the_rest():
    notice = Finding(FindingKind.OUTLIERS_COUNT, poses=tuple(str(k) for k in range(1, 513)))
    assert "poses 1, 2, 3, 4, 5 and 507 more" in notice.text


def test_the_number_of_a_joint_without_a_sensor_has_no_effect():
    joints = (*ARM.joints[:6], replace(ARM.joints[6], sensor=NoSensor()))
    free = tuple(entry for entry in ARM.free if entry.name != "theta_off_7")
    arm, poses = replace(ARM, joints=joints, free=free), poses_of(session(1))
    solutions = []
    for angle_rad in (0.0, 1.6):
        q = poses.q_rad.copy()
        q[:, 6] = angle_rad
        solutions.append(calibrate(arm, HINGE, replace(poses, q_rad=q)))
    assert all(s.accepted for s in solutions)
    np.testing.assert_array_equal(*(s.estimate.x for s in solutions))
