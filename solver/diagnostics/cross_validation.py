"""Tests poses (a part of a set, or new poses) against predictions from other poses; finds shifts common to new poses.

The fitted and the new poses form one mixed model. The fitted poses determine the parameters and the errors common to
all poses (of sensors, sag and compliance). This estimate, with its covariance, is the prior for the new poses.
"""

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.poses import canonical_order
from solver.diagnostics.limits import FALSE_ALARM_PROBABILITY
from solver.diagnostics.pose_adjustment import adjust_poses
from solver.diagnostics.statistics import (
    Chi2Test,
    chi2_limit,
    chi2_probability,
    chi2_test,
    covariance_root,
)
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from solver.estimators.estimate import Estimate, closure_at_readings
from solver.estimators.implicit import NoiseModel
from solver.estimators.linear_fit import LinearFit, inverse_root
from solver.loops.closure import ClosureModel, ClosureSigmas, closure_sigmas


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOutPoses:
    """Test results of poses that were not used to estimate the parameters.

    `chi2`: test of all poses together; includes the uncertainty of the parameters.
    `pose_chi2` (m,): chi2 of each pose alone. `pose_probability` (m,): probability of a larger chi2 by chance.
    `sigmas`: sigma_pos and sigma_ori of the closure errors at the readings.
    `closed`: (m,) bool: whether the pose's loop can be closed at all with these parameters.
    """

    chi2: Chi2Test
    pose_chi2: FloatArray
    pose_probability: FloatArray
    sigmas: ClosureSigmas
    closed: BoolArray


@dataclass(frozen=True, slots=True, kw_only=True)
class HoldOut:
    """Results of a hold-out, in which each part of a pose set is predicted from the rest.

    `parts`: test of each part against its prediction from the rest.
    `sigmas`: sigma_pos and sigma_ori over all poses; each pose is tested with parameters estimated without its part.
    `inside_sigmas`: sigma_pos and sigma_ori of the fitted poses, over all fits. They should be similar to `sigmas`.
    """

    parts: tuple[Chi2Test, ...]
    sigmas: ClosureSigmas
    inside_sigmas: ClosureSigmas

    @staticmethod
    def upgraded_record(data: Mapping[str, Any]) -> Mapping[str, Any]:
        """Convert the record of a hold-out to the current format; earlier versions kept an estimate for each part."""
        parts = [part.get("verification", {"chi2": part})["chi2"] for part in data["parts"]]
        return {**data, "parts": parts}


def verify(
    model: ClosureModel, x: FloatArray, covariance: FloatArray, q: FloatArray, noise: NoiseModel
) -> HeldOutPoses:
    """Test poses `q` (m, n), rad, with parameters `x` (P,) and their `covariance` C (P, P).

    Pose i, after adjustment, has the misclosure w_i with covariance V_i and parameter Jacobian A_i. Its chi2 is
    ``w_i' (V_i + A_i C A_i')^-1 w_i``, with as many degrees of freedom as a pose has equations. The error of `x` is the
    same in all poses, so chi2 of all poses together is not the sum of the poses' chi2. Raises `ValueError` if there is
    no pose.
    """
    if len(q) == 0:
        raise ValueError("there are no poses to verify")
    adjusted = adjust_poses(model, x, q, noise)
    system = adjusted.system
    m, r, P = system.A.shape
    S = adjusted.V + system.A @ covariance @ np.swapaxes(system.A, -1, -2)
    pose_chi2 = np.einsum("mr,mr->m", system.w, np.linalg.solve(S, system.w[..., None])[..., 0])
    L = np.linalg.cholesky(adjusted.V)
    w = np.linalg.solve(L, system.w[..., None]).reshape(-1)
    shared = np.linalg.solve(L, system.A).reshape(m * r, P) @ covariance_root(covariance)
    inside = np.linalg.solve(np.eye(P) + shared.T @ shared, shared.T @ w)
    together = float(w @ w - (shared.T @ w) @ inside)
    return HeldOutPoses(
        chi2=chi2_test(together, m * r),
        pose_chi2=pose_chi2,
        pose_probability=chi2_probability(r, pose_chi2),
        sigmas=closure_at_readings(model, x, q).sigmas,
        closed=adjusted.converged,
    )


FOLDS, FAR_SHARE = 5, 0.2
"""`FOLDS`: number of parts of a pose set, each of which is predicted from the others. `FAR_SHARE`: share of all poses
that `far_block` returns."""


def fold_poses(q: FloatArray) -> tuple[IntArray, ...]:
    """Split poses (m, n) into `FOLDS` similar parts, independent of the order of the poses."""
    order = canonical_order(q)
    return tuple(np.sort(order[k::FOLDS]) for k in range(FOLDS))


def far_block(q: FloatArray) -> IntArray:
    """Return the indices of a block of poses so far from the rest that predicting them is an extrapolation.

    The block consists of the pose farthest from the mean and this pose's nearest neighbours, together `FAR_SHARE` of
    all poses. For the distances, each joint's readings are divided by their span over all poses.
    """
    count = round(FAR_SHARE * len(q))
    order = canonical_order(q)
    spread = np.ptp(q, axis=0)
    scaled = ((q - q.mean(axis=0)) / np.where(spread > 0.0, spread, 1.0))[order]
    seed = int(np.argmax(np.round((scaled**2).sum(-1), 12)))
    distance = np.round(((scaled - scaled[seed]) ** 2).sum(-1), 12)
    return np.sort(order[np.argsort(distance, kind="stable")[:count]])


def hold_out(
    estimate_of: Callable[[IntArray], Estimate],
    model: ClosureModel,
    q: FloatArray,
    fit: LinearFit,
    order: IntArray,
    parts: tuple[IntArray, ...],
) -> HoldOut:
    """Test each part of the poses against its prediction from all other poses.

    Raises `TooFewPosesError` if the other poses are too few for an estimate.

    `estimate_of`: function that fits the poses with given indices in `q`. `fit`: fit of all poses, from which chi2 is
    calculated. `order` (m,): index in `q` of each pose of `fit`. `parts`: indices in `q` of each part's poses.
    """
    tested, outside, inside, rows = [], [], [], 0
    for poses in parts:
        estimate = estimate_of(np.setdiff1d(np.arange(len(q)), poses))
        ((chi2, dof),) = fit.held_out_chi2(np.flatnonzero(np.isin(order, poses)))
        tested.append(chi2_test(chi2, max(dof, 1)))
        error = closure_at_readings(model.at_poses(poses), estimate.x, q[poses])
        rows = error.rotation_rows
        outside.append(error.residual)
        inside.append(estimate.residual)
    return HoldOut(
        parts=tuple(tested),
        sigmas=closure_sigmas(np.concatenate(outside), rows),
        inside_sigmas=closure_sigmas(np.concatenate(inside), rows),
    )


NOT_KNOWN = 0.1
"""Prior standard deviation (rad, m) of parameters that only the poses determine."""

SEEN = 1e-9
"""A direction with less than this share of the largest information counts as undetermined."""


@dataclass(frozen=True, slots=True, kw_only=True)
class CommonShift:
    """A shift of a joint's offset or of the fixture that is the same in all tested poses.

    `subject`: number of the joint, or name of the half of the fixture.
    `size`, `sigma`: the shift and its standard deviation, rad or m; None if the shift has several components.
    `chi2`: reduction of chi2 when the shift is fitted. `threshold`: if there is no shift, the probability that any
    subject's `chi2` exceeds its threshold is `FALSE_ALARM_PROBABILITY`.
    """

    subject: str
    size: float | None
    sigma: float | None
    chi2: float
    threshold: float


def predicted_residuals(
    fit: LinearFit, later: BoolArray, given: tuple[FloatArray, FloatArray] | None = None
) -> WhitenedResiduals:
    """Return the residuals of the `later` poses (mask (m,)) against their prediction from the other poses of `fit`.

    `given`: values (h,), relative to the linearisation point, and covariance (h, h) of the h parameters without a
    prior. If `given` is not None, the prediction is from these values instead of the other poses.
    """
    width, flat = fit.design.width, fit.design.flat_count
    gram, right = np.zeros((width, width)), np.zeros(width)
    rows = []
    for part in fit.parts():
        new = later[part.poses]
        before = part.M[~new].reshape(-1, width)
        gram += before.T @ before
        right += part.w[~new].reshape(-1) @ before
        rows.append((part.L_inverse[new], part.M[new], part.w[new]))
    whitener, M, w = (np.concatenate(parts) for parts in zip(*rows, strict=True))
    if given is None:
        precision = np.repeat((NOT_KNOWN**-2, 1.0), (flat, width - flat))
        half = inverse_root(gram + np.diag(precision))[0]
        coefficients = -(half @ (half.T @ right))
    else:
        half, coefficients = np.eye(width), np.zeros(width)
        half[:flat, :flat] = covariance_root(given[1])
        coefficients[:flat] = given[0]
    m, r = w.shape
    columns = M.reshape(m * r, width)
    N, y = columns @ half, w.reshape(-1) + columns @ coefficients
    # (I + N N')^-1 = I - U U'
    U = N @ inverse_root(np.eye(width) + N.T @ N)[0]
    white = y - U @ (U.T @ y)
    return WhitenedResiduals(
        whitener=whitener,
        U=U.reshape(m, r, width),
        white=white.reshape(m, r),
        chi2=float(y @ white),
        to_x=np.zeros((0, width)),
        dof=m * r,
    )


def shifted(
    residuals: WhitenedResiduals,
    subjects: Mapping[str, FloatArray],
    *,
    variance_factor: float = 1.0,
) -> CommonShift | None:
    """Return the most significant shift of a single subject, equal in all poses; None if no shift is significant.

    `subjects`: what may have shifted (a joint or a half of the fixture), by name; the value (m, r, c) is the change of
    each pose's r misclosures per unit of each of the c components of the shift.
    `variance_factor`: largest ratio of actual variances to those of `residuals`.
    """
    shifts = []
    for name, columns in subjects.items():
        s, information = residuals.score(columns)
        values, vectors = np.linalg.eigh(information)
        determined = values > SEEN * max(float(values[-1]), 1e-300)
        single = columns.shape[-1] == 1 and bool(determined.all())
        dof = max(int(determined.sum()), 1)
        shifts.append(
            CommonShift(
                subject=name,
                size=float(s[0] / values[0]) if single else None,
                sigma=float(values[0] ** -0.5) if single else None,
                chi2=float(((vectors.T @ s)[determined] ** 2 / values[determined]).sum()),
                threshold=variance_factor
                * float(chi2_limit(dof, FALSE_ALARM_PROBABILITY / len(subjects))),
            )
        )
    best = max(shifts, key=lambda shift: shift.chi2 - shift.threshold, default=None)
    return best if best is not None and best.chi2 > best.threshold else None
