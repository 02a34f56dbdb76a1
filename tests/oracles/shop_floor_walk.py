"""Random walks of the drive joints, the passive joints following.

The drives are joints 1 and 5 within the boxes of the packaged procedure, relative to the file's home pose. A chart
of the nominal loop over these boxes gives starting values of the passive joints.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from tests.oracles.shop_floor_chain import Chain, Loop, frames

DRIVES = (1, 5)
FOLLOW = (0, 2, 3, 4, 6, 7)
BOX_DEG = ((-30.0, 48.0), (-70.0, 0.0))
HOME_DEG = (40.5311, 245.5792, 143.1309, -115.0631, -189.2465, -215.6707, 44.9482)
LOWER_DEG = np.array([-35.0, 170, 68, -190, -265, -275.625, -15])
UPPER_DEG = np.array([115.0, 320, 218, -40, -115, -155.625, 105])
MARGIN_DEG = 2.0
"""Distance of a joint from the ends of its range, larger than any error of a reading."""

STRAY_RAD = 0.5
"""A passive joint further than this from the chart is on another branch."""

GRID = 15


def nominal_chain() -> Chain:
    """The arm file's table in the fixture file's placement, as literals."""
    return Chain(
        theta_off=np.deg2rad([0.0, 10, -120, -20, -10, 30, 120, 90]),
        s=np.array([0.010, 0.270, 0.0, 0.355, 0.0, 0.320, 0.0, 0.040]),
        a=np.array([0.200, 0.0, 0.0, 0.0, 0.0, 0.0, 0.0, -0.100]),
        alpha=np.deg2rad([-40.0, 90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 100.0]),
    )


@dataclass(frozen=True, kw_only=True)
class Chart:
    """Closed true angles (k, 8) of a loop, and the drives' positions (k, 2) in the box.

    No passive joint jumps between neighbours. `drives` (2,) are the drive joints' readings at position 0.
    """

    place: np.ndarray
    angles: np.ndarray
    drives: np.ndarray

    def near(self, place: np.ndarray) -> np.ndarray:
        """Angles (m, 8) of the nodes nearest to positions (m, 2)."""
        distance = np.linalg.norm(place[:, None] - self.place, axis=-1)
        return self.angles[np.argmin(distance, axis=-1)]


@cache
def nominal_chart() -> Chart:
    """Chart of the nominal loop over the packaged boxes, from home outwards."""
    chain = nominal_chain()
    home = np.concatenate(([0.0], np.deg2rad(HOME_DEG))) + chain.theta_off
    home[0] = home_hinge_angle(chain, home)
    home = Loop(chain=chain).closed(home[None], free=tuple(range(8)))[0][0]
    return chart(chain, home)


def chart(chain: Chain, home: np.ndarray, box_deg=BOX_DEG) -> Chart:
    """Follow the loop of `chain` from `home` (8,) over the box, row by row of a grid."""
    low, high = np.deg2rad(np.array(box_deg).T)
    places = np.stack(np.meshgrid(*np.linspace(low, high, GRID).T, indexing="ij"), axis=-1)
    loop = Loop(chain=chain)
    nodes = [(np.zeros(2), home)]
    for place in sorted(places.reshape(-1, 2), key=lambda p: float(np.linalg.norm(p))):
        _, nearest = min(nodes, key=lambda node: float(np.linalg.norm(node[0] - place)))
        guess = nearest.copy()
        guess[list(DRIVES)] = home[list(DRIVES)] + place
        closed, closes = loop.closed(guess[None], free=FOLLOW, rounds=12)
        if closes[0] and np.abs(closed[0] - nearest).max() < STRAY_RAD:
            nodes.append((place, closed[0]))
    return Chart(
        place=np.array([place for place, _ in nodes[1:]]),
        angles=np.array([angles for _, angles in nodes[1:]]),
        drives=(home - chain.theta_off)[list(DRIVES)],
    )


def home_hinge_angle(chain: Chain, angles: np.ndarray) -> float:
    """Hinge angle at which the hand's orientation is closest to the hinge frame's."""
    at_zero = np.array(angles)
    at_zero[0] = 0.0
    T = frames(chain, at_zero[None])[0, 9]
    return float(-np.arctan2(T[1, 0] - T[0, 1], T[0, 0] + T[1, 1]))


def wander(rng: np.random.Generator, count: int, *, box_deg=BOX_DEG) -> np.ndarray:
    """Positions (count, 2) of a random walk, rad from home; a step is a quarter of the box (1 sigma)."""
    low, high = np.deg2rad(np.array(box_deg).T)
    walk = rng.uniform(size=2) + np.cumsum(0.25 * rng.normal(size=(count, 2)), axis=0)
    folded = np.abs(np.mod(walk + 1.0, 2.0) - 1.0)
    return low + folded * (high - low)


def in_range(readings: np.ndarray) -> np.ndarray:
    """Which readings (m, 7) are within the ranges, less the margin."""
    deg = np.rad2deg(readings)
    return np.all((deg > LOWER_DEG + MARGIN_DEG) & (deg < UPPER_DEG - MARGIN_DEG), axis=-1)
