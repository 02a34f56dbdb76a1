"""Where a calibrated Panda says the ball is, at poses that took no part: the README's scatter, in mm.

The one place of these tests that asks the error model for its predicted joint errors elsewhere than where
it was fitted. `by_table` is the D-H table alone; `whole` takes out what the model found of encoders, play
and sag as well, all of it from the training poses.
"""

from dataclasses import dataclass, replace

import numpy as np

from operator_app.calibration.closed_loops import loop_of_poses, pick_placements
from operator_app.calibration.error_model import error_model, free_within_tolerance
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from solver.estimators.effects import LinearModel
from solver.estimators.variance_components import estimate_with_errors
from solver.loops.point import PointClosure
from tests.oracles.panda import FOLDER, scatter_mm

UNSEEN = ("theta_off_1", "theta_off_7")


@dataclass(frozen=True, kw_only=True)
class Scatter:
    """Mean distance of the ball's centre from its placement's mean, mm: training and other poses."""

    by_table: tuple[float, float]
    whole: tuple[float, float]


def scatter(placements: tuple[int, ...]) -> Scatter:
    """Train on some placements with every entry free under its tolerance; test on the others."""
    arm, ball = load_arm("franka_panda"), load_fixture("ball").fixture
    poses = load_poses(str(FOLDER / "panda_1.csv"), joint_count=7).poses
    there = np.flatnonzero(np.isin(poses.placement, placements))
    model = loop_of_poses(arm, ball, pick_placements(poses, placements)).without(UNSEEN)
    model, tolerance = free_within_tolerance(model, arm, fixed=UNSEEN)
    everywhere = error_model(arm, ball, poses, np.ones(len(poses), dtype=bool))
    errors = replace(everywhere.at_poses(there), tolerance=tolerance)
    found = estimate_with_errors(model, poses.q_rad[there], errors, group=poses.placement[there])
    part = model.parts()[0][0]
    assert isinstance(part, PointClosure)
    x = found.estimate.x[model.parts()[0][1]]
    # Effects along joints come first and have the same columns at all poses; give is no joint's.
    whole = LinearModel(part, poses.q_rad, replace(everywhere, tolerance=tolerance))
    along = len(whole.soft_index)
    along += len(whole.along_joints.joint_of)
    b = np.zeros(whole.width - whole.hard)
    b[:along] = found.linear.b[:along]
    shift, _ = whole.effects_at(b, poses.q_rad)
    rest = np.setdiff1d(np.arange(len(poses)), there)

    def of(q: np.ndarray) -> tuple[float, float]:
        centre = part.tip_position(x, q)
        train, test = (
            scatter_mm(centre[k], poses.placement[k]) if len(k) else np.nan for k in (there, rest)
        )
        return train, test

    return Scatter(by_table=of(poses.q_rad), whole=of(poses.q_rad + shift))
