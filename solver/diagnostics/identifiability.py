"""Identifiability of a pose set: rank, condition number, and names of the unidentifiable directions.

The Jacobian is evaluated on poses that close exactly. At poses that do not close, sensor noise hides its null
space, and an unidentifiable parameter merely looks badly conditioned.
"""

from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.closing import close_loops, left_null_space, reduced_equations
from solver.diagnostics.limits import IMMOBILE_RAD, WELL_CONDITIONED
from solver.errors import UnidentifiableDirection
from solver.estimators.estimate import Estimate
from solver.estimators.least_squares import column_scale, stacked_triangle
from solver.estimators.linear_fit import LinearFit
from solver.estimators.paper import closure_problem
from solver.loops.closure import ClosureModel, pose_blocks

RANK_TOLERANCE = 1e-7
"""A scaled singular value below this share of the largest counts as zero. On closed poses, true zeros are computed
as about 1e-12, and the value of the weakest parameter of a usable pose set exceeds 1e-4."""

CLOSED = 1e-9
"""Closure error (rad, m) below which a loop counts as closed, small enough for true zeros to be recognised."""

LEAST_MOTION_DEG = 0.05
"""A smaller change of a reading, deg, counts as noise and deflection and not as motion."""

TREND_POINTS = 10
TREND_FLOOR = 1e-12
"""Smallest ratio of smallest to largest eigenvalue of the normal equations for a point of `Identifiability.trend`. The
scaled condition number is then at most 1e6."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Identifiability:
    """Identifiability indices of one Jacobian.

    `rank`: number of parameters, or of combinations of parameters, that the poses determine.
    `scaled_condition_number`: ratio of largest to smallest singular value, with columns scaled to length 1 (paper:
    below 100 is acceptable); inf if the smallest is zero.
    `condition_number`: ratio of largest to smallest singular value in rad and m, without column scaling.
    `observability`: observability indices O1..O5 of the literature, for the scaled Jacobian.
    `directions`: the unidentifiable directions; () if the rank is full.
    `weakest`: the least determined of the identifiable directions.
    `trend`: pairs (k, scaled condition number of the first k poses), at the same parameters, for several numbers k at
    which the rank is full.
    """

    rank: int
    scaled_condition_number: float
    condition_number: float
    observability: tuple[float, float, float, float, float]
    directions: tuple[UnidentifiableDirection, ...]
    weakest: UnidentifiableDirection
    trend: tuple[tuple[int, float], ...] = ()


def identifiability(
    model: ClosureModel, x: FloatArray, q: FloatArray, *, sigma_rad: FloatArray | None = None
) -> Identifiability:
    """Compute the identifiability indices of the pose set `q` (m, n) at the parameters `x` (P,).

    The Jacobian is evaluated at the closed loop nearest to each pose; a pose that cannot be closed with these
    parameters is used unchanged.
    """
    A = np.concatenate(
        [jacobian_at_closed(part, x, part_q, sigma_rad) for part, part_q in pose_blocks(model, q)]
    )
    return identifiability_of_jacobian(A, [p.name for p in model.parameters], q)


def _trend(J: FloatArray) -> tuple[tuple[int, float], ...]:
    """Return `Identifiability.trend` from the Jacobian `J` (m, r, P) of all poses."""
    m, r, P = J.shape
    fewest = -(-P // max(r, 1))
    if m < fewest or not r:
        return ()
    ratios = (m / fewest) ** np.linspace(0.0, 1.0, TREND_POINTS)
    counts = np.unique((fewest * ratios).round().astype(int))
    # Normal equations square the condition number, which is practically infinite long before that matters.
    parts = [rows.reshape(-1, P) for rows in np.split(J, counts)[:-1]]
    N = np.cumsum([rows.T @ rows for rows in parts], axis=0)
    size = np.sqrt(np.diagonal(N, axis1=-2, axis2=-1))
    determined = (size > 0.0).all(-1)
    values = np.linalg.eigvalsh(
        N[determined] / (size[determined, :, None] * size[determined, None, :])
    )
    return tuple(
        (int(count), float(np.sqrt(v[-1] / v[0])))
        for count, v in zip(counts[determined], values, strict=True)
        if v[0] > TREND_FLOOR * v[-1]
    )


def condition_at_readings(model: ClosureModel, x: FloatArray, q: FloatArray) -> float | None:
    """Scaled condition number at the readings `q` (m, n), without closing the loops.

    The Jacobian is the paper's C (eq. 6) at parameters `x` (P,). The result is inf if the rank is deficient. It is None
    if joints are unsensed, a case that the paper does not treat.
    """
    if model.unsensed_joints:
        return None
    C = closure_problem(model, q)(x).T
    s = np.linalg.svd(C / column_scale(C), compute_uv=False)
    return float(s[0] / s[-1]) if s[-1] > RANK_TOLERANCE * s[0] else float("inf")


def well_conditioned_at_readings(paper: Estimate, q: FloatArray) -> bool:
    """Whether the Jacobian J at the readings `q` (m, n) is so well conditioned that all parameters are identifiable.

    The condition follows from the covariance of the estimate `paper`, which is proportional to the inverse of J'J.
    """
    sd = paper.standard_deviation
    if not (sd > 0.0).all() or _immobile(np.ptp(q, axis=0)):
        return False
    normal = np.linalg.pinv(paper.covariance / np.outer(sd, sd), hermitian=True)
    size = np.sqrt(np.diagonal(normal))
    least, *_, most = np.linalg.eigvalsh(normal / np.outer(size, size))
    return bool(most < WELL_CONDITIONED**2 * least)


def jacobian_at_closed(
    model: ClosureModel, x: FloatArray, q: FloatArray, sigma_rad: FloatArray | None
) -> FloatArray:
    """Return the reduced Jacobian (m, r, P) at the closed loop nearest to each pose; at `q` if a pose cannot close."""
    poses = close_loops(model, x, q, sigma_rad=sigma_rad, tolerance=CLOSED)
    closed_q, u = poses.q, poses.u
    if not poses.closed.all():
        closed_q = np.where(poses.closed[:, None], closed_q, q)
        u = np.where(poses.closed[:, None], u, model.initial_unsensed(x, q))
    return reduced_equations(model.loop(x, closed_q, u)).A


def identifiability_of_jacobian(
    J: FloatArray, names: Sequence[str], q: FloatArray
) -> Identifiability:
    """Compute the identifiability indices of the Jacobian (m, r, P) of poses `q` (m, n), with columns `names`."""
    poses, spans_rad = len(q), np.ptp(q, axis=0)
    # The R factor has the same singular values and is P x P however many poses there are.
    R = stacked_triangle([J.reshape(-1, len(names))])
    scale = column_scale(R)
    zero_columns = np.linalg.norm(R, axis=0) <= RANK_TOLERANCE * max(float(scale.max()), 1e-300)
    _, s, Vt = np.linalg.svd(np.where(zero_columns, 0.0, R / scale), full_matrices=True)
    s = np.concatenate((s, np.zeros(len(names) - len(s))))
    rank = int((s > RANK_TOLERANCE * max(s[0], 1e-300)).sum())
    directions = tuple(_direction(vector, names, spans_rad) for vector in _sparse_basis(Vt[rank:]))
    plain = np.linalg.svd(R, compute_uv=False)
    full = rank == len(names)
    directions += _immobile_offsets(names, spans_rad, directions)
    return Identifiability(
        rank=len(names) - len(directions),
        scaled_condition_number=float(s[0] / s[-1]) if full else float("inf"),
        condition_number=float(plain[0] / plain[-1]) if full else float("inf"),
        observability=_observability(s, poses),
        directions=directions,
        weakest=_direction(Vt[max(rank - 1, 0)], names, spans_rad),
        trend=_trend(J),
    )


def _observability(s: FloatArray, poses: int) -> tuple[float, float, float, float, float]:
    """Return O1 (Borm & Menq), O2, O3 (Nahvi), O4 (Nahvi & Hollerbach), O5 (Sun & Hollerbach) from singular values."""
    low, high = float(s[-1]), float(s[0])
    if low <= 0.0 or high <= 0.0:
        return (0.0, 0.0, 0.0, 0.0, 0.0)
    return (
        float(np.exp(np.mean(np.log(s))) / np.sqrt(poses)),
        low / high,
        low,
        low**2 / high,
        float(1.0 / np.sum(1.0 / s)),
    )


def _sparse_basis(null: FloatArray) -> FloatArray:
    """Return a sparse basis (k, P) of the space spanned by the k null vectors `null` (k, P) of the Jacobian.

    A null vector may mix all unidentifiable directions. Gauss-Jordan elimination with pivoting separates directions
    that share no parameter, so that each can be named.
    """
    basis = null.copy()
    for row in range(len(basis)):
        pivot = int(np.argmax(np.abs(basis[row:]).max(axis=0)))
        best = row + int(np.argmax(np.abs(basis[row:, pivot])))
        basis[[row, best]] = basis[[best, row]]
        basis[row] /= basis[row, pivot]
        others = np.arange(len(basis)) != row
        basis[others] -= np.outer(basis[others, pivot], basis[row])
    norms = np.linalg.norm(basis, axis=1, keepdims=True)
    return np.asarray(basis / np.where(norms > 0.0, norms, 1.0))


def _immobile(spans_rad: FloatArray) -> tuple[int, ...]:
    return tuple(j + 1 for j, span in enumerate(spans_rad) if span < IMMOBILE_RAD)


def _immobile_offsets(
    names: Sequence[str], spans_rad: FloatArray, known: tuple[UnidentifiableDirection, ...]
) -> tuple[UnidentifiableDirection, ...]:
    """Return a direction for each immobile joint whose offset is in none of the `known` directions.

    If link lengths are taken as exact, the poses seem to determine such an offset: the rank may be full, and the scaled
    condition number low (9.6 in one example). But a length error of a millimetre looks like an error of the offset, so
    the offset is reported as unidentifiable.
    """
    named = {name for direction in known for name in direction.parameters}
    return tuple(
        UnidentifiableDirection(
            parameters=(f"theta_off_{joint}",),
            weights=(1.0,),
            reason=_immobile_words((joint,), spans_rad),
            immobile_joints=(joint,),
        )
        for joint in _immobile(spans_rad)
        if f"theta_off_{joint}" in names and f"theta_off_{joint}" not in named
    )


def _direction(
    vector: FloatArray, names: Sequence[str], spans_rad: FloatArray
) -> UnidentifiableDirection:
    size = np.abs(vector)
    # Both signs mean the same direction; the largest component is made positive.
    vector = vector * np.sign(vector[np.argmax(np.round(size, 6))])
    # Equal parts stay in the order of the parameters, whatever their last digits.
    share = np.round(size / size.max(), 6)
    order = [int(k) for k in np.argsort(-share, kind="stable") if share[k] > 0.05]
    offsets = {f"theta_off_{j}": j for j in _immobile(spans_rad)}
    # The joint that does not move comes first, since the operator can act on it.
    order.sort(key=lambda k: names[k] not in offsets)
    parameters = tuple(names[k] for k in order)
    immobile = tuple(j for name, j in offsets.items() if name in parameters)
    return UnidentifiableDirection(
        parameters=parameters,
        weights=tuple(float(vector[k]) for k in order),
        reason=_immobile_words(immobile, spans_rad) if immobile else "",
        immobile_joints=immobile,
    )


def _immobile_words(joints: tuple[int, ...], spans_rad: FloatArray) -> str:
    several = len(joints) > 1
    which = f"joint{'s' * several} {' and '.join(map(str, joints))}"
    most = float(np.rad2deg(max(spans_rad[j - 1] for j in joints)))
    if most < LEAST_MOTION_DEG:
        return f"{which} {'do' if several else 'does'} not move"
    return f"{which} move{'s' * (not several)} by no more than {most:.2g} deg"


def identifiability_of_fit(
    fit: LinearFit, names: Sequence[str], *, taken: IntArray, without: Collection[int] = ()
) -> Identifiability:
    """Compute the identifiability of the parameters `names` from the poses of `fit`; all others count as known.

    `taken` (m,): position of each pose of the fit in time order. `without`: joints (1-based) whose readings are not
    used.
    """
    system, model, q = fit.whole, fit.design.model, fit.design.q
    lost = [j - 1 for j in without if j not in model.unsensed_joints]
    every = [p.name for p in model.parameters]
    J = system.A[..., [every.index(name) for name in names]]
    if lost:
        J = np.swapaxes(left_null_space(system.B[..., lost]), -1, -2) @ J
    J = J[np.argsort(taken, kind="stable")]
    return identifiability_of_jacobian(J, names, q)
