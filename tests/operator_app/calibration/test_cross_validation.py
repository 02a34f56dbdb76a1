"""Cross-validation of a calibration by its own poses."""

from dataclasses import replace

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from operator_app.config.poses_file import load_poses
from solver.estimators import mixed_fit
from tests.oracles.as_shipped import ARM, HINGE, fit_of, poses_of
from tests.oracles.shop_floor import Sizes, session


def test_parts_use_the_gravity_sign_of_the_full_fit(reference_data):
    """The arm file states sag that these readings do not have."""
    poses = load_poses(str(reference_data / "hinge" / "hinge_exact.csv"), joint_count=7).poses
    checks = check(calibrate(ARM, HINGE, poses), ARM, HINGE, poses)
    for part in (checks.held_out, checks.far_block):
        assert part.sigmas.position_m.rms < 1e-6
    assert np.rad2deg(checks.jackknife_sd[0]) < 1e-4


def test_parts_use_the_length_tolerance_of_the_calibration():
    exact = replace(ARM, tolerances=tuple(replace(t, length_m=0.0) for t in ARM.tolerances))
    poses, jackknife_sds = poses_of(session(0, Sizes.everything())), []
    for arm, tolerance_m in ((ARM, None), (exact, float(ARM.length_tolerance_m.max()))):
        solution = calibrate(arm, HINGE, poses, length_tolerance_m=tolerance_m)
        jackknife_sds.append(check(solution, arm, HINGE, poses).jackknife_sd)
    np.testing.assert_allclose(*jackknife_sds, rtol=1e-3)


def test_gravity_sign_is_tested_before_convergence(monkeypatch):
    monkeypatch.setattr(mixed_fit, "SIGN_TEST_SIGMA", 0.0)
    assert not fit_of(session(0, Sizes.only())).linear.design.expected.any()
