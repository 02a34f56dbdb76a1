"""Rotation vectors and their exact differentials, accurate from zero to pi."""

import numpy as np

from solver.arrays import FloatArray


def skew(v: FloatArray) -> FloatArray:
    """Return [v]x with ``skew(v) @ w == cross(v, w)``; shape (..., 3) to (..., 3, 3)."""
    out = np.zeros((*v.shape, 3))
    out[..., 0, 1], out[..., 0, 2] = -v[..., 2], v[..., 1]
    out[..., 1, 0], out[..., 1, 2] = v[..., 2], -v[..., 0]
    out[..., 2, 0], out[..., 2, 1] = -v[..., 1], v[..., 0]
    return out


def rotation_vector(R: FloatArray) -> FloatArray:
    """Logarithm of rotations, shape (..., 3, 3) to (..., 3), rad, length in [0, pi].

    The logarithm is computed from the unit quaternion, the largest component of which is calculated from the diagonal
    of R. This keeps full precision at zero and near pi, where trace and antisymmetric part of R lose precision.
    """
    d = np.diagonal(R, axis1=-2, axis2=-1)
    trace = d.sum(-1)
    # Rows of the symmetric 4 x 4 matrix 4 q q' (w, x, y, z), each computable without cancellation.
    q = np.stack(
        (
            1.0 + trace,
            R[..., 2, 1] - R[..., 1, 2],
            R[..., 0, 2] - R[..., 2, 0],
            R[..., 1, 0] - R[..., 0, 1],
        ),
        axis=-1,
    )
    far = trace < d.max(-1) * 2.0 - trace
    if far.any():
        q[far] = _largest_row(R[far], q[far])
    q = q / np.linalg.norm(q, axis=-1, keepdims=True)
    q = np.where(q[..., :1] < 0.0, -q, q)
    vector = q[..., 1:]
    sine = np.linalg.norm(vector, axis=-1, keepdims=True)
    angle = 2.0 * np.arctan2(sine, q[..., :1])
    small = sine < 1e-150
    return np.asarray(vector * np.where(small, 2.0, angle / np.where(small, 1.0, sine)))


def _largest_row(R: FloatArray, w: FloatArray) -> FloatArray:
    """Return a row (m, 4) of ``4 q q'``, which is a multiple of the unit quaternion q of each rotation `R` (m, 3, 3).

    Of rows 1 to 3 of this matrix, it is the one with the largest diagonal element. `w` (m, 4): row 0 of the matrix.
    """
    d = np.diagonal(R, axis1=-2, axis2=-1)
    k, every = np.argmax(d, axis=-1), np.arange(len(R))
    row = np.empty_like(w)
    row[:, 0] = w[every, k + 1]
    row[:, 1:] = R[every, k] + R[every, :, k]
    row[every, k + 1] = 1.0 - d.sum(-1) + 2.0 * d[every, k]
    return row


def rotation_vector_differential(r: FloatArray) -> FloatArray:
    """Return the matrix E that maps a small rotation w in the fixed frame to the change of the rotation vector `r`.

    With ``R = exp([r]x)`` and ``dR = [w]x R``: ``dr = E w``. Shape (..., 3) to (..., 3, 3). E is the inverse of the
    left Jacobian of SO(3), singular only at a full turn.
    """
    angle = np.linalg.norm(r, axis=-1)
    half = 0.5 * angle
    tiny = angle < 1e-4
    safe = np.where(tiny, 1.0, angle)
    # (1 - (angle/2) cot(angle/2)) / angle^2, whose series starts 1/12 + angle^2/720.
    factor = np.where(
        tiny,
        1.0 / 12.0 + angle**2 / 720.0,
        (1.0 - half * np.cos(half) / np.where(tiny, 1.0, np.sin(half))) / safe**2,
    )
    # [r]x [r]x = r r' - angle^2.
    outer = (factor[..., None] * r)[..., None] * r[..., None, :]
    return np.asarray(
        (1.0 - factor * angle**2)[..., None, None] * np.eye(3) - 0.5 * skew(r) + outer
    )


def rotation_matrix(r: FloatArray) -> FloatArray:
    """Rotation (..., 3, 3) about the vector `r` (..., 3) by the length of `r`, rad: ``exp([r]x)``."""
    angle = np.linalg.norm(r, axis=-1)[..., None, None]
    K = skew(r)
    # sinc keeps both quotients exact down to zero: sin(t)/t and (1 - cos t)/t^2 = sinc(t/2)^2 / 2.
    first = np.sinc(angle / np.pi)
    second = 0.5 * np.sinc(0.5 * angle / np.pi) ** 2
    return np.asarray(np.eye(3) + first * K + second * (K @ K))


def nearest_rotation(M: FloatArray) -> FloatArray:
    """Rotation nearest to each matrix (..., 3, 3): least sum of squared differences of the elements (Kabsch)."""
    U, _, Vt = np.linalg.svd(M)
    U[..., 2] *= np.linalg.det(U @ Vt)[..., None]
    return np.asarray(U @ Vt)


def rotation_about_x(angle_rad: float) -> FloatArray:
    """Rotation (3, 3) about x by an angle."""
    c, s = np.cos(angle_rad), np.sin(angle_rad)
    return np.array([[1.0, 0.0, 0.0], [0.0, c, -s], [0.0, s, c]])


def rotation_about_z(angle_rad: FloatArray | float) -> FloatArray:
    """Rotations (..., 3, 3) about z by angles (...)."""
    out = np.zeros((*np.shape(angle_rad), 3, 3))
    out[..., 0, 0] = out[..., 1, 1] = np.cos(angle_rad)
    out[..., 1, 0] = np.sin(angle_rad)
    out[..., 0, 1] = -out[..., 1, 0]
    out[..., 2, 2] = 1.0
    return out
