"""Radians to degrees for files, so that reading them back gives the same radians. Knows no file.

A file holds decimal degrees and is read with ``np.deg2rad``. Degrees and radians are not equally
dense, so not every double in radians has a double in degrees; where it has one, it is found.
"""

from __future__ import annotations

import numpy as np

from solver.arrays import FloatArray


def degrees_for_file(angle_rad: FloatArray | float) -> FloatArray:
    """Degrees whose ``np.deg2rad`` is exactly `angle_rad` where such a double exists, else nearest.

    Of several, the one with the fewest digits. Angles that came from a file in degrees always have
    one; so writing what was read, and reading it again, changes no bit.
    """
    wanted = np.asarray(angle_rad, dtype=np.float64)
    degrees = [_degrees(float(value)) for value in wanted.reshape(-1)]
    return np.array(degrees, dtype=np.float64).reshape(wanted.shape)


def _degrees(wanted_rad: float) -> float:
    near = float(np.rad2deg(wanted_rad))
    for digits in (12, 15):
        short = float(f"{near:.{digits}g}")
        if float(np.deg2rad(short)) == wanted_rad:
            return short
    steps = [near]
    for direction in (-np.inf, np.inf):
        step = near
        for _ in range(4):
            step = float(np.nextafter(step, direction))
            steps.append(step)
    return min(steps, key=lambda deg: abs(float(np.deg2rad(deg)) - wanted_rad))


def short_degrees(angle_rad: FloatArray) -> list[float]:
    """Angles (n,) that are only proposed: to a millionth of a degree, as somebody copies them into a file."""
    return [round(angle, 6) + 0.0 for angle in np.rad2deg(angle_rad).tolist()]
