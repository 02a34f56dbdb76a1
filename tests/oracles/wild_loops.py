"""Random hinge problems without prior knowledge. Shares no code with `solver`.

The paper's lengths and twists, with any offsets and any hinge within reach that is not nearly parallel to its
neighbours. Poses are within 60 deg of a random home.
"""

from dataclasses import dataclass

import numpy as np

from tests.oracles.shop_floor_chain import Loop, nominal_chain
from tests.oracles.shop_floor_parallel import mount_hinge
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
    rng, every = np.random.default_rng(seed), tuple(range(8))
    free, upright = tuple(set(every) - set(still)), poses - upside_down
    while True:
        tilt = rng.choice([-1.0, 1.0]) * rng.uniform(PARALLEL_RAD, np.pi - PARALLEL_RAD)
        a_7, s_7 = rng.uniform(-0.15, 0.15), rng.uniform(-0.12, 0.12)
        hand = nominal_chain().changed(a_7=a_7, s_7=s_7, alpha_7=tilt)
        chain, home = mount_hinge(hand, rng.uniform(-np.pi, np.pi, 7))
        if not PARALLEL_RAD < chain.alpha[0] < np.pi - PARALLEL_RAD:
            continue
        theta = np.tile(home, (10 * upright, 1))
        theta[:, free] += rng.uniform(-BOX_RAD, BOX_RAD, (len(theta), len(free)))
        theta, closes = Loop(chain=chain).closed(theta, free=free, rounds=40)
        theta = theta[closes & (np.abs(theta - home)[:, 1:].max(-1) < BOX_RAD)][:upright]
        if upside_down:
            flipped = rng.uniform(-np.pi, np.pi, (40 * upside_down, 8))
            flipped, closes = Loop(chain=chain, upside_down=True).closed(flipped, free=every)
            theta = np.concatenate((theta, flipped[closes][:upside_down]))
        if len(theta) == poses:
            offsets = rng.uniform(-np.pi, np.pi, 7)
            return RandomHingeProblem(q=theta[:, 1:] - offsets, offsets=offsets)


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
