"""sigma_pos and sigma_ori: how well loops close at the measured joints (paper, eqs. 14 and 15).

Knows closure models and no estimator: every estimator is judged by the same figures.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.closing import close_loops
from solver.loops.closure import ClosureModel, ReducedError, pose_blocks


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
    """Standard deviations of the closure error: position in m, orientation in rad.

    `orientation_rad` is None where the loops say nothing of it: a ball, measured positions.
    """

    position_m: TwoReadings
    orientation_rad: TwoReadings | None


def closure_sigmas(residual: FloatArray, rotation_rows: int) -> ClosureSigmas:
    """Compute both sigmas of reduced residuals (m, r), rotation rows first (eqs. 14 and 15)."""
    return ClosureSigmas(
        position_m=_both(residual[:, rotation_rows:]),
        orientation_rad=_both(residual[:, :rotation_rows]) if rotation_rows else None,
    )


def _both(rows: FloatArray) -> TwoReadings:
    poses, components = rows.shape
    total = float(np.sum(rows**2))
    count = components * poses
    if count == 0:
        return TwoReadings(rms=0.0, as_printed=0.0)
    return TwoReadings(rms=float(np.sqrt(total / count)), as_printed=float(np.sqrt(total) / count))


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureAtReadings:
    """Reduced closure error of every pose at the joints as measured; fields as of `ReducedError`."""

    residual: FloatArray
    rotation_rows: int
    unsensed: FloatArray
    flipped: BoolArray


def closure_at_readings(model: ClosureModel, x: FloatArray, q: FloatArray) -> ClosureAtReadings:
    """Closure error at the *measured* joints (m, n), so that all estimators share one scale.

    Unsensed joints take the angles that close each loop best: their readings are not evidence.
    """
    found = [
        (error.residual, error.unsensed, error.flipped, error.rotation_rows)
        for error in (_at_readings(part, x, here) for part, here in pose_blocks(model, q))
    ]
    residual, unsensed, flipped, rotation_rows = zip(*found, strict=True)
    return ClosureAtReadings(
        residual=np.concatenate(residual),
        rotation_rows=rotation_rows[0],
        unsensed=np.concatenate(unsensed),
        flipped=np.concatenate(flipped),
    )


def _at_readings(model: ClosureModel, x: FloatArray, q: FloatArray) -> ReducedError:
    if not model.unsensed_joints:
        return model.reduced(x, q, rates=False)
    # Offsets of unsensed joints may belong to a placement: each fills in its own.
    parts = model.parts()
    found = [_at_unsensed_angles(part, x[here], q[poses]) for part, here, poses in parts]
    return model.with_all_joints_sensed().merged(found)


def _at_unsensed_angles(model: ClosureModel, x: FloatArray, q: FloatArray) -> ReducedError:
    """Closure error of one placement with its unsensed joints at the angles that close it best."""
    still = np.zeros(q.shape[-1])
    u = close_loops(model, x, q, sigma_rad=still, max_iterations=50).u
    filled = q.copy()
    offsets = {p.name: p.nominal for p in model.with_all_joints_sensed().parameters}
    first = u.shape[-1] - len(model.unsensed_joints)
    for k, joint in enumerate(model.unsensed_joints):
        filled[:, joint - 1] = u[:, first + k] - offsets[f"theta_off_{joint}"]
    sensed = model.with_all_joints_sensed()
    here = {p.name: value for p, value in zip(model.parameters, x, strict=True)}
    return sensed.reduced(
        np.array([here.get(p.name, p.nominal) for p in sensed.parameters]), filled, rates=False
    )
