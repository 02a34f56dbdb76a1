"""The smooth curve of an analogue angle sensor: how far it may bend, and in which shapes. Knows no loop."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Rvdt

SHAPE_WEIGHTS = (0.5, 1.0, 1.0, 0.5, 0.35, 0.25, 0.18, 0.14, 0.11, 0.09)
"""Prior sizes of Legendre P1..P10: a transformer's curve is mostly a bow and an S, its gain is off, and
what is left falls with the square of the order, so that a bend or a bump is no surprise."""


def _power_series() -> FloatArray:
    """Coefficients (11, 10) of 1, x, ..., x^10 in the shapes, times their prior sizes."""
    powers = np.zeros((len(SHAPE_WEIGHTS) + 1, len(SHAPE_WEIGHTS)))
    for k, weight in enumerate(SHAPE_WEIGHTS):
        series = np.polynomial.legendre.leg2poly(np.eye(k + 2)[k + 1])
        powers[: len(series), k] = weight * series
    return powers


_POWERS = _power_series()
"""Of so low a degree powers lose three digits of sixteen, and all shapes are one matrix product."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SensorCurve:
    """Deviation of one sensor from the true angle: ``sum_k c_k P_k(x)``, k = 1, 2, 3, ...

    x is the angle from `middle_rad` over `half_scale_rad`. P_1 is an error of the gain; without P_0
    the deviation's mean over full scale is zero: that is the joint's offset.

    Attributes
    ----------
    joint
        1-based.
    middle_rad
        Electrical zero, in sensor coordinates.
    half_scale_rad
        Half of full scale.
    """

    joint: int
    middle_rad: float
    half_scale_rad: float

    @property
    def width(self) -> int:
        """Number c of shapes."""
        return len(SHAPE_WEIGHTS)

    def basis(self, theta_rad: FloatArray) -> FloatArray:
        """Shapes at sensor angles (m,), times their prior sizes: (m, c)."""
        x = (theta_rad - self.middle_rad) / self.half_scale_rad
        # Beyond full scale a sensor saturates; polynomials would run away there.
        x = np.clip(x, -1.2, 1.2)
        return np.asarray(np.vander(x, len(_POWERS), increasing=True) @ _POWERS)


def rms_per_amplitude() -> float:
    """Expected rms deviation over full scale of a curve whose coefficients have unit amplitude."""
    degrees = np.arange(1, 1 + len(SHAPE_WEIGHTS))
    return float(np.sqrt((np.array(SHAPE_WEIGHTS) ** 2 / (2.0 * degrees + 1.0)).sum()))


def curves_of(arm: ArmModel, *, unsensed_joints: tuple[int, ...] = ()) -> tuple[SensorCurve, ...]:
    """Return the curve that each RVDT of `arm` may have; none for joints whose reading is not used."""
    return tuple(
        SensorCurve(
            joint=j, middle_rad=joint.middle_rad, half_scale_rad=0.5 * joint.sensor.full_scale_rad
        )
        for j, joint in enumerate(arm.joints, 1)
        if isinstance(joint.sensor, Rvdt) and j not in unsensed_joints
    )
