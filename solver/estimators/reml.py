"""Variance components of a linear mixed model by restricted maximum likelihood. Knows no loop.

The model, for poses i with a few equations each:

    w_i = -A_i dx + Z_i b + f_i,     f_i ~ N(0, V0_i + sum_k v_k C_ki),   b_l ~ N(0, v_l I),

with dx unknown. Components k ("noise") are new in every pose; components l ("effects") are drawn
once for the whole data set, as a sensor's curve is. Restricted likelihood (Patterson & Thompson
1971) judges the variances by the residuals that no dx can explain, so dof are accounted for.
Solved by Fisher scoring with the mixed-model equations (Henderson): nothing is N x N.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.estimators.least_squares import column_scale

TOLERANCE = 1e-9
MAX_ITERATIONS = 200

CONCAVE = 0.05
"""Smallest eigenvalue of the curvature, in units of the expected information, for Newton's step."""


@dataclass(frozen=True, slots=True, kw_only=True)
class MixedModel:
    """One linear mixed model; m poses, r equations a pose, P unknowns.

    Attributes
    ----------
    w, A
        Misclosure (m, r) and Jacobian of the unknowns (m, r, P).
    base
        Known covariance V0 (m, r, r), positive definite.
    noise
        One (m, r, r) positive semidefinite array per noise component.
    effects
        One (m, r, c) array of columns per effect component.
    """

    w: FloatArray
    A: FloatArray
    base: FloatArray
    noise: tuple[FloatArray, ...] = ()
    effects: tuple[FloatArray, ...] = ()

    @property
    def components(self) -> int:
        """Number K of variance components: noise first, then effects."""
        return len(self.noise) + len(self.effects)


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """The mixed model solved for given variances.

    Attributes
    ----------
    log_likelihood
        Restricted log-likelihood, without constants.
    score, information, curvature
        Its gradient (K,), expected information (K, K) and negative second derivative (K, K).
    step
        Best linear unbiased estimate of dx (P,).
    effects
        Best linear prediction of each effect component's b.
    covariance
        Joint covariance of (-dx, b) about their estimates, effects stacked in order.
    chi2
        ``w' P w``: weighted sum of squares, the effects' share included.
    """

    log_likelihood: float
    score: FloatArray
    information: FloatArray
    curvature: FloatArray
    step: FloatArray
    effects: tuple[FloatArray, ...]
    covariance: FloatArray
    chi2: float


@dataclass(frozen=True, slots=True, kw_only=True)
class RemlFit:
    """Variances (K,) that the data ask for, none negative, and the model solved there."""

    variances: FloatArray
    solution: Solution
    iterations: int
    converged: bool


def solve_mixed(model: MixedModel, variances: FloatArray) -> Solution:
    """Solve the mixed-model equations and evaluate the restricted likelihood."""
    m, r, P = model.A.shape
    split = len(model.noise)
    V = model.base + sum(
        (v * C for v, C in zip(variances[:split], model.noise, strict=True)), np.zeros((r, r))
    )
    L = np.linalg.cholesky(V)
    roots = [np.sqrt(v) for v in variances[split:]]
    # Effects enter as columns of unit variance; one of variance zero is a column of zeros.
    Z = [root * effect for root, effect in zip(roots, model.effects, strict=True)]
    columns = np.linalg.solve(L, np.concatenate((model.A, *Z), axis=-1)).reshape(m * r, -1)
    w = np.linalg.solve(L, model.w[..., None]).reshape(m * r)
    scale = column_scale(columns)
    scale[P:] = 1.0
    total = columns.shape[1]
    prior = np.eye(total)[P:]
    # Rows below the data say that effects have mean zero and unit variance.
    Q, R = _orthonormal(np.concatenate((columns / scale, prior)))
    U = Q[: m * r]
    coefficients = np.linalg.solve(R, U.T @ w) / scale
    inverse = np.linalg.solve(R, np.eye(total)) / scale[:, None]
    widths = [np.full(z.shape[-1], root) for root, z in zip(roots, Z, strict=True)]
    inverse *= np.concatenate((np.ones(P), *widths))[:, None]
    white = w - U @ (U.T @ w)
    log_det = 2.0 * float(np.log(np.diagonal(L, axis1=-2, axis2=-1)).sum())
    log_det += 2.0 * float(np.log(np.abs(np.diagonal(R))).sum() + np.log(scale).sum())
    chi2 = float(w @ white)
    score, information, curvature = _derivatives(
        model, L, U.reshape(m, r, total), white.reshape(m, r)
    )
    stops = np.cumsum([P, *(z.shape[-1] for z in Z)])
    return Solution(
        log_likelihood=-0.5 * (log_det + chi2),
        score=score,
        information=information,
        curvature=curvature,
        step=-coefficients[:P],
        effects=tuple(
            root * coefficients[a:b]
            for root, a, b in zip(roots, stops[:-1], stops[1:], strict=True)
        ),
        covariance=inverse @ inverse.T,
        chi2=chi2,
    )


def _orthonormal(X: FloatArray) -> tuple[FloatArray, FloatArray]:
    """QR factors of a tall matrix by Cholesky, twice: as orthogonal as Householder's.

    On these small shapes Householder's is no slower alone, but a threaded LAPACK that shares its
    cores made it wait 36 ms where this takes 0.5. A matrix too ill-conditioned gets it all the same.
    """
    try:
        first = np.linalg.cholesky(X.T @ X)
        Q = np.linalg.solve(first, X.T).T
        second = np.linalg.cholesky(Q.T @ Q)
    except np.linalg.LinAlgError:
        return np.linalg.qr(X)
    return np.linalg.solve(second, Q.T).T, second.T @ first.T


def _derivatives(
    model: MixedModel, L: FloatArray, U: FloatArray, white: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Score (K,), expected information and negative second derivative (K, K) of every component.

    In whitened coordinates P = I - U U'. With noise blocks C and effect columns Z,
    ``tr(P C P C')`` and its kin need sums over poses and small Gram matrices only.
    """
    K, split = model.components, len(model.noise)
    if K == 0:
        return np.zeros(0), np.zeros((0, 0)), np.zeros((0, 0))
    C = [
        np.swapaxes(np.linalg.solve(L, np.swapaxes(np.linalg.solve(L, c), -1, -2)), -1, -2)
        for c in model.noise
    ]
    Z = [np.linalg.solve(L, z) for z in model.effects]
    UtC = [np.einsum("mrp,mrs->mps", U, c) for c in C]
    # P Z, and C P Z for the mixed terms.
    UtZ = [np.einsum("mrp,mrc->pc", U, z) for z in Z]
    PZ = [z - np.einsum("mrp,pc->mrc", U, g) for z, g in zip(Z, UtZ, strict=True)]
    gram = [np.einsum("mps,msq->pq", uc, U) for uc in UtC]
    trace, square = np.zeros(K), np.zeros(K)
    pulled = np.zeros((K, *white.shape))
    for k, c in enumerate(C):
        trace[k] = np.einsum("mrr->", c) - np.trace(gram[k])
        pulled[k] = (c @ white[..., None])[..., 0]
        square[k] = (pulled[k] * white).sum()
    for k, (z, pz) in enumerate(zip(Z, PZ, strict=True), split):
        trace[k] = np.einsum("mrc,mrc->", z, pz)
        predicted = np.einsum("mrc,mr->c", z, white)
        pulled[k] = z @ predicted
        square[k] = float((predicted**2).sum())
    inside = np.einsum("kmr,mrp->kp", pulled, U)
    flat = pulled.reshape(K, -1)
    average = flat @ flat.T - inside @ inside.T
    information = np.zeros((K, K))
    for k in range(K):
        for j in range(k, K):
            if j < split:
                value = np.einsum("mrs,msr->", C[k], C[j])
                value -= 2.0 * np.einsum("mps,msr,mrp->", UtC[k], C[j], U)
                value += np.einsum("pq,qp->", gram[k], gram[j])
            elif k < split:
                value = np.einsum("mrc,mrs,msc->", PZ[j - split], C[k], PZ[j - split])
            else:
                value = (np.einsum("mrc,mrd->cd", Z[k - split], PZ[j - split]) ** 2).sum()
            information[k, j] = information[j, k] = 0.5 * value
    return 0.5 * (square - trace), information, average - information


def fit_reml(
    model: MixedModel,
    start: FloatArray,
    *,
    held: BoolArray | None = None,
    max_iterations: int = MAX_ITERATIONS,
) -> RemlFit:
    """Maximise the restricted likelihood over variances >= 0.

    Parameters
    ----------
    start
        First values (K,); their sizes also say what a small variance is.
    held
        Components (K,) that keep their first value, whether zero or not.
    """
    v = np.array(start, dtype=np.float64)
    free = np.ones(len(v), dtype=np.bool_) if held is None else ~held
    here = solve_mixed(model, v)
    iterations, converged = 0, not free.any()
    while not converged and iterations < max_iterations:
        iterations += 1
        direction = _step(v, here, free)
        gain, step = -np.inf, 1.0
        while step > 1e-10:
            trial = np.maximum(v + step * direction, 0.0)
            there = solve_mixed(model, trial)
            gain = there.log_likelihood - here.log_likelihood
            if gain > -1e-12 * abs(here.log_likelihood):
                break
            step *= 0.5
        change = np.abs(trial - v) * np.sqrt(np.maximum(np.diagonal(here.information), 0.0))
        converged = bool(change.max(initial=0.0) < TOLERANCE) or step <= 1e-10
        if gain > -1e-12 * abs(here.log_likelihood):
            v, here = trial, there
    return RemlFit(variances=v, solution=here, iterations=iterations, converged=converged)


def _step(v: FloatArray, here: Solution, free: BoolArray) -> FloatArray:
    """Step (K,) that keeps variances >= 0: what it would make negative goes to zero.

    The others then step as the curvature demands for that, which is what makes the iteration quick
    on the boundary. A component at zero stays while the likelihood falls away from it. Newton's
    step where the likelihood is concave, as it is near its maximum; Fisher's elsewhere.
    """
    size = np.sqrt(np.maximum(np.diagonal(here.information), 1e-300))
    score = here.score / size
    moving = free & ((v > 0.0) | (score > 0.0))
    step = np.zeros(len(v))
    metric = here.curvature / np.outer(size, size)
    if moving.any() and np.linalg.eigvalsh(metric[np.ix_(moving, moving)])[0] < CONCAVE:
        metric = here.information / np.outer(size, size)
    while moving.any():
        rest = ~moving
        target = score[moving] - metric[np.ix_(moving, rest)] @ step[rest]
        step[moving] = np.linalg.lstsq(metric[np.ix_(moving, moving)], target, rcond=1e-12)[0]
        below = moving & (v * size + step < 0.0)
        if not below.any():
            break
        step[below] = -(v * size)[below]
        moving = moving & ~below
    return np.asarray(step / size)
