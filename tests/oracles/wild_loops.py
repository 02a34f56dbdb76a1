"""Random hinge problems without prior knowledge. Shares no code with `solver`.

The paper's lengths and twists, with any offsets and any hinge within reach that is not nearly parallel to its
neighbours. Poses are within 60 deg of a random home, closed by Newton's method.
"""

from dataclasses import dataclass

import numpy as np

from tests.oracles.loop_oracle import paper_truth, product
from tests.oracles.simulated_loops import COUNT_RAD, FULL_SCALE_RAD, LSB_RAD

PARALLEL_RAD = np.deg2rad(20.0)
BOX_RAD = np.deg2rad(60.0)


@dataclass(frozen=True)
class RandomHingeProblem:
    """Readings (m, 7), and true offsets (7,): of joints 1 and 7 they depend on the hinge's common normals."""

    q: np.ndarray
    offsets: np.ndarray


def random_hinge_problem(
    seed: int, *, poses: int = 40, still: tuple[int, ...] = (), upside_down: int = 0
) -> RandomHingeProblem:
    """One problem without sensor errors; `still` joints (from 1) have a constant angle.

    In the last `upside_down` poses the hand is flipped on the hinge.
    """
    rng = np.random.default_rng(seed)
    arm = paper_truth()
    moving = np.array([0.0 if j in still else 1.0 for j in range(1, 8)])
    while True:
        s, a, alpha = arm.s[1:].copy(), arm.a[1:].copy(), arm.alpha[1:].copy()
        s[0], s[6] = rng.uniform(0.15, 0.35), rng.uniform(-0.12, 0.12)
        a[6] = rng.uniform(-0.15, 0.15)
        alpha[6] = rng.choice([-1.0, 1.0]) * rng.uniform(PARALLEL_RAD, np.pi - PARALLEL_RAD)
        home = rng.uniform(-np.pi, np.pi, 7)
        T = product(home, s, a, alpha)
        line, point = T[:3, 2], T[:3, 3]
        if abs(line[2]) > np.cos(PARALLEL_RAD):
            continue
        count = poses - upside_down
        theta = home + moving * rng.uniform(-BOX_RAD, BOX_RAD, (10 * count, 7))
        theta, upright = _closed(theta, moving, s, a, alpha, line, point)
        theta = theta[upright & (np.abs(theta - home).max(-1) < BOX_RAD)]
        if len(theta) < count:
            continue
        offsets = rng.uniform(-np.pi, np.pi, 7)
        flipped = rng.uniform(-np.pi, np.pi, (40 * upside_down, 7))
        if upside_down:
            flipped, upright = _closed(flipped, moving, s, a, alpha, line, point)
            flipped = flipped[~upright][:upside_down]
        q = np.concatenate((theta[:count], flipped)) - offsets
        if len(q) == poses:
            return RandomHingeProblem(q=q, offsets=offsets)


def with_sensor_errors(q: np.ndarray, seed: int) -> np.ndarray:
    """Readings by five encoders and two RVDTs (noise, and a curve of 1 % of full scale)."""
    rng = np.random.default_rng(10_000 + seed)
    readings = q.copy()
    readings[:, :5] = np.round(readings[:, :5] / COUNT_RAD) * COUNT_RAD
    middle = readings[:, 5:].mean(axis=0)
    t = (readings[:, 5:] - middle) / (0.5 * FULL_SCALE_RAD)
    readings[:, 5:] += 0.01 * FULL_SCALE_RAD * np.sin(np.pi * t)
    readings[:, 5:] += 2.0 * LSB_RAD * rng.normal(size=t.shape)
    return readings


def _closed(theta, moving, s, a, alpha, line, point):
    """Closed poses near `theta`, and which of them have the hand upright."""
    for _ in range(40):
        error, J = _error(theta, s, a, alpha, line, point)
        step = -moving * (np.linalg.pinv(J * moving, rcond=1e-6) @ error[..., None])[..., 0]
        longest = np.maximum(np.abs(step).max(-1, keepdims=True), 1e-300)
        theta = theta + step * np.minimum(1.0, 0.3 / longest)
    error, _ = _error(theta, s, a, alpha, line, point)
    theta = theta[np.abs(error).max(-1) < 1e-12]
    return theta, (product(theta, s, a, alpha)[:, :3, 2] @ line) > 0.0


def _error(theta, s, a, alpha, line, point):
    """Difference of the hinge's axis and position from `line` and `point` (m, 6), and its Jacobian (m, 6, 7)."""
    T = [product(theta[:, :j], s[:j], a[:j], alpha[:j]) for j in range(8)]
    end = T[-1]
    error = np.concatenate((np.cross(end[:, :3, 2], line), end[:, :3, 3] - point), axis=-1)
    columns = []
    for frame in T[:-1]:
        z, o = frame[:, :3, 2], frame[:, :3, 3]
        turned = np.cross(np.cross(z, end[:, :3, 2]), line)
        columns.append(np.concatenate((turned, np.cross(z, end[:, :3, 3] - o)), axis=-1))
    return error, np.stack(columns, axis=-1)
