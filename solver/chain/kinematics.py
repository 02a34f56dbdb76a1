"""Kinematics of a Denavit-Hartenberg chain and its exact Jacobians, for all poses at once.

Distal convention (paper, Figure 1): ``A_j = Rz(theta_j) Tz(s_j) Tx(a_j) Rx(alpha_j) Ry(beta_j)`` takes
frame j-1 to frame j. beta is zero unless z_{j-1} and z_j are parallel: then their common normal and s_j are not unique,
and Hayati's beta_j (reference [9] of the paper) takes the place of s_j.

A chain of L links has L+1 frames. Frame 0 of the arrays below is the frame in which the chain starts: for a hinge loop,
whose first link is link 0, the paper's frame -1.

The last axis of every parameter array counts links. Leading axes (starts, poses, ...) broadcast, so one parameter row
serves many poses and many starts are evaluated in one call.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass, field

import numpy as np

from solver.arrays import FloatArray, IntArray, frozen
from solver.chain.parameters import DhKind


@dataclass(frozen=True, slots=True, kw_only=True)
class DhTable:
    """Constants of a chain: one entry per link, shape (links,).

    `theta_off_rad`: joint-angle offsets, ``theta' = theta + theta_off`` (paper, section 2.1).
    `s_m`, `a_m`: offsets along z_{j-1}, and lengths along x_j.
    `alpha_rad`, `beta_rad`: twists about x_j, and Hayati's twists about y_j (zeros by default).
    """

    theta_off_rad: FloatArray
    s_m: FloatArray
    a_m: FloatArray
    alpha_rad: FloatArray
    beta_rad: FloatArray = field(default_factory=lambda: np.zeros(0))

    def __post_init__(self) -> None:
        if not len(self.beta_rad):
            object.__setattr__(self, "beta_rad", np.zeros(np.shape(self.theta_off_rad)))
        for name in self.__dataclass_fields__:
            object.__setattr__(self, name, frozen(getattr(self, name)))
        if len({getattr(self, name).shape for name in self.__dataclass_fields__}) != 1:
            raise ValueError("the columns of a D-H table must have one entry per link each")

    @classmethod
    def from_stacked(cls, rows: FloatArray) -> DhTable:
        """Build the table from an array (5, links) as returned by `stacked`."""
        return cls(**dict(zip(cls.__dataclass_fields__, rows, strict=True)))

    @property
    def links(self) -> int:
        """Number of links (rows)."""
        return int(self.theta_off_rad.shape[0])

    def stacked(self) -> FloatArray:
        """Return the table as (5, links), in the order of `DhKind`: theta_off, s, a, alpha, beta."""
        return np.stack([getattr(self, name) for name in self.__dataclass_fields__])

    def frames(self, q: FloatArray) -> Frames:
        """Return all frames at readings `q` (..., links), rad."""
        return forward(q + self.theta_off_rad, *self.stacked()[1:])


@dataclass(frozen=True, slots=True, kw_only=True)
class Frames:
    """All frames of a chain, expressed in its first frame.

    The last axes of the stored arrays are the poses: every step along a chain is then one pass over contiguous numbers,
    several times as fast as over (..., 3, 3). The properties are views with the poses first.

    `axes_of`: (links + 1, 3, 3, ...): the axes x, y and z of every frame, then the three components of each axis.
    `origin_of`: (links + 1, 3, ...): origins, m.
    `normal_of`: (links + 1, 3, ...): axis of a_j and alpha_j (x_j before the rotation by beta_j); None without a beta.
    """

    axes_of: FloatArray
    origin_of: FloatArray
    normal_of: FloatArray | None = None

    @property
    def axes(self) -> FloatArray:
        """Axes (..., links + 1, 3, 3); ``axes[..., k, :, 0]`` is x, ``[..., 1]`` y, ``[..., 2]`` z of frame k."""
        return poses_first(self.axes_of, 0, 2, 1)

    @property
    def normals(self) -> FloatArray:
        """Axes of a_j and alpha_j (..., links + 1, 3): x_j before the rotation by beta_j."""
        return poses_first(self.axes_of[:, 0] if self.normal_of is None else self.normal_of, 0, 1)

    @property
    def origins_m(self) -> FloatArray:
        """Origins of all frames, m, shape (..., links + 1, 3)."""
        return poses_first(self.origin_of, 0, 1)

    @property
    def R_end(self) -> FloatArray:
        """Rotation of the last frame, shape (..., 3, 3)."""
        return poses_first(self.axes_of[-1], 1, 0)

    @property
    def p_end(self) -> FloatArray:
        """Origin of the last frame in metres, shape (..., 3)."""
        return poses_first(self.origin_of[-1], 0)


def forward(
    theta: FloatArray,
    s: FloatArray,
    a: FloatArray,
    alpha: FloatArray,
    beta: FloatArray | None = None,
) -> Frames:
    """Compute every frame of the chain (paper, eqs. 1 and 2).

    `theta`, `s`, `a`, `alpha`, `beta`: actual joint angles theta' (rad), offsets (m), lengths (m) and twists (rad),
    shapes that broadcast to (..., links).
    """
    if beta is not None and not np.any(beta):
        beta = None
    *lead, links = np.broadcast(theta, s, a, alpha).shape
    theta, s, a, alpha = (_links_first(v, len(lead)) for v in (theta, s, a, alpha))
    c_theta, s_theta, c_alpha, s_alpha = np.cos(theta), np.sin(theta), np.cos(alpha), np.sin(alpha)
    # Rotation of each link, all links at once: x, then y and z, row by row.
    turn = np.zeros((links, 3, 3, *lead))
    turn[:, 0, 0], turn[:, 0, 1] = c_theta, s_theta
    turn[:, 1, 0], turn[:, 1, 1], turn[:, 1, 2] = -c_alpha * s_theta, c_alpha * c_theta, s_alpha
    turn[:, 2, 0], turn[:, 2, 1], turn[:, 2, 2] = s_alpha * s_theta, -s_alpha * c_theta, c_alpha
    if beta is not None:
        beta = _links_first(beta, len(lead))[:, None]
        c_beta, s_beta = np.cos(beta), np.sin(beta)
        normal, z = turn[:, 0].copy(), turn[:, 2].copy()
        turn[:, 0] = c_beta * normal - s_beta * z
        turn[:, 2] = s_beta * normal + c_beta * z
    axes = np.empty((links + 1, 3, 3, *lead))
    origins = np.empty((links + 1, 3, *lead))
    axes[0] = np.eye(3).reshape(3, 3, *(1 for _ in lead))
    axes[1] = turn[0]
    origins[0] = 0.0
    # A loop over the few links, never over poses.
    for j in range(1, links):
        np.einsum("ab...,bc...->ac...", turn[j], axes[j], out=axes[j + 1])
    # p_j - p_{j-1} = s_j z_{j-1} + a_j x_j (eqs. 1 and 9), x_j as it is before beta_j.
    along = s[:, None] * axes[:-1, 2]
    if beta is None:
        normals, along_normal = None, axes[1:, 0]
    else:
        normals = axes[:, 0].copy()
        along_normal = normals[1:]
        along_normal[...] = c_beta * axes[1:, 0] + s_beta * axes[1:, 2]
    along += a[:, None] * along_normal
    for j in range(links):
        np.add(origins[j], along[j], out=origins[j + 1])
    return Frames(axes_of=axes, origin_of=origins, normal_of=normals)


_AXIS = np.array([{DhKind.A: 0, DhKind.ALPHA: 0, DhKind.BETA: 1}.get(kind, 2) for kind in DhKind])
_TURNS = np.array([kind.is_angle for kind in DhKind])
"""`_AXIS` (5,): index of the axis along which (lengths) or about which (angles) each `DhKind` moves the links after it:
x (0) or y (1) of the frame after the link, or z (2) of the frame before the link. `_TURNS` (5,): whether each `DhKind`
is an angle."""


@dataclass(frozen=True, slots=True, eq=False)
class Entries:
    """The axes about which (angles) or along which (lengths) C entries of a D-H table move the links after them.

    `frame`, `axis` (C,): index of the frame to which each axis belongs, and of the axis in this frame (0 for x, 1 for
    y, 2 for z). `turning`, `sliding`: indices of the entries that are angles, and of those that are lengths.
    """

    frame: IntArray
    axis: IntArray
    turning: IntArray
    sliding: IntArray

    @classmethod
    def of(cls, kinds: Sequence[int], rows: Sequence[int]) -> Entries:
        """Return the entries with column ``kinds[i]`` (`DhKind`) and row ``rows[i]``; row 0 is the first link."""
        kind = np.array(kinds, dtype=np.int64)
        axis, turns = _AXIS[kind], _TURNS[kind]
        return cls(
            frame=np.array(rows, dtype=np.int64) + (axis != 2),
            axis=axis,
            turning=np.flatnonzero(turns),
            sliding=np.flatnonzero(~turns),
        )


NO_ENTRIES = Entries.of((), ())


def jacobian(frames: Frames, entries: Entries) -> FloatArray:
    """Jacobian (..., 6, C) of the last frame's rotation (rad) and position (m) with respect to `entries`."""
    return np.ascontiguousarray(poses_first(screws(frames, entries), 1, 0))


def screws(frames: Frames, entries: Entries) -> FloatArray:
    """Return the motion (C, 6, ...) of the last frame per unit change of each D-H entry, in the chain's first frame.

    Each motion is a screw: the last frame's infinitesimal rotation (rad), then the translation (m) of its origin p_e.

    theta_j: (z_{j-1}, z_{j-1} x (p_e - p_{j-1})); s_j: (0, z_{j-1}); a_j: (0, x_j); alpha_j: (x_j, x_j x (p_e - p_j));
    beta_j: (y_j, y_j x (p_e - p_j)). For a_j and alpha_j, x_j is the axis before the rotation by beta_j.
    """
    p, turning, sliding = frames.origin_of, entries.turning, entries.sliding
    axis = frames.axes_of[entries.frame, entries.axis]
    if frames.normal_of is not None:
        of_x = np.flatnonzero(entries.axis == 0)
        axis[of_x] = frames.normal_of[entries.frame[of_x]]
    columns = np.zeros((len(axis), 6, *axis.shape[2:]))
    columns[sliding, 3:] = axis[sliding]
    about, lever = axis[turning], p[-1] - p[entries.frame[turning]]
    columns[turning, :3] = about
    for k, (i, j) in enumerate(((1, 2), (2, 0), (0, 1)), start=3):
        columns[turning, k] = about[:, i] * lever[:, j] - about[:, j] * lever[:, i]
    return columns


def _links_first(values: FloatArray, dims: int) -> FloatArray:
    broadcast = values.reshape((1,) * (dims + 1 - values.ndim) + values.shape)
    return np.ascontiguousarray(broadcast.transpose(dims, *range(dims)))


def poses_first(values: FloatArray, *order: int) -> FloatArray:
    """Return a view with the pose axes, which are last, moved to the front; the other axes follow in `order`."""
    return values.transpose(*range(len(order), values.ndim), *order)
