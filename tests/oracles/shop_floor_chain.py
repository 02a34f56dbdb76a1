"""Second implementation of the D-H loop: forward kinematics, joint angles that close it, random walks.

Shares no code with `solver`. Link j is ``Rz(theta_j) Tz(s_j) Tx(a_j) Rx(alpha_j)``; the chain runs from the hinge
frame over link 0 (hinge to base) and links 1..7 back to it. `ground` and `hand` displace the hinge's two halves.

In a walk the drives are joints 1 and 5 within the boxes of the packaged procedure, relative to the file's home pose,
and the passive joints follow. A chart of the nominal loop over these boxes gives their starting values.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cache

import numpy as np
from scipy.spatial.transform import Rotation

from tests.oracles.loop_oracle import Chain

LINKS = 8
CLOSED = 1e-12
UPRIGHT = np.eye(3)
FLIPPED = np.diag([1.0, -1.0, -1.0])

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


def rotation_about_z(angle: np.ndarray) -> np.ndarray:
    out = np.zeros((*np.shape(angle), 4, 4))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0] = np.sin(angle)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    return out


def link_transform(s: float, a: float, alpha: float) -> np.ndarray:
    c, n = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -n, 0], [0, n, c, s], [0, 0, 0, 1.0]])


def displacement(small: np.ndarray) -> np.ndarray:
    """Homogeneous transforms (m, 4, 4) of rotation vectors over translations (m, 6)."""
    out = np.tile(np.eye(4), (len(small), 1, 1))
    out[:, :3, :3] = Rotation.from_rotvec(small[:, :3]).as_matrix()
    out[:, :3, 3] = small[:, 3:]
    return out


def frames(
    chain: Chain,
    angles: np.ndarray,
    *,
    ground: np.ndarray | None = None,
    hand: np.ndarray | None = None,
) -> np.ndarray:
    """Frames (m, 10, 4, 4) at true angles (m, 8), in the hinge frame; displacements are (m, 6).

    Frame j has the axis of joint j as its z (0 is the hinge); 8 is the end of link 7, 9 the end displaced by `hand`.
    """
    frame = np.broadcast_to(np.eye(4), (len(angles), 4, 4))
    all_frames = [frame]
    for j in range(LINKS):
        frame = frame @ rotation_about_z(angles[:, j])
        if j == 0 and ground is not None:
            frame = frame @ displacement(ground)
        frame = frame @ link_transform(chain.s[j], chain.a[j], chain.alpha[j])
        all_frames.append(frame)
    all_frames.append(frame if hand is None else frame @ displacement(hand))
    return np.stack(all_frames, axis=1)


def misclosure(T: np.ndarray, hand_up: np.ndarray = UPRIGHT) -> np.ndarray:
    """Closure errors of the loops of `frames`: rotation vectors over positions (m, 6)."""
    turn = Rotation.from_matrix(T[:, 9, :3, :3] @ hand_up.T).as_rotvec()
    return np.concatenate((turn, T[:, 9, :3, 3]), axis=-1)


def screws(T: np.ndarray) -> np.ndarray:
    """Jacobian (m, 6, 8) of the end by every joint, rotation over translation."""
    z, origin, end = T[:, :LINKS, :3, 2], T[:, :LINKS, :3, 3], T[:, 9, None, :3, 3]
    return np.swapaxes(np.concatenate((z, np.cross(z, end - origin)), axis=-1), -1, -2)


@dataclass(frozen=True, kw_only=True)
class Loop:
    """A closed loop: its chain, the fixture's constraints, the hand's orientation.

    `rows` are the constrained components of the misclosure: all six in a hinge (its angle is one of the eight),
    the three of position in a ball joint.
    """

    chain: Chain
    rows: tuple[int, ...] = (0, 1, 2, 3, 4, 5)
    upside_down: bool = False

    def error(self, T: np.ndarray) -> np.ndarray:
        """Misclosure of `frames` in the constrained components, (m, rows)."""
        return misclosure(T, FLIPPED if self.upside_down else UPRIGHT)[:, self.rows]

    def closed(self, angles, *, free: tuple[int, ...], rounds: int = 60, **displaced):
        """Close poses (m, 8) by moving the `free` joints (0 is the hinge): angles, and which closed to `CLOSED`.

        Newton's method, with steps of at most 0.3 rad.
        """
        angles, free = np.array(angles, dtype=float), list(free)
        last = np.inf
        for _ in range(rounds):
            T = frames(self.chain, angles, **displaced)
            error = self.error(T)
            worst = np.abs(error).max()
            if worst < 1e-15 or (worst < 1e-13 and worst >= last):
                break
            last = worst
            J = screws(T)[:, self.rows][:, :, free]
            step = -(np.linalg.pinv(J, rcond=1e-9) @ error[..., None])[..., 0]
            longest = np.maximum(np.abs(step).max(axis=-1, keepdims=True), 1e-300)
            angles[:, free] += step * np.minimum(1.0, 0.3 / longest)
        error = self.error(frames(self.chain, angles, **displaced))
        return angles, np.abs(error).max(axis=-1) < CLOSED


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
