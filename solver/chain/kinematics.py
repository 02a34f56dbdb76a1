"""Kinematics of a Denavit-Hartenberg chain and its exact Jacobians, for all poses at once. Knows no loop.

Distal convention (paper, Figure 1): ``A_j = Rz(theta_j) Tz(s_j) Tx(a_j) Rx(alpha_j)`` takes frame
j-1 to frame j. A chain of L links has L+1 frames; frame 0 of the arrays below is the frame in which
the chain starts (the paper's frame -1 for a hinge loop, whose first link is link 0).

Every array may have leading axes (starts, poses, ...) before the last one, which counts links; they
broadcast, so one parameter row serves many poses and many starts are evaluated in one call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray, frozen
from solver.chain.parameters import DhKind


@dataclass(frozen=True, slots=True, kw_only=True)
class DhTable:
    """Constants of a chain: one entry per link, shape (links,).

    Attributes
    ----------
    theta_off_rad
        Joint-angle offsets: ``theta' = theta + theta_off`` (paper, section 2.1).
    s_m, a_m
        Offsets along z_{j-1} and lengths along x_j.
    alpha_rad
        Twists about x_j.
    """

    theta_off_rad: FloatArray
    s_m: FloatArray
    a_m: FloatArray
    alpha_rad: FloatArray

    def __post_init__(self) -> None:
        for name in ("theta_off_rad", "s_m", "a_m", "alpha_rad"):
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if len({a.shape for a in (self.theta_off_rad, self.s_m, self.a_m, self.alpha_rad)}) != 1:
            raise ValueError("the four columns of a D-H table must have one entry per link each")

    @property
    def links(self) -> int:
        """Number of links (rows)."""
        return int(self.theta_off_rad.shape[0])

    def stacked(self) -> FloatArray:
        """Return the table as (4, links): theta_off, s, a, alpha."""
        return np.stack((self.theta_off_rad, self.s_m, self.a_m, self.alpha_rad))


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """All frames of a chain seen in its first frame.

    Poses are last in memory: every step along a chain is then one pass over contiguous numbers, several
    times as fast as over (..., 3, 3). The properties are views of that with the poses first.

    Attributes
    ----------
    axes_of
        (links + 1, 3, 3, ...): of every frame x, y and z, each by its three components.
    origin_of
        (links + 1, 3, ...), m.
    """

    axes_of: FloatArray
    origin_of: FloatArray

    @property
    def axes(self) -> FloatArray:
        """Shape (..., links + 1, 3, 3); ``axes[..., k, :, 0]`` is x, ``[..., 1]`` y, ``[..., 2]`` z of frame k."""
        return poses_first(self.axes_of, 0, 2, 1)

    @property
    def origins_m(self) -> FloatArray:
        """Shape (..., links + 1, 3)."""
        return poses_first(self.origin_of, 0, 1)

    @property
    def R_end(self) -> FloatArray:
        """Rotation of the last frame, shape (..., 3, 3)."""
        return poses_first(self.axes_of[-1], 1, 0)

    @property
    def p_end(self) -> FloatArray:
        """Origin of the last frame in metres, shape (..., 3)."""
        return poses_first(self.origin_of[-1], 0)


def forward(theta: FloatArray, s: FloatArray, a: FloatArray, alpha: FloatArray) -> Frames:
    """Compute every frame of the chain (paper, eqs. 1 and 2).

    Parameters
    ----------
    theta, s, a, alpha
        Actual joint angles theta' (rad), offsets (m), lengths (m) and twists (rad), shapes that
        broadcast to (..., links).
    """
    *lead, links = np.broadcast(theta, s, a, alpha).shape
    theta, s, a, alpha = (_links_first(v, len(lead)) for v in (theta, s, a, alpha))
    c_theta, s_theta, c_alpha, s_alpha = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    # What each link makes of the axes before it, all links at once: x, then y and z, row by row.
    turn = np.zeros((links, 3, 3, *lead))
    turn[:, 0, 0], turn[:, 0, 1] = c_theta, s_theta
    turn[:, 1, 0], turn[:, 1, 1], turn[:, 1, 2] = -c_alpha * s_theta, c_alpha * c_theta, s_alpha
    turn[:, 2, 0], turn[:, 2, 1], turn[:, 2, 2] = s_alpha * s_theta, -s_alpha * c_theta, c_alpha
    axes = np.empty((links + 1, 3, 3, *lead))
    origins = np.empty((links + 1, 3, *lead))
    axes[0] = np.eye(3).reshape(3, 3, *(1 for _ in lead))
    axes[1] = turn[0]
    origins[0] = 0.0
    # Loops over links (eight of them), never over poses.
    for j in range(1, links):
        np.einsum("ab...,bc...->ac...", turn[j], axes[j], out=axes[j + 1])
    # p_j - p_{j-1} = s_j z_{j-1} + a_j x_j (eqs. 1 and 9).
    along = s[:, None] * axes[:-1, 2]
    along += a[:, None] * axes[1:, 0]
    for j in range(links):
        np.add(origins[j], along[j], out=origins[j + 1])
    return Frames(axes_of=axes, origin_of=origins)


_OF_X = np.array([kind in (DhKind.A, DhKind.ALPHA) for kind in DhKind])
_TURNS = np.array([kind.is_angle for kind in DhKind])
"""Which kinds (4,) of entries move what follows along or about x, and which are angles."""


@dataclass(frozen=True, slots=True, eq=False)
class Entries:
    """D-H entries whose screws are wanted, in their order, sorted once by where they act.

    Attributes
    ----------
    frame, axis
        Frame and axis (C,), x 0 or z 2, about or along which each entry moves what follows.
    turning, sliding
        Which of them are angles, and which are lengths.
    """

    frame: IntArray
    axis: IntArray
    turning: IntArray
    sliding: IntArray

    @classmethod
    def of(cls, kinds: Sequence[int], rows: Sequence[int]) -> Entries:
        """Entries `kinds` (`DhKind`) of links `rows`, 0 the first of the chain."""
        kind = np.array(kinds, dtype=np.int64)
        of_x, turns = _OF_X[kind], _TURNS[kind]
        return cls(
            frame=np.array(rows, dtype=np.int64) + of_x,
            axis=np.where(of_x, 0, 2),
            turning=np.flatnonzero(turns),
            sliding=np.flatnonzero(~turns),
        )


NO_ENTRIES = Entries.of((), ())


def jacobian(frames: Frames, entries: Entries) -> FloatArray:
    """Screw Jacobian of the last frame for some D-H entries, shape (..., 6, C): `screws`, poses first."""
    return np.ascontiguousarray(poses_first(screws(frames, entries), 1, 0))


def screws(frames: Frames, entries: Entries) -> FloatArray:
    """How the last frame moves with each of some D-H entries.

    Returns
    -------
    Array of shape (C, 6, ...): the infinitesimal rotation (rad) over the translation (m) of the end
    point, seen in the chain's first frame.

    Notes
    -----
    theta_j: (z_{j-1}, z_{j-1} x (p_e - p_{j-1})); s_j: (0, z_{j-1}); a_j: (0, x_j);
    alpha_j: (x_j, x_j x (p_e - p_j)).
    """
    p, turning, sliding = frames.origin_of, entries.turning, entries.sliding
    axis = frames.axes_of[entries.frame, entries.axis]
    columns = np.zeros((len(axis), 6, *axis.shape[2:]))
    columns[sliding, 3:] = axis[sliding]
    about, lever = axis[turning], p[-1] - p[entries.frame[turning]]
    columns[turning, :3] = about
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1)), start=3):
        columns[turning, k] = about[:, i] * lever[:, j] - about[:, j] * lever[:, i]
    return columns


def _links_first(values: FloatArray, dims: int) -> FloatArray:
    whole = values.reshape((1,) * (dims + 1 - values.ndim) + values.shape)
    return np.ascontiguousarray(whole.transpose(dims, *range(dims)))


def poses_first(values: FloatArray, *order: int) -> FloatArray:
    """View with the leading axes, in the order given, after those of the poses."""
    return values.transpose(*range(len(order), values.ndim), *order)
