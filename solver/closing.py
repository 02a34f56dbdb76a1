"""Closes loops, and reduces a loop's equations by eliminating the unsensed angles.

Every loop error is linear in small changes of parameters, joint angles and unsensed angles,

    c + C dphi + J_q dq + N du = 0,

with the paper's unknowns phi and their Jacobian C (eqs. 5 and 6); `LoopError` calls c ``residual``, C
``jac_x``, J_q ``jac_q`` and N ``jac_u``. u is not measured, so it is eliminated: with E an orthonormal basis of the
left null space of N,

    E' c + E' C dphi + E' J_q dq = 0,     and afterwards     du = -N+ (c + C dphi + J_q dq).

The whole solver uses this one reduction (`reduced_equations`). `close_loops` closes loops by Newton's iteration on the
reduced equations with dphi = 0 and the smallest weighted dq. The estimators solve the same equations with dphi unknown.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import BLOCK_POSES, BoolArray, FloatArray, join_poses, pose_slices, select_poses
from solver.loops.closure import ClosureModel, LoopError, pose_blocks

SINGULAR = 1e-7
"""Singular values below this share of the largest belong to directions that no free joint moves."""

TINY = 1e-200
"""Prevents a division by zero for a pose whose joints are all fixed."""

LONGEST_CORRECTION_RAD = 0.5
"""Largest correction of a joint or unsensed angle in one iteration."""

STALLED_RAD = 1e-14
"""A shorter step is due to rounding: the pose cannot be closed any further."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosedPoses:
    """Poses whose joint angles were corrected so that the loops close.

    `q`, `u`: joint angles (m, n) and unsensed angles (m, U), rad. `closed` (m,): whether the error of each loop is
    below 1e-9 or below 100 times the solver's tolerance, whichever is larger.
    """

    q: FloatArray
    u: FloatArray
    closed: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReducedEquations:
    """Loop equations of every pose after eliminating the unsensed angles: ``w + A dphi + B dq = 0``.

    `E` (..., m, k, r): orthonormal basis with ``E' N = 0``. c, C, J_q and N are those of the module's docstring.
    `w` (..., m, r): ``E' c``. `A` (..., m, r, P): ``E' C``. `B` (..., m, r, n): ``E' J_q``.
    """

    E: FloatArray
    w: FloatArray
    A: FloatArray
    B: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Rates:
    """Linear function for the step of the unsensed angles: ``du = -(constant + by_x dx + by_q e + N_inverse d)``.

    dx are steps of P parameters, e corrections of n joints, and d deflections of the fixture (k closure components).
    `constant` (m, U): ``N+ (c - J_q e0)``, with e0 the joint corrections at which the loops were linearised.
    `by_x` (m, U, P): ``N+ C``. `by_q` (m, U, n): ``N+ J_q``. `N_inverse` (m, U, k): ``N+``, the left inverse of N.
    The module's docstring defines c, C, J_q and N.
    """

    constant: FloatArray
    by_x: FloatArray
    by_q: FloatArray
    N_inverse: FloatArray

    @classmethod
    def of(cls, error: LoopError, e: FloatArray) -> Rates:
        """Return the coefficients for loops with closure error `error`, linearised at joint corrections e (m, n)."""
        N_inverse = left_inverse(error.jac_u)
        misclosure = error.residual[..., None] - error.jac_q @ e[..., None]
        return cls(
            constant=(N_inverse @ misclosure)[..., 0],
            by_x=N_inverse @ error.jac_x,
            by_q=N_inverse @ error.jac_q,
            N_inverse=N_inverse,
        )

    def unsensed_step(self, dx: FloatArray, e: FloatArray, deflection: FloatArray) -> FloatArray:
        """Change of the unsensed angles (m, U) for steps dx (P,), corrections e (m, n) and deflections (m, k)."""
        displacement = self.constant + self.by_x @ dx + (self.by_q @ e[..., None])[..., 0]
        return np.asarray(-displacement - (self.N_inverse @ deflection[..., None])[..., 0])


def reduced_equations(error: LoopError) -> ReducedEquations:
    """Return the linearised loop equations without the unsensed angles (see the module)."""
    E = left_null_space(error.jac_u)
    Et = np.swapaxes(E, -1, -2)
    return ReducedEquations(
        E=E, w=(Et @ error.residual[..., None])[..., 0], A=Et @ error.jac_x, B=Et @ error.jac_q
    )


def close_loops(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    *,
    sigma_rad: FloatArray | None = None,
    u: FloatArray | None = None,
    max_iterations: int = 30,
    tolerance: float = 1e-12,
) -> ClosedPoses:
    """Correct joint angles `q` (m, n) by Newton's method until the loops close with the parameters `x` (P,).

    `sigma_rad` (n,): standard deviations of the joints; equal by default. Each step is the one with the smallest
    ``|dq / sigma|``; a joint with sigma 0 does not move. `u` (m, U): unsensed angles to start from; by default the
    model's `initial_unsensed`; these change freely. All angles are in rad.
    """
    if len(q) > BLOCK_POSES:
        # Poses are closed in blocks, so that the Jacobians of all are never in memory at once.
        parts = (
            close_loops(
                part, x, part_q,
                sigma_rad=sigma_rad, u=None if u is None else u[poses],
                max_iterations=max_iterations, tolerance=tolerance,
            )
            for (part, part_q), poses in zip(pose_blocks(model, q), pose_slices(len(q)), strict=True)
        )  # fmt: skip
        return join_poses(parts, "q", "u", "closed")
    q = np.array(q, dtype=np.float64)
    u = np.array(model.initial_unsensed(x, q) if u is None else u, dtype=np.float64)
    sigma = np.ones(q.shape[-1]) if sigma_rad is None else np.asarray(sigma_rad)
    size, step_size = np.empty(len(q)), np.full(len(q), np.inf)
    going, part_model = np.arange(len(q)), model
    for iteration in range(max_iterations + 1):
        error = part_model.loop(x, q[going], u[going])
        size[going] = np.abs(error.residual).max(-1, initial=0.0)
        # A pose that cannot be closed any further keeps its last state.
        open_still = (size[going] >= tolerance) & (step_size[going] > STALLED_RAD)
        if iteration == max_iterations or not open_still.any():
            break
        if not open_still.all():
            going = going[open_still]
            error = select_poses(error, open_still, *LoopError.__slots__)
            part_model = model.at_poses(going)
        dq, du = newton_step(error, sigma)
        longest = np.concatenate((np.abs(dq), np.abs(du)), axis=-1).max(-1, keepdims=True)
        shrink = np.minimum(1.0, LONGEST_CORRECTION_RAD / np.maximum(longest, 1e-300))
        q[going] += dq * shrink
        u[going] += du * shrink
        step_size[going] = longest[:, 0]
    return ClosedPoses(q=q, u=u, closed=size < max(100.0 * tolerance, 1e-9))


def measure_with_fixed(joints: Sequence[int], joint_count: int) -> FloatArray:
    """Return `sigma_rad` (n,) for `close_loops`: 0 for `joints` (1-based), which then do not move, 1 for all others."""
    return np.where(np.isin(np.arange(1, joint_count + 1), joints), 0.0, 1.0)


def newton_step(error: LoopError, sigma: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Return the joint corrections (m, n) and the steps of the unsensed angles (m, U) that close linearised loops.

    The corrections have the smallest ``|dq / sigma|``: with S = diag(sigma) and ``B = E' J_q S``, the correction
    divided by sigma is ``-B' (B B')^-1 E' c``. If B is rank-deficient, the part that no joint can close is left open.
    """
    reduced = reduced_equations(error)
    w, B = reduced.w[..., None], reduced.B * sigma
    Bt = np.swapaxes(B, -1, -2)
    V, unit = B @ Bt, np.eye(B.shape[-2])
    largest = np.diagonal(V, axis1=-2, axis2=-1).max(-1, initial=0.0)
    # Pivots no larger than a ridge at the level of rounding show a rank deficiency.
    ridge = SINGULAR**2 * largest + TINY
    pivots = np.diagonal(np.linalg.cholesky(V + ridge[..., None, None] * unit), axis1=-2, axis2=-1)
    # Rounding errors grow towards the last pivot: for an exactly stretched arm it is as large as 20 ridges, and for
    # fewer joints than equations as large as 1500.
    weak = (pivots**2).min(-1, initial=np.inf) < 1000.0 * ridge
    weak |= np.count_nonzero(sigma) < B.shape[-2]
    dq = -(Bt @ np.linalg.solve(np.where(weak[..., None, None], unit, V), w))[..., 0]
    if weak.any() and sigma.any():
        dq[weak] = -(np.linalg.pinv(B[weak], rcond=SINGULAR) @ w[weak])[..., 0]
    dq *= sigma
    return dq, unsensed_step(error, (error.jac_q @ dq[..., None])[..., 0])


def unsensed_step(error: LoopError, displacement: FloatArray) -> FloatArray:
    """Return the step of the unsensed angles (..., m, U) that cancels ``error.residual + displacement`` (..., m, k)."""
    return -(left_inverse(error.jac_u) @ (error.residual + displacement)[..., None])[..., 0]


def left_null_space(N: FloatArray) -> FloatArray:
    """Return E (..., k, k - U), with orthonormal columns and ``E' N = 0``, for N (..., k, U) of rank U.

    Householder's reflections turn the columns of N, one after the other, into the first U axes. In reverse order, they
    turn the other axes into the columns of E. If N has a single column, as for a hinge, one reflection H is enough.
    With a the first component of this column (scaled to length 1), b the vector of the rest, and s = sign(a),

        H = [-s a  -s b'; -s b  1 - b b' / (1 + |a|)],      E = H without its first column.
    """
    k, unsensed = N.shape[-2:]
    if unsensed == 0:
        return np.broadcast_to(np.eye(k), (*N.shape[:-1], k))
    if unsensed > 1:
        return np.asarray(np.linalg.qr(N, mode="complete")[0][..., unsensed:])
    column = N[..., 0]
    length = np.sqrt((column * column).sum(-1, keepdims=True))
    # A column of zeros has no direction; the first axis is as good as any.
    unit = np.where(length > 0.0, column / np.where(length > 0.0, length, 1.0), np.eye(k)[0])
    a, b = unit[..., :1], unit[..., 1:]
    E = np.empty((*unit.shape, k - 1))
    E[..., 0, :] = -np.where(a < 0.0, -1.0, 1.0) * b
    E[..., 1:, :] = np.eye(k - 1) - b[..., :, None] * (b / (1.0 + np.abs(a)))[..., None, :]
    return E


def left_inverse(N: FloatArray) -> FloatArray:
    """Return the left inverse ``N+`` (..., U, k) of N (..., k, U); a zero column of N gives a row of zeros."""
    Nt = np.swapaxes(N, -1, -2)
    if N.shape[-1] == 1:
        length = (N * N).sum(-2, keepdims=True)
        return Nt / np.where(length > 0.0, length, np.inf)
    square = Nt @ N
    ridge = SINGULAR**2 * np.trace(square, axis1=-2, axis2=-1) + TINY
    return np.asarray(np.linalg.solve(square + ridge[..., None, None] * np.eye(N.shape[-1]), Nt))
