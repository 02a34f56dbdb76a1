"""The packaged arms in their fixtures, and calibrations of simulated sessions with them."""

from dataclasses import replace
from typing import TypeVar

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.error_model import error_model, free_within_tolerance
from operator_app.calibration.experiment import Experiment, pick_placements
from operator_app.calibration.result import Solution
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses, parse_poses
from solver.chain.poses import PoseSet
from solver.estimators.variance_components import Calibrated, estimate_with_errors
from tests.oracles.panda import FOLDER
from tests.oracles.shop_floor import Session

ARM, HINGE = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
PANDA, BALL = load_arm("franka_panda"), load_fixture("ball").fixture
SEED = 3001
"""Seed of the sound session."""


Taken = TypeVar("Taken", PoseSet, Session)


def poses_of(session: Session) -> PoseSet:
    """The poses of a session, read from its poses file."""
    return parse_poses(session.csv().encode(), "poses.csv").poses


def solved(session: Session, **options: str) -> Solution:
    return calibrate(ARM, HINGE, poses_of(session), **options)


def fit_of(session: Session) -> Calibrated:
    """The fit of a session with the stated errors, without diagnosis."""
    experiment = Experiment(arm=ARM, fixture=HINGE, poses=poses_of(session))
    model, tolerance = free_within_tolerance(experiment.loop(), ARM)
    errors = error_model(experiment, tolerance=tolerance)
    return estimate_with_errors(model, experiment.poses.q_rad, errors)


def panda_poses(*placements: int) -> PoseSet:
    """The real Panda's poses in some placements, by default in all."""
    poses = load_poses(str(FOLDER / "panda_1.csv"), joint_count=7).poses
    return pick_placements(poses, placements) if placements else poses


def displaced(taken: Taken, where: object, deg: object) -> Taken:
    """The poses or the session with angles (deg) added to the readings (m, n) at `where`."""
    name = "q_rad" if isinstance(taken, PoseSet) else "readings"
    angles = getattr(taken, name).copy()
    angles[where] += np.deg2rad(deg)
    return replace(taken, **{name: angles})


def spread_out(session: Session, where: object, deg: float) -> Session:
    """The session with readings at `where` (m, n) that spread by so much within their poses."""
    spread = session.spread.copy()
    spread[where] = np.deg2rad(deg)
    return replace(session, spread=spread)
