"""Calibrates in the middle of a session, and reports whether planning can use the estimate."""

from collections.abc import Callable
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.loops.closure import ClosureModel

UNEXPLAINED = 3.0
"""chi2 per degree of freedom above which sensor noise alone does not explain the closures."""
COMPLIANCE_ITERATIONS = 4


@dataclass(frozen=True, slots=True, kw_only=True)
class InterimEstimate:
    """Part of a calibration that planning needs.

    `x`, `covariance`: values (P,) and covariance (P, P) of the parameters. `trusted`: whether planning may use them.
    `text`: the outcome in words.
    """

    x: FloatArray
    covariance: FloatArray
    trusted: bool
    text: str


def implicit_interim(
    model: ClosureModel, noise: NoiseModel
) -> Callable[[FloatArray], InterimEstimate]:
    """Return a function that estimates the parameters from readings (m, n); it raises SolverError for too few poses.

    The function uses the implicit estimator. It starts from the last trusted estimate or, if there is none, from the
    nominal values. If the noise of the joint sensors cannot explain the closure errors, the excess is attributed to the
    fixture's compliance, and the poses are fitted again: otherwise the covariance would be too small.
    """
    start: FloatArray | None = None
    explained = noise

    def calibrate(q: FloatArray) -> InterimEstimate:
        nonlocal start, explained
        used = explained
        estimate = estimate_implicit(model, q, used, x0=start)
        for _ in range(COMPLIANCE_ITERATIONS):
            scatter = estimate.chi2_per_dof or 0.0
            overstated = used.fixture_variance is not None and scatter < 1.0 / UNEXPLAINED
            if scatter <= UNEXPLAINED and not overstated:
                break
            used = _with_fixture_variance(noise, estimate, used)
            estimate = estimate_implicit(model, q, used, x0=start)
        scatter = max(1.0, estimate.chi2_per_dof or 1.0)
        trusted = (
            estimate.converged
            and not estimate.flipped
            and scatter <= 10.0 * UNEXPLAINED
            and bool(np.all(np.isfinite(estimate.x)))
        )
        if trusted:
            start, explained = estimate.x, used
        largest = int(np.argmax(np.abs(estimate.x - nominal_vector(model.parameters))))
        return InterimEstimate(
            x=estimate.x,
            covariance=estimate.covariance * scatter,
            trusted=trusted,
            text=f"chi2 per degree of freedom {scatter:.1f}; "
            f"{model.parameters[largest].name} is farthest from nominal",
        )

    return calibrate


def _with_fixture_variance(noise: NoiseModel, estimate: Estimate, used: NoiseModel) -> NoiseModel:
    """Return `noise` with the fixture variance that would explain the closure errors of `estimate`.

    `used`: noise model of this estimate. If `used` has a fixture variance, the result has this variance times chi2/dof.
    Otherwise the result has the mean squares of the rotation and position errors as fixture variance.
    """
    if used.fixture_variance is not None:
        scale = estimate.chi2_per_dof or 1.0
        return replace(noise, fixture_variance=used.fixture_variance * scale)
    turned, shift = estimate.sigmas.orientation_rad, estimate.sigmas.position_m.rms
    turn = 0.0 if turned is None else turned.rms
    return replace(noise, fixture_variance=np.array([turn**2] * 3 + [shift**2] * 3))
