"""Quality of the poses so far, after each capture, by the paper's estimator: fast, not for export."""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.diagnostics.identifiability import identifiability
from solver.estimators.goodness import closure_at_readings
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel, poses_needed

EACH_UP_TO = 100
"""Number of poses up to which each one is followed by an estimate."""
GROWTH = 1.02
"""Beyond, an estimate follows when the number of poses has grown by this factor."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LiveQuality:
    """Quality of a growing set of poses.

    Attributes
    ----------
    needed
        Smallest number of poses that can be solved.
    x
        Parameters: the estimate so far, nominal values before there is one.
    estimated
        Whether `x` is an estimate.
    scaled_condition_number, weakest
        Of the captured poses; inf and () with too few.
    history
        (poses, scaled condition number) after each estimate, oldest first.
    coverage
        Per joint: lowest and highest captured angle, rad; empty without poses.
    predicted_m
        By pose number: distance by which the loop failed to close at that pose under the estimate
        from the poses before it, m.
    standard_deviation
        (P,) of the estimate, by its own residual; empty before there is one.
    """

    needed: int
    x: FloatArray
    estimated: bool
    scaled_condition_number: float
    weakest: tuple[str, ...]
    history: tuple[tuple[int, float], ...]
    coverage: tuple[tuple[float, float], ...]
    predicted_m: dict[int, float]
    standard_deviation: FloatArray
    numbers: tuple[int, ...]


def live_quality(
    arm: ArmModel,
    model: ClosureModel,
    q_rad: FloatArray,
    numbers: tuple[int, ...],
    *,
    earlier: LiveQuality | None = None,
) -> LiveQuality:
    """Return the quality of poses `q_rad` (m, n) with these numbers; reuses `earlier` results."""
    shared = 0
    if earlier is not None and earlier.numbers == numbers[: len(earlier.numbers)]:
        quality, shared = earlier, len(earlier.numbers)
    else:
        quality = _empty(model)
        if earlier is not None:
            quality = replace(quality, predicted_m=dict(earlier.predicted_m))
    for count in range(shared + 1, len(numbers) + 1):
        # Of many at once, as after a resume, only the last estimate is shown.
        last_of_many = count == len(numbers) > shared + 1
        quality = _with_one_more(
            arm, model, q_rad[:count], numbers[:count], quality, at_once=last_of_many
        )
    return quality


def _empty(model: ClosureModel) -> LiveQuality:
    return LiveQuality(
        needed=poses_needed(len(model.parameters), model.equations_per_pose),
        x=nominal_vector(model.parameters),
        estimated=False,
        scaled_condition_number=float("inf"),
        weakest=(),
        history=(),
        coverage=(),
        predicted_m={},
        standard_deviation=np.zeros(0),
        numbers=(),
    )


def _with_one_more(
    arm: ArmModel,
    model: ClosureModel,
    q: FloatArray,
    numbers: tuple[int, ...],
    before: LiveQuality,
    *,
    at_once: bool,
) -> LiveQuality:
    number, predicted = numbers[-1], dict(before.predicted_m)
    if before.estimated and number not in predicted:
        error = closure_at_readings(model.at_poses(np.array([len(q) - 1])), before.x, q[-1:])
        predicted[number] = float(np.linalg.norm(error.residual[0, error.rotation_rows :]))
    quality = replace(
        before,
        numbers=numbers,
        coverage=tuple(zip(q.min(axis=0).tolist(), q.max(axis=0).tolist(), strict=True)),
        predicted_m=predicted,
    )
    estimated = before.history[-1][0] if before.history else 0
    due = len(q) <= EACH_UP_TO or len(q) >= GROWTH * estimated
    if len(q) < before.needed or not (due or at_once):
        return quality
    model = model.at_poses(np.arange(len(q)))
    # From the nominal values, not from the last estimate: an early one may be far off.
    estimate = estimate_paper(model, q)
    seen = identifiability(model, estimate.x, q, sigma_rad=arm.sigma_rad())
    return replace(
        quality,
        x=estimate.x,
        estimated=estimate.converged and not seen.directions,
        scaled_condition_number=seen.scaled_condition_number,
        weakest=seen.weakest.parameters,
        history=(*before.history, (len(q), seen.scaled_condition_number)),
        standard_deviation=estimate.standard_deviation,
    )
