"""The paper's arm (table 2) with its joint ranges, and the region of closed poses around home."""

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.design import d_optimal
from solver.design.manifold import grow_manifold
from solver.design.motion import Ranges
from solver.design.plan import PlanningTask, information_of
from solver.estimators.error_model import ErrorModel
from solver.estimators.implicit import NoiseModel
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.simulated_loops import ENCODER_SD
from tests.solver.conftest import loop_of

HOME = paper_truth().home
REGION_STEP_RAD = 0.12
DRIVES = (1, 5)
SIGMA = np.array([ENCODER_SD] * 5 + [6e-3] * 2)


class ClosedChain:
    """The true loop with some joints driven: its readings are an exact arm's."""

    def __init__(self, loop, x, drives: tuple[int, ...] = DRIVES, home=HOME) -> None:
        self.loop, self.x = loop, x
        self.free = np.ones(7)
        self.free[[j - 1 for j in drives]] = 0.0
        pose = close_loops(loop, x, home[None, :])
        self.q, self.u = pose.q, pose.u

    def move(self, targets: dict[int, float]) -> np.ndarray:
        start = self.q[0].copy()
        for share in np.linspace(0.0, 1.0, 9)[1:]:
            self.q[0, [j - 1 for j in targets]] = [
                start[j - 1] + share * (v - start[j - 1]) for j, v in targets.items()
            ]
            pose = close_loops(self.loop, self.x, self.q, u=self.u, sigma_rad=self.free)
            assert pose.closed[0]
            self.q, self.u = pose.q, pose.u
        return self.q[0].copy()


def of_noise(sigma_rad: np.ndarray):
    """Errors of readings with independent noise (n,) and no other error."""
    return lambda q_rad: ErrorModel(joint_variance=np.broadcast_to(sigma_rad**2, q_rad.shape))


def information_of_captured_poses(task: PlanningTask, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Information of captured poses `q` (c, n) and of what files state."""
    return information_of(task, x, q, close_loops(task.model, x, q[:0]))[0]


def choose_poses(root: np.ndarray, count: int, **options) -> tuple[int, ...]:
    """The choice before any pose is captured, and without effects, unless `options` state them."""
    N = root.shape[-1]
    return d_optimal.choose_poses(
        root, count, **({"parameters": N, "fixed": np.zeros((N, N))} | options)
    )


def paper_ranges() -> Ranges:
    lower, upper = HOME - np.deg2rad(75.0), HOME + np.deg2rad(75.0)
    lower[5:], upper[5:] = np.deg2rad([-275.625, -15.0]), np.deg2rad([-155.625, 105.0])
    return Ranges(lower_rad=lower, upper_rad=upper)


@pytest.fixture(scope="session")
def loop():
    return loop_of(paper_truth())


@pytest.fixture(scope="session")
def x(loop):
    return nominal_vector(loop.parameters)


@pytest.fixture(scope="session")
def ranges():
    return paper_ranges().within(np.deg2rad(3.0))


@pytest.fixture(scope="session")
def region(loop, x, ranges):
    return grow_manifold(loop, x, HOME, ranges, step_rad=REGION_STEP_RAD)


@pytest.fixture(scope="session")
def task(loop):
    return PlanningTask(
        model=loop,
        ranges=paper_ranges(),
        margin_rad=np.deg2rad(3.0),
        noise=NoiseModel(joint_variance=SIGMA**2),
        errors_at=of_noise(SIGMA),
        drive_sets=(DRIVES,),
    )


@pytest.fixture(scope="session")
def pose_data(loop, x, region):
    errors = of_noise(SIGMA)(region.q)
    return d_optimal.pose_information(loop, x, region.q, region.q, region.u, errors)
