"""A real arm with its ball in several sockets (tests/data/panda_ball), as an operator calibrates it."""

import re
from dataclasses import replace
from itertools import combinations

import numpy as np
import pytest

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.verification import verify_poses
from solver.errors import UnidentifiableError
from tests.oracles.as_shipped import BALL, PANDA, displaced, panda_poses
from tests.oracles.panda import FOLDER

PAIRS = ((1, 2), (3, 4), (5, 6))
"""Each pair is the two sockets of one block, 50 mm apart; the block stood in three places."""

OBSERVABLE = tuple(f"theta_off_{j}" for j in range(2, 7))


def calibrated(*placements, arm=PANDA):
    return calibrate(arm, BALL, panda_poses(*placements), drop=True)


@pytest.fixture(scope="module")
def pair_solutions():
    return tuple(calibrated(*pair) for pair in PAIRS)


def test_unmeasured_sockets_are_accepted(pair_solutions):
    """The fixture file states where one socket is: the block was up to 0.9 m from there."""
    for solution in pair_solutions:
        assert solution.verdict is Verdict.ACCEPTED
        assert solution.held == ("theta_off_1", "theta_off_7")
        assert len(solution.tolerated) > 15
        # The block was moved between the sockets.
        assert "SAME_PLACEMENT" not in {n.code for n in solution.warnings}


def test_offsets_invisible_to_a_ball_keep_the_arm_file_tolerance(pair_solutions):
    assert PANDA.offset_tolerance_rad == pytest.approx(np.deg2rad(1.0))
    for pair, dropped in zip(PAIRS, pair_solutions, strict=True):
        solution = calibrate(PANDA, BALL, panda_poses(*pair))
        assert solution.verdict is Verdict.ACCEPTED
        assert solution.held == ()
        (notice,) = [n.text for n in solution.warnings if n.code == "AS_STATED"]
        sigma, before = solution.estimate.sd_by_name, dropped.estimate.sd_by_name
        for name in ("theta_off_1", "theta_off_7"):
            stated = rf"{name} \([0-4] % from these poses, sigma (0.98|0.99|1.0) deg\)"
            assert re.search(stated, notice)
            assert 0.97 < sigma[name] / np.deg2rad(1.0) < 1.0 + 1e-9
            assert solution.shares[name] < 0.05
        for name in OBSERVABLE:
            assert solution.estimate.value(name) == pytest.approx(
                dropped.estimate.value(name), abs=0.05 * before[name]
            )
            assert sigma[name] == pytest.approx(before[name], rel=1e-2)
        # The sigma of a socket has the zero of joint 1 times its distance from that axis.
        for k in pair:
            x, y = (solution.estimate.value(f"ground_{c}[{k}]") for c in "xy")
            for name, lever in ((f"ground_x[{k}]", y), (f"ground_y[{k}]", x)):
                both = np.hypot(before[name], lever * sigma["theta_off_1"])
                assert sigma[name] == pytest.approx(both, rel=0.05)


def test_offsets_invisible_to_a_ball_need_a_tolerance():
    arm = replace(PANDA, offset_tolerance_rad=None)
    with pytest.raises(UnidentifiableError) as error:
        calibrate(arm, BALL, panda_poses(1, 2))
    assert any("theta_off_1" in d.parameters for d in error.value.directions)


def test_offsets_of_separate_socket_pairs_agree(pair_solutions):
    z = []
    for one, two in combinations((s.estimate for s in pair_solutions), 2):
        for name in OBSERVABLE:
            sd = np.hypot(one.sd_by_name[name], two.sd_by_name[name])
            z.append((one.value(name) - two.value(name)) / sd)
    assert np.mean(np.abs(z) < 1.96) >= 0.9


@pytest.mark.campaign
def test_six_sockets_are_accepted_with_sag_only():
    """Joint 4 carries 11 N m in the first two sockets and 2 in the next; without sag it steps by 0.17 deg."""
    assert calibrated(*range(1, 7)).verdict is Verdict.ACCEPTED
    stiff = tuple(replace(joint, sag_rad=np.deg2rad(0.01)) for joint in PANDA.joints)
    rigid = calibrated(*range(1, 7), arm=replace(PANDA, masses=None, joints=stiff))
    assert "STEP_JOINT_4" in {c.code for c in rigid.causes}


def test_step_between_placements_names_the_placement():
    poses = panda_poses(2, 6)
    shifted = displaced(poses, (poses.placement == 6, 3), 0.5)
    solution = calibrate(PANDA, BALL, shifted, drop=True)
    assert solution.verdict is Verdict.NOT_ACCEPTED
    texts = [c.text for c in solution.causes if c.code.startswith("STEP")]
    assert texts
    assert all("of placement 2 and pose" in text or "of placement 6" in text for text in texts)


def test_paper_estimate_fails_verification_with_new_sockets(run_command):
    """Its sigmas are only the scatter of its own residuals: too small for other sockets."""
    file = FOLDER / "panda_1.csv"
    options = ["--arm", "franka_panda", "--fixture", "ball", "--drop-unidentifiable", "--json"]
    options += ["--placements", "3", "--estimator", "paper", "--test", file]
    test = run_command(4, "solve", file, *options).json["test"]
    assert (test["verdict"], test["poses"]) == ("does not hold", 152)


def test_a_ur10_measured_by_a_laser_tracker_is_predicted(run_command):
    """Parallel joints 2 to 4, and an instrument instead of a fixture (tests/data/ur10_tracker)."""
    folder = FOLDER.parent / "ur10_tracker"
    options = ["--arm", folder / "ur10.yaml", "--fixture", "tracker", "--json"]
    result = run_command(0, "solve", folder / "train.csv", *options, "--test", folder / "test.csv")
    test = result.json["test"]
    assert test["verdict"] == "holds"
    assert 0.3 < test["chi2_per_dof"] < 2.0
    by_row = {
        row: test[row]["sigma_pos_mm"]["rms"]
        for row in ("nominal", "with_best_table", "with_corrections")
    }
    assert by_row["with_best_table"] < 0.45 * by_row["nominal"]
    assert by_row["with_corrections"] < 0.95 * by_row["with_best_table"]


def test_a_fanuc_with_three_targets_measured_ten_times_a_pose_is_predicted(run_command):
    """Ten rows of a pose count once, in the calibration and in the test (tests/data/fanuc_tracker)."""
    folder = FOLDER.parent / "fanuc_tracker"
    options = ["--arm", folder / "fanuc.yaml", "--fixture", "tracker", "--json"]
    result = run_command(0, "solve", folder / "train.csv", *options, "--test", folder / "test.csv")
    test = result.json["test"]
    assert (test["verdict"], test["poses"]) == ("holds", 8)
    assert 0.3 < test["chi2_per_dof"] < 2.0
    # Upper limit of chi2/dof with about 48 equations, instead of 480.
    assert test["chi2_band_99"][1] > 3.0
    assert test["with_best_table"]["sigma_pos_mm"]["rms"] < 0.12


def test_paper_estimate_is_verified_by_its_own_covariance():
    own, new = panda_poses(3), panda_poses(1, 6)
    by_paper = calibrate(PANDA, BALL, own, estimator="paper", drop=True)

    def verified(times):
        scaled = replace(
            by_paper,
            estimate=replace(by_paper.estimate, covariance=times**2 * by_paper.estimate.covariance),
        )
        return verify_poses(PANDA, BALL, new, scaled, own, elsewhere=True)

    claimed, ten_times = verified(1.0), verified(10.0)
    # Lengths fixed at nominal values deviate, unless its covariance is widened.
    assert claimed.shift is not None
    assert ten_times.shift is None
    assert ten_times.verification.chi2.per_dof < claimed.verification.chi2.per_dof
    assert claimed.verification.chi2.dof == ten_times.verification.chi2.dof == 3 * len(new) - 6
