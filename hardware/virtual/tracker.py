"""A tracker that sees the hand of the virtual open arm, and speaks the instrument port's lines. Knows no bus.

It answers a line ``{"measure": "12"}`` with ``{"pose": "12", "x_m": ..., ..., "rz_deg": ...}``: where the
target is now in its own frame, and how it is turned, as a rotation vector.
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
    """What sees the target of a truth.

    Parameters
    ----------
    truth
        Of the arm that is seen.
    angles_rad
        Where its joints truly are now, theta' (n,); asked at every measurement.
    sigma_m, sigma_rad
        Noise of each component.
    full_pose
        Whether it sees how the target is turned.
    rng
        Of the noise.
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
        """Where the target is seen, (3,) m; of a full pose (6,), a rotation vector in rad behind it."""
        with self._one_at_a_time:
            draw = self._rng.standard_normal(6)
        position, rotation = self._truth.target(self._angles())
        position = position + self._sigma_m * draw[3:]
        if not self._full:
            return position
        seen = rotation_matrix(self._sigma_rad * draw[:3]) @ rotation
        return np.concatenate((position, rotation_vector(seen)))

    def answer(self, question: str) -> str:
        """Answer a line; one that asks for no measurement with what would."""
        try:
            asked = json.loads(question)
            pose = str(asked["measure"])
        except (ValueError, TypeError, KeyError, RecursionError):
            return json.dumps({"error": 'ask {"measure": "12"} for a measurement of pose 12'})
        found = self.measured().tolist()
        found[3:] = map(math.degrees, found[3:])
        return json.dumps({"pose": pose, **dict(zip(FIELDS, found, strict=False))})
