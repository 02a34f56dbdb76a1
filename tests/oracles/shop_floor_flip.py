"""Poses with the hand upside down on the hinge: closed loops of the other branch. Knows no sensor."""

from functools import cache

import numpy as np

from tests.oracles.shop_floor_chain import Chain, Loop
from tests.oracles.shop_floor_walk import LOWER_DEG, UPPER_DEG, in_range, nominal_chain

EVERY = tuple(range(8))
STARTS = 4000


@cache
def nominal_pool() -> np.ndarray:
    """Flipped poses (k, 8) of the nominal loop within range, found from starts all over."""
    rng = np.random.default_rng(4)
    chain = nominal_chain()
    low, high = np.deg2rad(LOWER_DEG), np.deg2rad(UPPER_DEG)
    found = []
    for _ in range(4):
        angles = np.zeros((STARTS // 4, 8))
        angles[:, 0] = rng.uniform(-np.pi, np.pi, len(angles))
        angles[:, 1:] = rng.uniform(low, high, (len(angles), 7)) + chain.theta_off[1:]
        found.append(_closed(chain, angles))
    return np.concatenate(found)


def flipped_poses(chain: Chain, rng: np.random.Generator, count: int) -> np.ndarray:
    """Closed angles (count, 8) of a chain near the nominal one, hand upside down; fewer if it has none."""
    pool, found = nominal_pool(), np.zeros((0, 8))
    for attempt in range(60):
        start = pool[rng.integers(len(pool), size=100)]
        start = start + np.deg2rad(12.0 + attempt) * rng.normal(size=start.shape)
        found = np.concatenate((found, _closed(chain, start)))
        if len(found) >= count:
            return found[:count]
    return found


def _closed(chain: Chain, angles: np.ndarray) -> np.ndarray:
    """Angles that closed and whose readings are in range, whole turns aside."""
    angles, good = Loop(chain=chain, upside_down=True).closed(angles, free=EVERY, rounds=40)
    middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)) + chain.theta_off[1:]
    angles[:, 1:] = middle + np.mod(angles[:, 1:] - middle + np.pi, 2.0 * np.pi) - np.pi
    return angles[good & in_range((angles - chain.theta_off)[:, 1:])]
