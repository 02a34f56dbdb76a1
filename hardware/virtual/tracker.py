"""Simulated tracker of the virtual open arm, with the line protocol of instruments.

It answers ``{"measure": "12"}`` with ``{"pose": "12", "x_m": ..., ..., "rz_deg": ...}``: position of the target in its
own frame, and orientation as a rotation vector.
"""

from __future__ import annotations

import json
import math
import threading
from collections.abc import Callable

import numpy as np

from hardware.virtual.truth import OpenTruth
from solver.arrays import FloatArray
from solver.chain.rotations import rotation_matrix, rotation_vector

FIELDS = ("x_m", "y_m", "z_m", "rx_deg", "ry_deg", "rz_deg")


class SimulatedTracker:
    """Measures the target of an arm's truth.

    Parameters
    ----------
    angles_rad
        Returns the true joint angles theta' (n,) of the moment.
    sigma_m, sigma_rad, rng
        Noise of each component.
    full_pose
        Whether it measures orientation too.
    """

    def __init__(
        self,
        truth: OpenTruth,
        angles_rad: Callable[[], FloatArray],
        *,
        sigma_m: float,
        sigma_rad: float,
        full_pose: bool,
        rng: np.random.Generator,
    ) -> None:
        self._truth, self._angles = truth, angles_rad
        self._sigma_m, self._sigma_rad = sigma_m, sigma_rad
        self._full, self._rng = full_pose, rng
        self._one_at_a_time = threading.Lock()

    def measured(self) -> FloatArray:
        """Measured position (3,) m; for a full pose (6,) with the rotation vector, rad."""
        with self._one_at_a_time:
            draw = self._rng.standard_normal(6)
        position, rotation = self._truth.target(self._angles())
        position = position + self._sigma_m * draw[3:]
        if not self._full:
            return position
        seen = rotation_matrix(self._sigma_rad * draw[:3]) @ rotation
        return np.concatenate((position, rotation_vector(seen)))

    def answer(self, question: str) -> str:
        """Answer a request line; an invalid one with an error that shows a valid one."""
        try:
            asked = json.loads(question)
            pose = str(asked["measure"])
        except (ValueError, TypeError, KeyError, RecursionError):
            return json.dumps({"error": 'ask {"measure": "12"} for a measurement of pose 12'})
        found = self.measured().tolist()
        found[3:] = map(math.degrees, found[3:])
        return json.dumps({"pose": pose, **dict(zip(FIELDS, found, strict=False))})
