"""Cross-validation of a calibration by its own poses."""

from dataclasses import replace

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from operator_app.config.poses_file import load_poses
from solver.estimators import mixed_fit
from tests.oracles.as_shipped import ARM, HINGE, SEED, fit_of, poses_of, solved
from tests.oracles.shop_floor import Sizes, session


def test_parts_use_the_gravity_sign_of_the_full_fit(reference_data):
    """The arm file states sag that these readings do not have."""
    poses = load_poses(str(reference_data / "hinge" / "hinge_exact.csv"), joint_count=7).poses
    checks = check(calibrate(ARM, HINGE, poses), ARM, HINGE, poses)
    for part in (checks.held_out, checks.far_block):
        assert part.sigmas.position_m.rms < 1e-6
    assert np.rad2deg(checks.jackknife_sd[0]) < 1e-4


def test_parts_use_the_length_tolerance_of_the_calibration():
    exact = ARM.with_length_tolerance(0.0)
    poses, jackknife_sds = poses_of(session(0)), []
    for arm, tolerance_m in ((ARM, None), (exact, float(ARM.length_tolerance_m.max()))):
        solution = calibrate(arm, HINGE, poses, length_tolerance_m=tolerance_m)
        jackknife_sds.append(check(solution, arm, HINGE, poses).jackknife_sd)
    np.testing.assert_allclose(*jackknife_sds, rtol=1e-3)


def test_chi2_of_held_out_poses_counts_every_stated_error():
    """Sound sessions: about 1 or less. Sensor noise alone makes it 3 to 1000, because sag and curves are larger."""
    for seed in (SEED, SEED + 1):
        sound = session(seed)
        checks = check(solved(sound), ARM, HINGE, poses_of(sound))
        for part in (*checks.held_out.parts, *checks.far_block.parts):
            assert 0.1 < part.per_dof < 2.0


def test_chi2_of_held_out_poses_shows_a_reading_that_the_others_contradict():
    sound = session(SEED)
    poses, solution = poses_of(sound), solved(sound)
    q = poses.q_rad.copy()
    q[3, 3] += np.deg2rad(5.0)
    shifted = check(solution, ARM, HINGE, replace(poses, q_rad=q)).held_out
    usual = check(solution, ARM, HINGE, poses).held_out
    ratios = [a.per_dof / b.per_dof for a, b in zip(shifted.parts, usual.parts, strict=True)]
    assert max(ratios) > 5.0


def test_gravity_sign_is_tested_before_convergence(monkeypatch):
    monkeypatch.setattr(mixed_fit, "SIGN_TEST_SIGMA", 0.0)
    assert not fit_of(session(0, Sizes.only())).linear.design.expected.any()
