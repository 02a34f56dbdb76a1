"""The packaged arms in their fixtures, and sessions as their files have them. Judges nothing."""

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.closed_loops import pick_placements
from operator_app.calibration.result import Solution
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses, parse_poses
from solver.chain.poses import PoseSet
from tests.oracles.panda import FOLDER
from tests.oracles.shop_floor import Session

ARM, HINGE = load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
PANDA, BALL = load_arm("franka_panda"), load_fixture("ball").fixture
SEED = 3001
"""Of the session in which nothing is wrong."""


def poses_of(found: Session) -> PoseSet:
    """Return what is read of a session's file."""
    return parse_poses(found.csv().encode(), "poses.csv").poses


def solved(found: Session, **options: str) -> Solution:
    """Return the calibration of a session."""
    return calibrate(ARM, HINGE, poses_of(found), **options)


def panda_poses(*placements: int) -> PoseSet:
    """Return the real Panda's poses in some sockets; without any, all."""
    poses = load_poses(str(FOLDER / "panda_1.csv"), joint_count=7).poses
    return pick_placements(poses, placements) if placements else poses
