"""Random hinge problems of which nothing is known beforehand. Shares no code with `solver`.

The arm's lengths and twists are the paper's; the hinge may be anywhere within reach and at any angle
but near-parallel to its neighbours (that is for Hayati's parameters), offsets anywhere in a turn. Poses
are drawn within 60 deg of a random home and brought onto the loop by Newton's method.
"""

from dataclasses import dataclass

import numpy as np

from tests.oracles.loop_oracle import paper_truth, product
from tests.oracles.simulated_loops import COUNT_RAD, FULL_SCALE_RAD, LSB_RAD

PARALLEL_RAD = np.deg2rad(20.0)
BOX_RAD = np.deg2rad(60.0)


@dataclass(frozen=True)
class WildProblem:
    """Readings (m, 7) and what they came from.

    `offsets` (7,) are counted from frames whose x axes are the generator's: those of joints 2 to 6
    are the arm's own and comparable, those of 1 and 7 depend on the hinge's common normals.
    """

    q: np.ndarray
    offsets: np.ndarray


def wild_problem(
    seed: int, *, poses: int = 40, still: tuple[int, ...] = (), upside_down: int = 0
) -> WildProblem:
    """One problem without sensor errors; `still` joints (1-based) keep one angle in all poses.

    The last `upside_down` poses have the hand on the hinge the other way round, joints anywhere.
    """
    rng = np.random.default_rng(seed)
    arm = paper_truth()
    moving = np.array([0.0 if j in still else 1.0 for j in range(1, 8)])
    while True:
        s, a, alpha = arm.s[1:].copy(), arm.a[1:].copy(), arm.alpha[1:].copy()
        s[0], s[6], a[6] = (
            rng.uniform(0.15, 0.35),
            rng.uniform(-0.12, 0.12),
            rng.uniform(-0.15, 0.15),
        )
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
        over = rng.uniform(-np.pi, np.pi, (40 * upside_down, 7))
        if upside_down:
            over, upright = _closed(over, moving, s, a, alpha, line, point)
            over = over[~upright][:upside_down]
        q = np.concatenate((theta[:count], over)) - offsets
        if len(q) == poses:
            return WildProblem(q=q, offsets=offsets)


def with_sensors(q: np.ndarray, seed: int, *, curve: float = 0.01) -> np.ndarray:
    """Readings by five encoders and two RVDTs (noise, and a bow of `curve` of full scale)."""
    rng = np.random.default_rng(10_000 + seed)
    read = q.copy()
    read[:, :5] = np.round(read[:, :5] / COUNT_RAD) * COUNT_RAD
    middle = read[:, 5:].mean(axis=0)
    t = (read[:, 5:] - middle) / (0.5 * FULL_SCALE_RAD)
    read[:, 5:] += curve * FULL_SCALE_RAD * np.sin(np.pi * t)
    read[:, 5:] += 2.0 * LSB_RAD * rng.normal(size=t.shape)
    return read


def _closed(theta, moving, s, a, alpha, line, point):
    """Poses brought onto the loop, those that arrived, and which of them have the hand upright."""
    for _ in range(40):
        error, J = _error(theta, s, a, alpha, line, point)
        step = -moving * (np.linalg.pinv(J * moving, rcond=1e-6) @ error[..., None])[..., 0]
        longest = np.maximum(np.abs(step).max(-1, keepdims=True), 1e-300)
        theta = theta + step * np.minimum(1.0, 0.3 / longest)
    error, _ = _error(theta, s, a, alpha, line, point)
    theta = theta[np.abs(error).max(-1) < 1e-12]
    return theta, (product(theta, s, a, alpha)[:, :3, 2] @ line) > 0.0


def _error(theta, s, a, alpha, line, point):
    """Axis and place of the hinge against `line` and `point`, (m, 6), and derivatives (m, 6, 7)."""
    T = [product(theta[:, :j], s[:j], a[:j], alpha[:j]) for j in range(8)]
    end = T[-1]
    error = np.concatenate((np.cross(end[:, :3, 2], line), end[:, :3, 3] - point), axis=-1)
    columns = []
    for before in T[:-1]:
        z, o = before[:, :3, 2], before[:, :3, 3]
        turned = np.cross(np.cross(z, end[:, :3, 2]), line)
        columns.append(np.concatenate((turned, np.cross(z, end[:, :3, 3] - o)), axis=-1))
    return error, np.stack(columns, axis=-1)
