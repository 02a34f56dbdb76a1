"""Tool position uncertainty: the covariance of the parameters propagated through the chain."""

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.closing import close_loops
from solver.estimators.estimate import Estimate
from solver.loops.closure import ClosureModel, pose_blocks


@dataclass(frozen=True, slots=True, kw_only=True)
class TipSigma:
    """Tool position uncertainty: standard deviation of computed minus true position, m.

    `rms`, `worst`: root mean square and largest value over the poses of the calibration.
    """

    rms: float
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Distances over many poses, m: root mean square, 95 % quantile, and the largest."""

    rms: float
    most: float
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOffset:
    """A fixed offset of unknown uncertainty.

    `rate_m_per_rad`: displacement of the tool per error of the offset, rms over the joints' ranges.
    """

    name: str
    value_rad: float
    rate_m_per_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredOffset:
    """Offset of a joint whose readings were not used: the joint's angle in the closed loop minus its reading.

    `value_rad`, `sigma_rad`: mean and standard deviation of this difference over the poses; the standard deviation
    includes the linearity deviation of the sensor.
    """

    value_rad: float
    sigma_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HandAccuracy:
    """Tool position error before and after a calibration, over the joints' ranges.

    `before`: distance between the tool positions from arm file and calibration in the arm's base frame.
    `after`: standard deviation of the remaining error, from the covariance of the parameters.
    `poses`: number of poses, evenly spread over all joints' ranges.
    `holds_for`: fixed offsets whose uncertainty no file states: `after` is valid only if their fixed values are right.
    `stated`: parameters known from files rather than from the poses; () if their uncertainty contributes little.
    `after_by_poses`: `after` without the uncertainty of parameters known from files; None if it contributes little.
    """

    before: Spread
    after: Spread
    poses: int
    holds_for: tuple[HeldOffset, ...] = ()
    stated: tuple[str, ...] = ()
    after_by_poses: Spread | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueErrors:
    """True errors of a calibration, which are known only for a simulated arm.

    `inside_95`: number of entries whose 95 % interval contains the true value. `of`: number of all entries.
    `tool_rms_m`: true tool position error of the identified entries with exact readings, rms over the joints' ranges.
    `predicted_rms_m`: this error as predicted from the covariance of the parameters.
    """

    inside_95: int
    of: int
    tool_rms_m: float
    predicted_rms_m: float


def spread_of(distances_m: FloatArray) -> Spread:
    """Return the root mean square, 95 % quantile and maximum of distances (m,), m."""
    return Spread(
        rms=float(np.sqrt(np.mean(distances_m**2))),
        most=float(np.quantile(distances_m, 0.95)),
        worst=float(distances_m.max()),
    )


def spread_along(J: FloatArray, C: FloatArray) -> FloatArray:
    """Return a point's variance ``trace(J C J')`` at m poses, from derivatives J (m, 3, P) and covariance C (P, P)."""
    # One product for all poses is faster than many small ones.
    rows = J.reshape(-1, len(C))
    return np.asarray(np.maximum(((rows @ C) * rows).reshape(len(J), -1).sum(-1), 0.0))


def tip_sigma(model: ClosureModel, estimate: Estimate, q: FloatArray) -> TipSigma:
    """Propagate the covariance of all parameters to the tool position at poses `q` (m, n), rad.

    At each pose, ``sigma^2 = trace(J C J')``. J holds the derivatives of the closure's position rows by the parameters,
    and C is the covariance of the parameters. The tool position is that in the arm's base frame, so that the fixture's
    place on the table (`ClosureModel.ground_side`) does not matter. Errors of the readings are not included.
    """
    x, C = estimate.x, estimate.covariance
    ground = set(model.ground_side)
    base = [p.name in ground for p in model.parameters]
    squares = []
    for part, at in pose_blocks(model, q):
        if model.unsensed_joints:
            closed = close_loops(part, x, at)
            error = part.loop(x, closed.q, closed.u)
        else:
            error = part.loop(x, at, part.initial_unsensed(x, at))
        J = np.array(error.jac_x[..., -3:, :])
        J[..., base] = 0.0
        squares.append(spread_along(J, C))
    square = np.concatenate(squares)
    return TipSigma(rms=float(np.sqrt(square.mean())), worst=float(np.sqrt(square.max())))
