"""Selects a model: compares faults by their evidence, and chooses which unidentifiable parameters to fix.

A fault adds columns to the fit, with coefficients b ~ N(0, v D), where D holds the squares of the expected magnitudes.
The value of v that maximises the likelihood is used. The likelihood is large if the fault explains much of the misfit,
and small if the fault could explain any misfit equally well (Occam's factor). The noise variances are scaled by the
remaining chi2/dof (see `noise_scale`). So unexplained residuals count as noise, and make the choice less certain.

Any parameter of an unidentifiable direction may be fixed without changing the loop. Entries of the arm's table are
fixed rather than parameters of the fixture, because a wrong parameter of the fixture looks like an error of the arm.
"""

from dataclasses import dataclass
from functools import cache

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.parameters import nominal_vector
from solver.diagnostics.fault_models import Candidate
from solver.diagnostics.identifiability import identifiability_of_jacobian, jacobian_at_closed
from solver.diagnostics.limits import SMALLEST_NOISE_SCALE
from solver.diagnostics.whitened_residuals import PoseNoise, WhitenedResiduals
from solver.errors import UnidentifiableDirection
from solver.estimators.least_squares import column_scale, solve_damped
from solver.estimators.paper import closure_problem
from solver.loops.closure import ClosureModel, in_order

SIZES = np.logspace(-2.0, 3.0, 21)
"""Magnitudes of an explanation that are tried, in units of the expected magnitude."""

STRIDE = 4
"""Step of a coarse first search through `SIZES` for the single maximum, used if each evaluation is expensive."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Explanation:
    """A fault as a possible cause of the misfit, with its model evidence.

    `log_likelihood`: log-likelihood, up to a constant that is the same for all explanations of one pose set.
    `chi2`, `dof`: remaining chi2 and its degrees of freedom (at least 1), at stated variances.
    `size`: most likely standard deviation of the coefficients, in units of their expected magnitudes.
    `b` (c,): the c coefficients of the fault.
    `covariance` (c, c): covariance of `b`; only the variances (c,) if each pose has coefficients of its own.
    `moved` (P,): change of the parameters when the fault is fitted, rad and m.
    `probability`: probability among all causes that are compared; 0 before the comparison.
    """

    candidate: Candidate
    log_likelihood: float
    chi2: float
    dof: int
    size: float
    b: FloatArray
    covariance: FloatArray
    moved: FloatArray
    probability: float = 0.0

    @property
    def chi2_per_dof(self) -> float:
        """Remaining chi2/dof after the fault is fitted, at the stated variances."""
        return self.chi2 / self.dof


def noise_scale(chi2: FloatArray | float, dof: int, most: float = 1.0) -> FloatArray:
    """Return chi2/dof as the ratio of actual to stated variances, limited to [`SMALLEST_NOISE_SCALE`, `most`]."""
    return np.clip(chi2 / max(dof, 1), SMALLEST_NOISE_SCALE, most)


def log_likelihood(chi2: FloatArray | float, dof: int, *, most_noise: float = np.inf) -> FloatArray:
    """Return the log-likelihood of residuals with this remaining chi2.

    `most_noise`: largest ratio of actual to stated variances. It is 1 if no error is larger than stated, and infinite
    if an unknown cause may have made all errors larger.
    """
    scale = noise_scale(chi2, dof, most_noise)
    return -0.5 * (max(dof, 1) * np.log(scale) + chi2 / scale)


def evidence(residuals: WhitenedResiduals, candidate: Candidate) -> Explanation | None:
    """Compute the evidence for a fault; the result is None if the fit already contains all its columns."""
    if candidate.own is not None:
        return _evidence_of_own(residuals, candidate, candidate.own)
    G, expected_size = candidate.columns, candidate.expected_size
    s, C = residuals.score(G)
    s, C = expected_size * s, expected_size[:, None] * C * expected_size
    values, vectors = np.linalg.eigh(C)
    square = float((residuals.whiten(G * expected_size) ** 2).sum(axis=(0, 1)).max(initial=0.0))
    free = values > max(1e-7 * square, 1e-30)
    if not free.any():
        return None
    values, vectors = values[free], vectors[:, free]
    along = vectors.T @ s
    sizes = SIZES[candidate.most >= SIZES]
    v = sizes[:, None] ** 2
    shrunk = v / (1.0 + v * values)
    chi2 = np.maximum(residuals.chi2 - (shrunk * along**2).sum(-1), 1e-12)
    gain = -0.5 * np.log1p(v * values).sum(-1) + log_likelihood(chi2, residuals.dof)
    best = int(np.argmax(gain))
    b = expected_size * (vectors @ (shrunk[best] * along))
    return Explanation(
        candidate=candidate,
        log_likelihood=float(gain[best]),
        chi2=float(chi2[best]),
        dof=max(residuals.dof, 1),
        size=float(sizes[best]),
        b=b,
        covariance=np.outer(expected_size, expected_size) * ((vectors * shrunk[best]) @ vectors.T),
        moved=residuals.moved(G, b),
    )


def _evidence_of_own(
    residuals: WhitenedResiduals, candidate: Candidate, own: IntArray
) -> Explanation | None:
    """Compute the evidence for a fault with coefficients of its own in each of the poses `own` (p,)."""
    expected_size, (p, _, c) = candidate.expected_size, candidate.columns.shape
    columns = candidate.columns * expected_size.reshape(p, 1, c)
    if not (residuals.whitener[own] @ columns).any():
        return None
    sizes = SIZES[candidate.most >= SIZES]

    def at(k: int) -> PoseNoise:
        return PoseNoise(residuals, own, columns * sizes[k])

    @cache
    def gain(k: int) -> float:
        noise = at(k)
        return -0.5 * noise.logdet + float(log_likelihood(max(noise.chi2, 1e-12), residuals.dof))

    about = max(range(0, len(sizes), STRIDE), key=gain)
    nearby = range(max(about - STRIDE + 1, 0), min(about + STRIDE, len(sizes)))
    best = max(nearby, key=gain)
    if not np.isfinite(gain(best)):
        return None
    noise, size = at(best), float(sizes[best])
    b, variance = noise.coefficients()
    return Explanation(
        candidate=candidate,
        log_likelihood=gain(best),
        chi2=max(noise.chi2, 1e-12),
        dof=max(residuals.dof, 1),
        size=size,
        b=size * expected_size * b,
        covariance=(size * expected_size) ** 2 * variance,
        moved=noise.moved,
    )


def probabilities(log_weights: FloatArray) -> FloatArray:
    """Return the probabilities of explanations from `log_weights`: log-likelihood plus logarithm of the prior."""
    weights = np.exp(log_weights - np.max(log_weights))
    return np.asarray(weights / weights.sum())


def drop_unidentifiable(
    model: ClosureModel, x: FloatArray | None, q: FloatArray, *, sigma_rad: FloatArray | None = None
) -> tuple[ClosureModel, tuple[str, ...]]:
    """Fix the parameters that the poses do not determine.

    `x`: parameters (P,) that nearly close the loops. At open loops, every direction looks identifiable. If `x` is None,
    only offsets and fixture are fitted first, because a fit of all lengths might shrink the arm to zero.
    `q`: joint angles (m, n), rad.
    `sigma_rad`: standard deviation of each joint's reading (n,), for closing the loops.

    Returns the loop with fewer unknowns, and the names of the parameters now fixed at their nominal values. The others
    have to be estimated again, because the fixed parameters may have other values in `x`.
    """
    every = names = [p.name for p in model.parameters]
    fixture = {*model.ground_side, *model.hand_side}
    if x is None:
        known = {n for n in names if not n.startswith("theta_off_")} - fixture
        plain = model.with_all_joints_sensed().without(known)
        fit = solve_damped(closure_problem(plain, q), nominal_vector(plain.parameters))
        x = in_order(model, plain, fit.x)
    J = jacobian_at_closed(model, x, q, sigma_rad)
    while names and (directions := identifiability_of_jacobian(J, names, q).directions):
        k = _choose(J.reshape(-1, len(names)), names, directions, fixture)
        J, names = np.delete(J, k, axis=-1), names[:k] + names[k + 1 :]
    dropped = tuple(name for name in every if name not in names)
    return (model.without(dropped) if dropped else model), dropped


def _choose(
    J: FloatArray,
    names: list[str],
    directions: tuple[UnidentifiableDirection, ...],
    fixture: set[str],
) -> int:
    """Return the index of the parameter to fix: an immobile joint's offset or, without one, the least determined."""
    for direction in directions:
        for joint in direction.immobile_joints:
            if f"theta_off_{joint}" in direction.parameters:
                return names.index(f"theta_off_{joint}")
    named = {name for direction in directions for name in direction.parameters}
    # Share of each parameter that least squares cannot determine. Parameters of the fixture are chosen last.
    scaled = J / column_scale(J)
    share = 1.0 - np.diagonal(np.linalg.pinv(scaled, rcond=1e-7) @ scaled)
    return min(
        (k for k in range(len(names)) if names[k] in named),
        key=lambda k: (names[k] in fixture, -round(float(share[k]), 6), k),
    )
