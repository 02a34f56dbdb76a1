"""Poses with the hand upside down on the hinge: closed loops of the other branch."""

from functools import cache

import numpy as np

from tests.oracles.shop_floor_chain import Chain, Loop
from tests.oracles.shop_floor_walk import LOWER_DEG, UPPER_DEG, in_range, nominal_chain

ALL_JOINTS = tuple(range(8))
STARTS = 4000


@cache
def nominal_pool() -> np.ndarray:
    """Flipped poses (k, 8) of the nominal loop within range, from random starts."""
    rng = np.random.default_rng(4)
    chain = nominal_chain()
    low, high = np.deg2rad(LOWER_DEG), np.deg2rad(UPPER_DEG)
    poses = []
    for _ in range(4):
        angles = np.zeros((STARTS // 4, 8))
        angles[:, 0] = rng.uniform(-np.pi, np.pi, len(angles))
        angles[:, 1:] = rng.uniform(low, high, (len(angles), 7)) + chain.theta_off[1:]
        poses.append(_closed(chain, angles))
    return np.concatenate(poses)


def flipped_poses(chain: Chain, rng: np.random.Generator, count: int) -> np.ndarray:
    """Flipped closed angles (count, 8) of a chain near the nominal one, or fewer."""
    pool, poses = nominal_pool(), np.zeros((0, 8))
    for attempt in range(60):
        start = pool[rng.integers(len(pool), size=100)]
        start = start + np.deg2rad(12.0 + attempt) * rng.normal(size=start.shape)
        poses = np.concatenate((poses, _closed(chain, start)))
        if len(poses) >= count:
            return poses[:count]
    return poses


def _closed(chain: Chain, angles: np.ndarray) -> np.ndarray:
    """Angles that closed and whose readings are in range, modulo full turns."""
    angles, closes = Loop(chain=chain, upside_down=True).closed(angles, free=ALL_JOINTS, rounds=40)
    middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)) + chain.theta_off[1:]
    angles[:, 1:] = middle + np.mod(angles[:, 1:] - middle + np.pi, 2.0 * np.pi) - np.pi
    return angles[closes & in_range((angles - chain.theta_off)[:, 1:])]
