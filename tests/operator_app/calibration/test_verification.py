"""Later poses against a calibration: which are new, whether it holds, and what shifted where it does not."""

from dataclasses import replace

import numpy as np
import pytest
import sarcal
from scipy.spatial.transform import Rotation

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.calibrated_arm import calibrated_arm
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.new_poses import NoTestError, require_new
from operator_app.calibration.prediction import FIXTURE, concatenated_poses
from operator_app.calibration.verification import Fixed, predict, verify_new_poses, verify_poses
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from tests.oracles.as_shipped import ARM, BALL, HINGE, PANDA, SEED, displaced, panda_poses, poses_of
from tests.oracles.open_arm import write_measured_poses
from tests.oracles.shop_floor import Specimen, session, walked

SIGMA_M = 5e-5
TRACKER = load_fixture("tracker").fixture


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
    solution = calibrate(ARM, TRACKER, measured, drop=True)

    def verified(new):
        return verify_new_poses(ARM, TRACKER, solution, made_from=measured, new=new)

    again = remeasured(measured)
    assert (verified(again).holds, verified(again).poses) == (True, len(measured))
    assert not verified(replace(again, endpoint=np.add(again.endpoint, [0, 0, 3e-3]))).holds


def seen_from_another_station(poses, number=2):
    """The same poses as placement `number`, measured by an instrument turned by 170 deg and moved by 4 m."""
    turned = Rotation.from_rotvec(np.deg2rad(170.0) * np.array([0.48, 0.6, 0.64]))
    endpoint = poses.endpoint @ turned.as_matrix().T + (1.0, -4.0, 0.5)
    return replace(poses, endpoint=endpoint, placement=np.full(len(poses), number))


def test_poses_measured_from_another_station_are_verified(measured):
    made_from, later = measured.at_poses(np.arange(25)), measured.at_poses(np.arange(25, 40))
    solution = calibrate(ARM, TRACKER, made_from, drop=True)

    def verified(new):
        return verify_new_poses(ARM, TRACKER, solution, made_from=made_from, new=new)

    here, moved = verified(later), verified(seen_from_another_station(later))
    assert (here.holds, moved.holds) == (True, True)
    assert moved.stated.dof == here.stated.dof - 6
    shifted = verified(replace(later, endpoint=later.endpoint + 0.01))
    assert "another placement number" in shifted.why
    two = replace(measured, placement=np.arange(40) % 2 + 1)
    stations = calibrate(ARM, TRACKER, two, drop=True)
    assert "SAME_PLACEMENT" not in {w.code for w in stations.warnings}
    assert moved.verification.sigmas.position_m.rms < 5.0 * SIGMA_M
    # Placement 1 may be the default of a file that states no placement: the instrument counts as unmoved.
    assert not verified(seen_from_another_station(later, 1)).holds
    wrong = replace(later, q_rad=later.q_rad + np.deg2rad([0, 0, 0, 0.3, 0, 0, 0]))
    slipped = verified(seen_from_another_station(wrong))
    assert (slipped.holds, slipped.shift.subject) == (False, "4")
    rows = np.minimum(np.arange(15), 2)
    few = replace(later, q_rad=later.q_rad[rows], endpoint=later.endpoint[rows])
    with pytest.raises(NoTestError, match="at least 4 different poses"):
        verified(seen_from_another_station(few))
    known, new = replace(TRACKER, base_known=True), seen_from_another_station(later)
    with pytest.raises(NoTestError, match="placement 2, which was not calibrated"):
        verify_new_poses(ARM, known, solution, made_from=made_from, new=new)


def test_rounded_endpoints_are_not_new_poses(measured):
    require_new(remeasured(measured), measured, TRACKER)
    rounded = replace(
        measured,
        q_rad=np.deg2rad(np.rad2deg(measured.q_rad).round(3)),
        endpoint=measured.endpoint.round(6),
    )
    for new, fixture, message in (
        (rounded, TRACKER, "these are poses that the calibration was made from"),
        (remeasured(measured, slice(2, None)), TRACKER, r"2 of the 40 poses \(1, 2\)"),
        # Without measurements, and in a hinge, only the readings are compared.
        (replace(measured, endpoint=None), TRACKER, "these are poses"),
        (remeasured(measured), HINGE, "these are poses"),
    ):
        with pytest.raises(NoTestError, match=message):
            require_new(new, measured, fixture)


def test_full_poses_and_points_are_compared_by_points(measured):
    turned = np.hstack((measured.endpoint, np.zeros((len(measured), 3))))
    full = replace(measured, endpoint=turned)
    with pytest.raises(NoTestError, match="these are poses"):
        require_new(measured, full, TRACKER)
    require_new(remeasured(measured), full, TRACKER)


def test_rounded_readings_are_not_new_poses(measured):
    own = replace(measured, endpoint=None)
    rounded = replace(own, q_rad=np.deg2rad(np.rad2deg(own.q_rad).round(2)))
    for new, made_from in ((rounded, own), (own, rounded)):
        with pytest.raises(NoTestError, match="these are poses that the calibration was made from"):
            require_new(new, made_from, HINGE)
    require_new(displaced(rounded, ..., 0.02), own, HINGE)
    # With more decimals, poses that differ in the third are different.
    require_new(displaced(own, ..., 0.004), own, HINGE)


def slipped_session(poses, shift_m):
    """Poses of the sound session's arm, taken later in a fixture whose ground half has moved."""
    specimen = Specimen.drawn(SEED, session(SEED).specimen.sizes)
    slip = (0, np.concatenate((np.zeros(3), shift_m)), np.zeros(6))
    return walked(specimen, poses, walk=1, slipped=slip)


def test_fixture_slip_fails_verification_whatever_noise_was_estimated(sound):
    fixed = Fixed(sound.estimate, sound.model.unsensed_joints, sound.components)

    def misfit(poses, fixed=fixed):
        """chi2/dof relative to its usual maximum."""
        chi2 = predict(Experiment(arm=ARM, fixture=HINGE, poses=poses), fixed).chi2
        return chi2.per_dof / chi2.high

    assert misfit(poses_of(session(SEED, walk=1, poses=12))) < 1.0
    moved = poses_of(slipped_session(12, (4e-3, 2e-3, 2e-3)))
    assert misfit(moved) > 1.0
    noise = replace(sound.components.noise, fixture_variance=np.full(6, 1e-2))
    rvdts = tuple(replace(c, sd=1.0) for c in sound.components.components)
    noisy = replace(sound.components, noise=noise, components=rvdts)
    assert misfit(moved, fixed._replace(components=noisy)) > 1.0


@pytest.fixture(scope="module")
def retaken(sound):
    """A sound calibration with its poses, and poses of the same arm taken later."""
    return (sound, poses_of(session(SEED))), session(SEED, walk=1, poses=20)


def verification_of(retaken, where, error_deg):
    """The verification of the later poses with an error added to some readings."""
    calibration, later = retaken
    return verify_poses(ARM, HINGE, poses_of(displaced(later, where, error_deg)), *calibration)


@pytest.mark.parametrize(
    ("where", "deg", "odd_poses"), [(..., 0.0, ()), ((4, 1), 0.3, (4,))], ids=["sound", "outlier"]
)
def test_later_poses_hold_and_a_single_outlier_is_named(retaken, where, deg, odd_poses):
    result = verification_of(retaken, where, deg)
    assert (result.holds, result.shift, result.odd_poses) == (not odd_poses, None, odd_poses)


def test_rows_that_repeat_a_new_pose_count_once(retaken):
    once, later = (
        verification_of(retaken, (4, 1), 0.3),
        poses_of(displaced(retaken[1], (4, 1), 0.3)),
    )
    threefold = sarcal.poses_of(q_rad=np.repeat(later.q_rad, 3, axis=0))._set
    result = verify_poses(ARM, HINGE, threefold, *retaken[0])
    assert (result.odd_poses, result.poses, result.stated.dof) == ((12,), 20, once.stated.dof)


def test_an_outlier_is_compared_with_the_variances_of_the_accepted_calibration(retaken):
    (solution, made_from), later = retaken
    adjudication = replace(solution.adjudication, stated_chi2_per_dof=1e3)
    calibration = replace(solution, adjudication=adjudication), made_from
    assert verification_of((calibration, later), (4, 1), 0.3).odd_poses == ()


@pytest.mark.parametrize(("joint", "deg"), [(2, 0.2), (4, -0.1), (6, 0.5), (7, 0.5)])
def test_common_joint_shift_is_named_with_its_size(retaken, joint, deg):
    result = verification_of(retaken, np.s_[:, joint - 1], deg)
    assert not result.holds
    shift = result.shift
    assert shift.subject == str(joint)
    assert abs(shift.size - np.deg2rad(deg)) < 4.0 * shift.sigma
    assert result.odd_poses == ()


def test_other_placement_of_a_hinge_or_other_unit_is_refused(retaken):
    (solution, made_from), later = retaken
    new = poses_of(later)
    assert verify_new_poses(ARM, HINGE, solution, made_from=made_from, new=new).holds
    other = replace(new, placement=np.full(len(new), 2))
    with pytest.raises(NoTestError, match="placement 2, which was not calibrated"):
        verify_new_poses(ARM, HINGE, solution, made_from=made_from, new=other)
    two = replace(new, placement=np.arange(len(new)) % 2 + 1)
    with pytest.raises(ValueError, match="placement 2 was not calibrated"):
        verify_poses(ARM, HINGE, two, solution, made_from)
    radians = replace(new, q_rad=np.deg2rad(new.q_rad))
    with pytest.raises(NoTestError, match="in range if taken as radians"):
        verify_new_poses(ARM, HINGE, solution, made_from=made_from, new=radians)


def test_single_deviating_pose_has_no_others_that_fit(retaken):
    one = retaken[0], session(SEED, walk=1, poses=1)
    result = verification_of(one, (0, 1), 3.0)
    assert (result.holds, result.others_fit) == (False, False)


def test_moved_fixture_is_named(retaken):
    moved = slipped_session(20, (2e-3, 1e-3, 1e-3))
    result = verification_of((retaken[0], moved), ..., 0.0)
    assert not result.holds
    assert result.shift.subject == FIXTURE


@pytest.fixture(scope="module")
def two_sockets():
    """A calibration from real poses of a Panda in two sockets, and the poses."""
    poses = panda_poses(1, 2)
    return calibrate(PANDA, BALL, poses), poses


@pytest.mark.parametrize("count", [5, 30])
def test_new_socket_is_verified_at_any_place(two_sockets, count):
    solution, made_from = two_sockets
    new = panda_poses(3).at_poses(np.arange(count))
    x, y, z = BALL.ground_m
    results = [
        verify_new_poses(PANDA, fixture, solution, made_from=made_from, new=new)
        for fixture in (BALL, replace(BALL, ground_m=(x + 0.02, y - 0.01, z)))
    ]
    for result in results:
        assert result.holds
        assert result.stated.dof == 3 * count - 3
        assert result.stated.per_dof < 1.0
    assert results[0].stated.per_dof == pytest.approx(results[1].stated.per_dof, rel=1e-3)


@pytest.mark.parametrize("numbers", [(3,), (3, 4, 5)])
@pytest.mark.parametrize("corrected", [False, True])
def test_closure_in_a_new_socket_is_the_scatter_about_the_socket(two_sockets, corrected, numbers):
    """The calibrated entries, the best table and the corrected readings each place the ball differently."""
    solution, made_from = two_sockets
    new = panda_poses(*numbers)
    result = verify_new_poses(PANDA, BALL, solution, made_from=made_from, new=new)
    tool = calibrated_arm(solution, PANDA).T_base(new.q_rad, corrected=corrected)[:, :3, 3]
    means = {k: tool[new.placement == k].mean(0) for k in numbers}
    scatter = tool - [means[k] for k in new.placement]
    found = result.in_use.corrected if corrected else result.in_use.best_table
    assert found.position_m.rms == pytest.approx(np.sqrt(np.mean(scatter**2)), rel=0.02)
    # The arm file's entries are compared in a socket of their own place too.
    assert found.position_m.rms < result.nominal.position_m.rms < 10e-3


@pytest.mark.parametrize("numbers", [(3,), (3, 4)])
def test_one_pose_per_new_socket_is_refused(two_sockets, numbers):
    solution, made_from = two_sockets
    first, *others = [panda_poses(number).at_poses(np.arange(2)) for number in numbers]
    first, *others = [replace(p, q_rad=p.q_rad[[0, 0]]) for p in (first, *others)]
    new = concatenated_poses(first, *others) if others else first
    with pytest.raises(NoTestError, match="at least two different poses"):
        verify_new_poses(PANDA, BALL, solution, made_from=made_from, new=new)
