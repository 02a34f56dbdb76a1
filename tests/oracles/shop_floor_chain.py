"""Second implementation of the D-H loop: forward kinematics, and joint angles that close it.

Shares no code with `solver`. Link j is ``Rz(theta_j) Tz(s_j) Tx(a_j) Rx(alpha_j)``; the chain runs from the hinge
frame over link 0 (hinge to base) and links 1..7 back to it. `ground` and `hand` displace the hinge's two halves.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

LINKS = 8
COLUMNS = ("theta_off", "s", "a", "alpha")
CLOSED = 1e-12
UPRIGHT = np.eye(3)
FLIPPED = np.diag([1.0, -1.0, -1.0])


@dataclass(frozen=True, kw_only=True)
class Chain:
    """D-H columns of links 0..7, (8,) each, rad and m; true angle = reading + `theta_off`."""

    theta_off: np.ndarray
    s: np.ndarray
    a: np.ndarray
    alpha: np.ndarray

    def value(self, name: str) -> float:
        """Return one entry by name: theta_off_4, a_0, ..."""
        column, row = name.rsplit("_", 1)
        return float(getattr(self, column)[int(row)])

    def changed(self, **changes: float) -> Chain:
        """Return the chain with some entries replaced, by name."""
        columns = {c: np.array(getattr(self, c)) for c in COLUMNS}
        for name, value in changes.items():
            column, row = name.rsplit("_", 1)
            columns[column][int(row)] = value
        return replace(self, **columns)


def rotation_about_z(angle: np.ndarray) -> np.ndarray:
    """Homogeneous rotations (..., 4, 4) about z."""
    out = np.zeros((*np.shape(angle), 4, 4))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle)
    out[..., 1, 0] = np.sin(angle)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = out[..., 3, 3] = 1.0
    return out


def link_transform(s: float, a: float, alpha: float) -> np.ndarray:
    """``Tz(s) Tx(a) Rx(alpha)``, (4, 4)."""
    c, n = np.cos(alpha), np.sin(alpha)
    return np.array([[1, 0, 0, a], [0, c, -n, 0], [0, n, c, s], [0, 0, 0, 1.0]])


def displacement(small: np.ndarray) -> np.ndarray:
    """Homogeneous transforms (..., 4, 4) of rotation vectors over translations (..., 6)."""
    turn, shift = small[..., :3], small[..., 3:]
    angle = np.linalg.norm(turn, axis=-1)[..., None, None]
    K = np.zeros((*small.shape[:-1], 3, 3))
    K[..., 0, 1], K[..., 0, 2], K[..., 1, 2] = -turn[..., 2], turn[..., 1], -turn[..., 0]
    K = K - np.swapaxes(K, -1, -2)
    out = np.zeros((*small.shape[:-1], 4, 4))
    out[..., :3, :3] = np.eye(3) + np.sinc(angle / np.pi) * K
    out[..., :3, :3] += 0.5 * np.sinc(angle / (2.0 * np.pi)) ** 2 * (K @ K)
    out[..., :3, 3] = shift
    out[..., 3, 3] = 1.0
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


def rotation_vector(R: np.ndarray) -> np.ndarray:
    """Rotation vectors (..., 3) of rotations (..., 3, 3) below 180 deg."""
    twice_axis = np.stack(
        [R[..., 2, 1] - R[..., 1, 2], R[..., 0, 2] - R[..., 2, 0], R[..., 1, 0] - R[..., 0, 1]], -1
    )
    sine = 0.5 * np.linalg.norm(twice_axis, axis=-1)
    angle = np.arctan2(sine, 0.5 * (np.trace(R, axis1=-2, axis2=-1) - 1.0))
    return (
        0.5 * twice_axis * (angle / np.where(sine > 1e-12, sine, 1.0) + (sine <= 1e-12))[..., None]
    )


def misclosure(T: np.ndarray, hand_up: np.ndarray = UPRIGHT) -> np.ndarray:
    """Closure errors of the loops of `frames`: rotation vectors over positions (m, 6)."""
    return np.concatenate((rotation_vector(T[:, 9, :3, :3] @ hand_up.T), T[:, 9, :3, 3]), axis=-1)


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

    def error(self, angles, **displaced) -> np.ndarray:
        """Misclosure in the constrained components, (m, rows)."""
        T = frames(self.chain, angles, **displaced)
        return misclosure(T, FLIPPED if self.upside_down else UPRIGHT)[:, self.rows]

    def closed(self, angles, *, free: tuple[int, ...], rounds: int = 60, **displaced):
        """Close poses (m, 8) by moving the `free` joints (0 is the hinge): angles, and which closed to `CLOSED`.

        Newton's method, with steps of at most 0.3 rad.
        """
        angles, free = np.array(angles, dtype=float), list(free)
        last = np.inf
        for _ in range(rounds):
            T = frames(self.chain, angles, **displaced)
            error = misclosure(T, FLIPPED if self.upside_down else UPRIGHT)[:, self.rows]
            worst = np.abs(error).max()
            if worst < 1e-15 or (worst < 1e-13 and worst >= last):
                break
            last = worst
            J = screws(T)[:, self.rows][:, :, free]
            step = -(np.linalg.pinv(J, rcond=1e-9) @ error[..., None])[..., 0]
            longest = np.maximum(np.abs(step).max(axis=-1, keepdims=True), 1e-300)
            angles[:, free] += step * np.minimum(1.0, 0.3 / longest)
        return angles, np.abs(self.error(angles, **displaced)).max(axis=-1) < CLOSED
