"""A reading that seems wrong in every pose may have shifted once: the loops without it say when and by how much.

Where a fit has gone astray no step can be seen in what it left over. Without the joint's reading the
loops measure the joint's angle, and the reading less that angle is a constant, then another. Knows
angles and poses; solves nothing and has no words.
"""

from __future__ import annotations

from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import wrap_angle
from solver.diagnostics.limits import STEP_EDGE_POSES, STEP_RESIDUAL_SHARE

BENDS = 3
"""Degree of the curve that a sensor has besides."""


class ReadingStep(NamedTuple):
    """What was added to a reading (rad) from pose `first` on, index in time order."""

    first: int
    size_rad: float


def shift_of(reading_rad: FloatArray, angle_rad: FloatArray) -> ReadingStep | None:
    """Return how a joint's readings (m,) shifted against its angles (m,) as the loops have them, rad.

    Poses are in the order in which they were taken. None where a smooth curve explains it nearly as well.
    """
    m = len(reading_rad)
    if m < 2 * (STEP_EDGE_POSES + BENDS):
        return None
    off = wrap_angle(reading_rad - angle_rad)
    off = wrap_angle(off - off[0])
    x = angle_rad - angle_rad.mean()
    curve = np.linalg.qr(np.polynomial.polynomial.polyvander(x / np.abs(x).max(), BENDS))[0]
    left = off - curve @ (curve.T @ off)
    steps = np.tril(np.ones((m, m)))[:, STEP_EDGE_POSES : m - STEP_EDGE_POSES + 1]
    free = steps - curve @ (curve.T @ steps)
    square = np.maximum((free**2).sum(axis=0), 1e-12)
    along = left @ free
    k = int(np.argmax(along**2 / square))
    if float(left @ left - along[k] ** 2 / square[k]) > STEP_RESIDUAL_SHARE * float(left @ left):
        return None
    return ReadingStep(first=k + STEP_EDGE_POSES, size_rad=float(along[k] / square[k]))
