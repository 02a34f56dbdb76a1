"""Tool position uncertainty: the covariance of the parameters propagated through the chain."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.closing import close_loops
from solver.estimators.estimate import Estimate
from solver.loops.closure import ClosureModel

POSES_AT_ONCE = 2000
"""Poses at a time: memory stays flat."""


@dataclass(frozen=True, slots=True, kw_only=True)
class TipSigma:
    """Standard deviation of the hand's distance from where the parameters say it is, m.

    Attributes
    ----------
    rms, worst
        Over the poses of the calibration.
    """

    rms: float
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Spread:
    """Distances over many poses, m: root mean square, what 95 % of them stay below, and the largest."""

    rms: float
    most: float
    worst: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HeldOffset:
    """An offset of which nothing is known but its value in the arm's file.

    Attributes
    ----------
    rate_m_per_rad
        How far the hand moves with what it is off, rms over the joints' ranges.
    """

    name: str
    value_rad: float
    rate_m_per_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HandAccuracy:
    """What a calibration brings where the arm is used: its hand's distance from where it was believed.

    Attributes
    ----------
    before
        Between the hand by the arm file's own entries and by the calibrated ones, as the arm's base sees
        it; where the fixture stood and how the hand held it have no part in that.
    after
        What is left by the covariance of the parameters, one standard deviation.
    poses
        How many, evenly over all joints' ranges.
    holds_for
        Offsets that were not sought and of which no file states how well they are known: `after` holds
        only where they are what they were held at.
    """

    before: Spread
    after: Spread
    poses: int
    holds_for: tuple[HeldOffset, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class TrueErrors:
    """How far a calibration is from the truth, which only the simulator of an arm knows.

    Attributes
    ----------
    inside_95, of
        How many true values lie within the 95 % intervals of their entries, of how many.
    tool_rms_m, predicted_rms_m
        Distance of the tool from where it truly is, rms over the joints' ranges, and what the covariance
        of the parameters predicts for it.
    """

    inside_95: int
    of: int
    tool_rms_m: float
    predicted_rms_m: float


def spread_of(distances_m: FloatArray) -> Spread:
    """Sum distances up."""
    return Spread(
        rms=float(np.sqrt(np.mean(distances_m**2))),
        most=float(np.quantile(distances_m, 0.95)),
        worst=float(distances_m.max()),
    )


def spread_along(J: FloatArray, C: FloatArray) -> FloatArray:
    """Return ``trace(J C J')`` (m,) of rates J (m, 3, P) with parameters of covariance C (P, P)."""
    # One product for all poses: many small ones cost more than all of its arithmetic.
    rows = J.reshape(-1, len(C))
    return np.asarray(np.maximum(((rows @ C) * rows).reshape(len(J), -1).sum(-1), 0.0))


def tip_sigma(model: ClosureModel, estimate: Estimate, q: FloatArray) -> TipSigma:
    """Propagate the covariance of all parameters to the hand's position at poses `q` (m, n), rad.

    With J = dp/dx the rate of the closure's position rows, ``sigma^2 = trace(J C J')`` at each pose. The
    hand is seen from the arm's own base: where the fixture stands (`ClosureModel.ground_side`) has no
    part in that. Errors of the readings come on top.
    """
    x, C = estimate.x, estimate.covariance
    ground = set(model.ground_side)
    base = [p.name in ground for p in model.parameters]
    squares = []
    for start in range(0, len(q), POSES_AT_ONCE):
        here = np.arange(start, min(start + POSES_AT_ONCE, len(q)))
        part, at = model.at_poses(here), q[here]
        if model.unsensed_joints:
            closed = close_loops(part, x, at)
            at, u = closed.q, closed.u
        else:
            u = part.initial_unsensed(x, at)
        J = np.array(part.loop(x, at, u).jac_x[..., -3:, :])
        J[..., base] = 0.0
        squares.append(spread_along(J, C))
    square = np.concatenate(squares)
    return TipSigma(rms=float(np.sqrt(square.mean())), worst=float(np.sqrt(square.max())))
