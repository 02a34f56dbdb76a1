"""Held-out poses: parts of a pose set predicted by the rest, and verification of new poses."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.poses import canonical_order
from solver.diagnostics.pose_adjustment import adjust_poses
from solver.diagnostics.statistics import Chi2Test, chi2_test
from solver.estimators.estimate import ClosureSigmas, Estimate, closure_at_readings, closure_sigmas
from solver.estimators.implicit import NoiseModel
from solver.loops.closure import ClosureModel

Estimator = Callable[[IntArray], Estimate]
"""Fits the model of a pose set to a selection of its poses."""


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutPoses:
    """Poses tested with parameters that were fixed before they were taken.

    Attributes
    ----------
    chi2
        Test of all poses together, the parameters' own uncertainty taken into account.
    pose_chi2, pose_probability
        The same for each pose alone (m,), and the chance of a larger value.
    sigmas
        sigma_pos and sigma_ori at the measured joints.
    closed
        (m,) bool: whether the pose's loop can be closed at all under these parameters.
    flipped
        Indices of poses on the flipped branch.
    """

    chi2: Chi2Test
    pose_chi2: FloatArray
    pose_probability: FloatArray
    sigmas: ClosureSigmas
    closed: BoolArray
    flipped: tuple[int, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOut:
    """One part of a pose set tested with an estimate from the rest.

    Attributes
    ----------
    poses
        Indices of the poses held out.
    estimate
        Estimate from the others.
    verification
        Test of the held-out poses with that estimate.
    """

    poses: IntArray
    estimate: Estimate
    verification: HeldOutPoses


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldOut:
    """All parts of a hold-out together.

    Attributes
    ----------
    parts
        One entry per part.
    sigmas
        sigma_pos and sigma_ori over all poses held out, each closed with the parameters of the rest.
    inside_sigmas
        The same figures for the fitted poses, as a mean over the parts (rms): the two should be similar.
    """

    parts: tuple[HeldOut, ...]
    sigmas: ClosureSigmas
    inside_sigmas: ClosureSigmas


def verify(
    model: ClosureModel,
    x: FloatArray,
    covariance: FloatArray,
    q: FloatArray,
    noise: NoiseModel,
) -> HeldOutPoses:
    """Test poses `q` (m, n), rad, with parameters `x` (P,) of covariance (P, P).

    For the misclosure w_i of the adjusted pose, ``w_i' (V_i + A_i C A_i')^-1 w_i`` is chi2 with as many degrees of
    freedom as a pose has equations. Together the poses share the error of `x`, so the common test is not their sum.

    Raises
    ------
    ValueError
        There is no pose.
    """
    from scipy.special import chdtrc

    if len(q) == 0:
        raise ValueError("there are no poses to verify")
    adjusted = adjust_poses(model, x, q, noise)
    system = adjusted.system
    m, r, P = system.A.shape
    S = system.V + system.A @ covariance @ np.swapaxes(system.A, -1, -2)
    pose_chi2 = np.einsum("mr,mr->m", system.w, np.linalg.solve(S, system.w[..., None])[..., 0])
    L = np.linalg.cholesky(system.V)
    w = np.linalg.solve(L, system.w[..., None]).reshape(-1)
    values, vectors = np.linalg.eigh(covariance)
    root = vectors * np.sqrt(np.maximum(values, 0.0))
    shared = np.linalg.solve(L, system.A).reshape(m * r, P) @ root
    inside = np.linalg.solve(np.eye(P) + shared.T @ shared, shared.T @ w)
    together = float(w @ w - (shared.T @ w) @ inside)
    error = closure_at_readings(model, x, q)
    return HeldOutPoses(
        chi2=chi2_test(together, m * r),
        pose_chi2=pose_chi2,
        pose_probability=np.asarray(chdtrc(r, pose_chi2)),
        sigmas=closure_sigmas(error.residual, error.rotation_rows),
        closed=adjusted.converged,
        flipped=tuple(int(i) for i in np.flatnonzero(error.flipped)),
    )


def fold_poses(q: FloatArray, folds: int) -> tuple[IntArray, ...]:
    """Split poses (m, n) into `folds` similar parts, independent of the order of the poses.

    Raises
    ------
    ValueError
        There are fewer than two folds, or fewer poses than folds.
    """
    if not 2 <= folds <= len(q):
        raise ValueError(f"{len(q)} poses cannot be split into {folds} folds")
    order = canonical_order(q)
    return tuple(np.sort(order[k::folds]) for k in range(folds))


def far_block(q: FloatArray, share: float = 0.2) -> IntArray:
    """Indices of a block of poses far from the rest: extrapolation, not interpolation.

    The pose farthest from the middle of the set, in units of each joint's spread, and its nearest
    neighbours.

    Raises
    ------
    ValueError
        `share` leaves no pose on one side.
    """
    count = round(share * len(q))
    if not 0 < count < len(q):
        raise ValueError(f"a share of {share:g} of {len(q)} poses leaves one side empty")
    order = canonical_order(q)
    spread = np.ptp(q, axis=0)
    scaled = ((q - q.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0))[order]
    seed = int(np.argmax(np.round((scaled**2).sum(-1), 12)))
    distance = np.round(((scaled - scaled[seed]) ** 2).sum(-1), 12)
    return np.sort(order[np.argsort(distance, kind="stable")[:count]])


def hold_out(
    estimator: Estimator,
    model: ClosureModel,
    q: FloatArray,
    noise: NoiseModel,
    parts: tuple[IntArray, ...],
) -> HoldOut:
    """Estimate without each part in turn and verify the part with that estimate.

    Raises
    ------
    TooFewPosesError
        The rest is too small for an estimate.
    """
    everything = np.arange(len(q))
    variance = np.broadcast_to(noise.joint_variance, q.shape)

    def noise_of(poses: IntArray) -> NoiseModel:
        return NoiseModel(joint_variance=variance[poses], fixture_variance=noise.fixture_variance)

    found, outside, inside, rows = [], [], [], 0
    for poses in parts:
        rest = np.setdiff1d(everything, poses)
        estimate = estimator(rest)
        there = model.at_poses(poses)
        verification = verify(there, estimate.x, estimate.covariance, q[poses], noise_of(poses))
        found.append(HeldOut(poses=poses, estimate=estimate, verification=verification))
        error = closure_at_readings(there, estimate.x, q[poses])
        rows = error.rotation_rows
        outside.append(error.residual)
        inside.append(estimate.residual)
    return HoldOut(
        parts=tuple(found),
        sigmas=closure_sigmas(np.concatenate(outside), rows),
        inside_sigmas=closure_sigmas(np.concatenate(inside), rows),
    )
