"""Kinematics of a Denavit-Hartenberg chain and its exact Jacobians, for all poses at once. Knows no loop.

Distal convention (paper, Figure 1): ``A_j = Rz(theta_j) Tz(s_j) Tx(a_j) Rx(alpha_j)`` takes frame
j-1 to frame j. A chain of L links has L+1 frames; frame 0 of the arrays below is the frame in which
the chain starts (the paper's frame -1 for a hinge loop, whose first link is link 0).

Every array may have leading axes (starts, poses, ...) before the last one, which counts links; they
broadcast, so one parameter row serves many poses and many starts are evaluated in one call.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, frozen


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

    Attributes
    ----------
    axes
        Shape (..., links + 1, 3, 3); ``axes[..., k, :, 0]`` is x, ``[..., 1]`` y, ``[..., 2]`` z of frame k.
    origins_m
        Shape (..., links + 1, 3).
    """

    axes: FloatArray
    origins_m: FloatArray

    @property
    def R_end(self) -> FloatArray:
        """Rotation of the last frame, shape (..., 3, 3)."""
        return self.axes[..., -1, :, :]

    @property
    def p_end(self) -> FloatArray:
        """Origin of the last frame in metres, shape (..., 3)."""
        return self.origins_m[..., -1, :]


def forward(theta: FloatArray, s: FloatArray, a: FloatArray, alpha: FloatArray) -> Frames:
    """Compute every frame of the chain (paper, eqs. 1 and 2).

    Parameters
    ----------
    theta, s, a, alpha
        Actual joint angles theta' (rad), offsets (m), lengths (m) and twists (rad), shapes that
        broadcast to (..., links).
    """
    theta, s, a, alpha = np.broadcast_arrays(theta, s, a, alpha)
    *lead, links = theta.shape
    c_theta, s_theta = np.cos(theta)[..., None], np.sin(theta)[..., None]
    c_alpha, s_alpha = np.cos(alpha)[..., None], np.sin(alpha)[..., None]
    axes = np.empty((*lead, links + 1, 3, 3))
    origins = np.empty((*lead, links + 1, 3))
    axes[..., 0, :, :] = np.eye(3)
    origins[..., 0, :] = 0.0
    # A loop over links (eight of them), never over poses.
    for j in range(links):
        x, y, z = (axes[..., j, :, k] for k in range(3))
        c, sn, ca, sa = (v[..., j, :] for v in (c_theta, s_theta, c_alpha, s_alpha))
        x_j = c * x + sn * y
        y_mid = c * y - sn * x
        axes[..., j + 1, :, 0] = x_j
        axes[..., j + 1, :, 1] = ca * y_mid + sa * z
        axes[..., j + 1, :, 2] = ca * z - sa * y_mid
        origins[..., j + 1, :] = origins[..., j, :] + s[..., j, None] * z + a[..., j, None] * x_j
    return Frames(axes=axes, origins_m=origins)


def jacobian(frames: Frames) -> FloatArray:
    """Screw Jacobian of the last frame for every D-H entry of every link.

    Returns
    -------
    Array of shape (..., 6, 4, links): rows are the infinitesimal rotation (rad) over the translation
    (m) of the end point, seen in the chain's first frame; the third axis is theta, s, a, alpha.

    Notes
    -----
    theta_j: (z_{j-1}, z_{j-1} x (p_e - p_{j-1})); s_j: (0, z_{j-1}); a_j: (0, x_j);
    alpha_j: (x_j, x_j x (p_e - p_j)).
    """
    z = frames.axes[..., :-1, :, 2]
    x = frames.axes[..., 1:, :, 0]
    p = frames.origins_m
    end = p[..., -1:, :]
    columns = np.zeros((*z.shape[:-2], 6, 4, z.shape[-2]))

    def put(rows: slice, kind: int, values: FloatArray) -> None:
        columns[..., rows, kind, :] = np.swapaxes(values, -1, -2)

    rotation, translation = slice(0, 3), slice(3, 6)
    put(rotation, 0, z)
    put(translation, 0, np.cross(z, end - p[..., :-1, :]))
    put(translation, 1, z)
    put(translation, 2, x)
    put(rotation, 3, x)
    put(translation, 3, np.cross(x, end - p[..., 1:, :]))
    return columns
