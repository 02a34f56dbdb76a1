"""The hand's sigma against hands that were placed by parameters drawn from the covariance."""

from __future__ import annotations

import numpy as np
import pytest

from operator_app.calibration.loop import pick_placements
from operator_app.calibration.solve import calibrate
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.report.facts import facts_of
from solver.loops.point import PointClosure
from tests.oracles.panda import FOLDER


def test_it_is_the_scatter_of_hands_drawn_from_the_covariance() -> None:
    poses = pick_placements(
        load_poses(str(FOLDER / "panda_1.csv"), joint_count=7).poses, placements=(3,)
    )
    solution = calibrate(load_arm("franka_panda"), load_fixture("ball").fixture, poses, drop=True)
    estimate, model = solution.estimate, solution.model
    assert isinstance(model, PointClosure)
    drawn = np.random.default_rng(1).multivariate_normal(
        estimate.x, estimate.covariance, size=1500, method="eigh"
    )
    hands = np.array([model.tip_position(x, poses.q_rad) for x in drawn])
    each = np.sqrt(((hands - model.tip_position(estimate.x, poses.q_rad)) ** 2).sum(-1).mean(0))
    assert solution.hand is not None
    assert solution.hand.rms == pytest.approx(float(np.sqrt((each**2).mean())), rel=0.06)
    assert solution.hand.worst == pytest.approx(float(each.max()), rel=0.08)
    said = facts_of(solution).json["tip_sigma_mm"]
    assert said == pytest.approx(
        {"rms": 1e3 * solution.hand.rms, "worst": 1e3 * solution.hand.worst}
    )
    assert 0.2 < said["rms"] <= said["worst"] < 10.0
