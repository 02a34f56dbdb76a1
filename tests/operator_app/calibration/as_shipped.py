"""Sessions of the shop floor, calibrated with arm and fixture as they are shipped. No test in it."""

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.result import Solution
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import parse_poses
from solver.chain.poses import PoseSet
from tests.oracles.shop_floor import Session

ARM, HINGE = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
SEED = 3001
"""Of the session in which nothing is wrong."""


def poses_of(found: Session) -> PoseSet:
    """Return what is read of a session's file."""
    return parse_poses(found.csv().encode(), "poses.csv").poses


def solved(found: Session, **options: str) -> Solution:
    """Return the calibration of a session."""
    return calibrate(ARM, HINGE, poses_of(found), **options)
