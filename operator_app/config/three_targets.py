"""The pose of a hand from three targets on it: columns ``x1_m,y1_m,z1_m`` to ``x3_m,y3_m,z3_m`` of a poses file.

An instrument that measures points only measures a pose by three of them. Where each sits on the hand need not be
known: what the poses have in common is their triangle, which is the mean over all poses. Its frame has its origin
in the centroid, x towards target 1, and z normal to the triangle (targets 1, 2, 3 counter-clockwise). With a standard
deviation of s in each coordinate and sides of length a the origin has s / sqrt(3), a rotation about a line in the
triangle's plane sqrt(2) s / a, and one about its normal s / a.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from operator_app.units.figure import LENGTH, Figure
from solver.arrays import FloatArray
from solver.chain.rotations import rotation_vector

TARGETS = tuple(f"{axis}{k}_m" for k in (1, 2, 3) for axis in "xyz")

LEAST_HEIGHT_M = 0.01
"""Height of the triangle below which its targets are nearly in line: rotations about that line are not seen."""

MOST_OFF_M, MOST_OFF_SPREADS = 1e-3, 8.0
"""A pose whose targets are farther than both from the common triangle, in metres and in the usual distance, has one
that moved or two that were exchanged."""

ROUNDS = 5
"""Of turning all triangles onto their mean; the second changes it by the square of the noise."""


def poses_of_targets(points_m: FloatArray, labels: Sequence[str]) -> FloatArray:
    """Positions (m) and rotation vectors (rad) of the triangles of three points, (m, 6) from (m, 9).

    Raises
    ------
    ValueError
        The triangle is nearly a line, or that of a pose differs from the others; names the pose.
    """
    points = points_m.reshape(-1, 3, 3)
    centroid = points.mean(axis=1)
    seen = points - centroid[:, None, :]
    shape = seen[0]
    _require_a_triangle(shape)
    for _ in range(ROUNDS):
        shape = (seen @ _turns(shape, seen)).mean(axis=0)
    turns = _turns(shape, seen)
    _require_the_same(np.linalg.norm(seen @ turns - shape, axis=-1).max(axis=1), labels)
    return np.concatenate((centroid, rotation_vector(turns @ _frame(shape))), axis=1)


def _turns(shape: FloatArray, seen: FloatArray) -> FloatArray:
    """Rotations (m, 3, 3) that turn a triangle (3, 3), a row a point, nearest to those seen (Kabsch)."""
    U, _, Vt = np.linalg.svd(np.swapaxes(seen, -1, -2) @ shape)
    U[..., 2] *= np.linalg.det(U @ Vt)[:, None]
    return np.asarray(U @ Vt)


def _frame(shape: FloatArray) -> FloatArray:
    """Axes x, y, z (columns) of the frame of a triangle about its centroid, (3, 3)."""
    x = shape[0] / np.linalg.norm(shape[0])
    z = np.cross(shape[0], shape[1])
    z = z / np.linalg.norm(z)
    return np.column_stack((x, np.cross(z, x), z))


def _require_a_triangle(points: FloatArray) -> None:
    longest = float(np.linalg.norm(points - np.roll(points, -1, axis=0), axis=1).max())
    area = float(np.linalg.norm(np.cross(points[1] - points[0], points[2] - points[0]))) / 2.0
    if 2.0 * area < LEAST_HEIGHT_M * longest or longest == 0.0:
        shown = Figure(2.0 * area / longest if longest else 0.0, LENGTH, places=1).with_unit
        least = Figure(LEAST_HEIGHT_M, LENGTH, places=0).with_unit
        raise ValueError(
            f"the three targets are nearly in line: their triangle is {shown} high, and less than {least} "
            "shows no orientation: move one of them away from the line through the others"
        )


def _require_the_same(off_m: FloatArray, labels: Sequence[str]) -> None:
    k = int(np.argmax(off_m))
    if off_m[k] > max(MOST_OFF_M, MOST_OFF_SPREADS * float(np.median(off_m))):
        shown = Figure(float(off_m[k]), LENGTH, places=1).with_unit
        raise ValueError(
            f"pose {labels[k]}: its targets are {shown} off the triangle of the other poses: one moved, or two "
            "were exchanged"
        )
