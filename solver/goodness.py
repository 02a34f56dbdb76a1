"""sigma_pos and sigma_ori: how well loops close at the measured joints (paper, eqs. 14 and 15)."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoReadings:
    """One figure in the two readings of the paper's formula.

    `rms` divides inside the root, sqrt(sum / (k m)), the only reading that gives figures of the
    paper's size; `as_printed` divides outside it, sqrt(sum) / (k N).
    """

    rms: float
    as_printed: float


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureSigmas:
    """Standard deviations of the closure error: position in m, orientation in rad."""

    position_m: TwoReadings
    orientation_rad: TwoReadings


def closure_sigmas(residual: FloatArray, rotation_rows: int) -> ClosureSigmas:
    """Compute both sigmas of reduced residuals (m, r), rotation rows first (eqs. 14 and 15)."""
    return ClosureSigmas(
        position_m=_both(residual[:, rotation_rows:]),
        orientation_rad=_both(residual[:, :rotation_rows]),
    )


def _both(rows: FloatArray) -> TwoReadings:
    poses, components = rows.shape
    total = float(np.sum(rows**2))
    count = components * poses
    if count == 0:
        return TwoReadings(rms=0.0, as_printed=0.0)
    return TwoReadings(rms=float(np.sqrt(total / count)), as_printed=float(np.sqrt(total) / count))
