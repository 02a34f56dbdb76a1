"""Motion of a closed chain: its tangents at poses, predicted straight moves of the drives, and limits of motion."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import BoolArray, FloatArray
from solver.closing import close_loops, left_null_space, measure_with_fixed
from solver.loops.closure import ClosureModel


@dataclass(frozen=True, slots=True, kw_only=True)
class Ranges:
    """Lower and upper ends of the joints' ranges, each (n,), rad, in sensor coordinates."""

    lower_rad: FloatArray
    upper_rad: FloatArray

    def __post_init__(self) -> None:
        if np.any(self.lower_rad >= self.upper_rad):
            raise ValueError("every lower end must lie below its upper end")

    def within(self, margin_rad: float | FloatArray) -> Ranges:
        """Return the ranges narrowed by `margin_rad` (scalar or (n,)) at both ends."""
        return Ranges(lower_rad=self.lower_rad + margin_rad, upper_rad=self.upper_rad - margin_rad)

    def clearance(self, q: FloatArray) -> FloatArray:
        """Return the distance (...,), rad, of each pose (..., n) from the nearest end of a range; negative outside."""
        return np.asarray(np.minimum(q - self.lower_rad, self.upper_rad - q).min(-1))


@dataclass(frozen=True, slots=True, kw_only=True)
class MotionLimits:
    """Limits of a path.

    `least_leverage`: least allowed leverage of the drive joints, anywhere on the path. `most_rate`: largest allowed
    ratio of the speed of a passive joint to the speed of the fastest drive joint.
    """

    least_leverage: float
    most_rate: float

    def eased(self, share: float) -> MotionLimits:
        """Return wider limits for a `share` below 1: least leverage times `share`, largest rate divided by `share`."""
        return MotionLimits(
            least_leverage=share * self.least_leverage, most_rate=self.most_rate / share
        )


LIMITS = MotionLimits(least_leverage=0.2, most_rate=5.0)
"""Default limits of a path; a campaign relaxes them if no path keeps them."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainMotion:
    """First-order motion, at m closed poses, of a chain with n joints, U unsensed angles and mobility d.

    `tangent` (m, n + U, d): orthonormal directions of the self-motion, in the joint angles, then the unsensed angles.
    `jacobian` (m, k, n + U): derivatives of the k closure components with respect to these angles. `joint_count`: n.
    """

    tangent: FloatArray
    jacobian: FloatArray
    joint_count: int

    @property
    def degrees(self) -> int:
        """Mobility d of the chain, which is also the number of joints that have to be in position mode."""
        return int(self.tangent.shape[-1])

    def leverage(self, drives: Sequence[int]) -> FloatArray:
        """How well the drive joints determine the chain's motion, (m,): from 0 at a singularity to at most 1.

        The leverage is the smallest singular value of the drives' rows of `tangent`. If the drives move by one radian,
        the whole chain moves by at most 1 / leverage.
        """
        rows = self.tangent[:, [j - 1 for j in drives], :]
        if rows.shape[-2:] == (2, 2):
            # Closed form: three orders faster than an SVD for thousands of poses and 21 pairs.
            square = (rows**2).sum((-1, -2))
            det = rows[:, 0, 0] * rows[:, 1, 1] - rows[:, 0, 1] * rows[:, 1, 0]
            root = np.sqrt(np.maximum(square**2 - 4.0 * det**2, 0.0))
            largest = np.sqrt(0.5 * (square + root))
            return np.asarray(np.abs(det) / np.maximum(largest, 1e-300))
        return np.asarray(np.linalg.svd(rows, compute_uv=False)[..., -1])

    def rates(self, drives: Sequence[int]) -> FloatArray:
        """Rate of every arm joint per rate of each drive joint, (m, n, d); very large near a singularity."""
        rows = self.tangent[:, [j - 1 for j in drives], :]
        # The ridge prevents an error at an exact singularity, where the rates become very large.
        inverse = np.linalg.inv(rows + 1e-12 * np.eye(rows.shape[-1]))
        return np.asarray(self.tangent[:, : self.joint_count] @ inverse)

    def passive_conditioning(self, drives: Sequence[int]) -> FloatArray:
        """Smallest singular value (m,) of the passive joints' closure Jacobian; 1 m counts as 1 rad."""
        passive = [c for c in range(self.jacobian.shape[-1]) if c + 1 not in drives]
        return np.asarray(np.linalg.svd(self.jacobian[..., passive], compute_uv=False)[..., -1])


def chain_motion(model: ClosureModel, x: FloatArray, q: FloatArray, u: FloatArray) -> ChainMotion:
    """First-order motion at closed poses `q` (m, n), `u` (m, U), rad, for parameters `x` (P,).

    Raises `ValueError` if the chain has no mobility. If the closure Jacobian loses rank, more directions exist
    than are returned; if this matters, check the mobility with `fixtures.setup_checks`.
    """
    error = model.loop(x, q, u)
    J = np.concatenate((error.jac_q, error.jac_u), axis=-1)
    equations, joints = J.shape[-2:]
    if joints <= equations:
        raise ValueError(f"{joints} joints in {equations} closure equations leave no motion")
    tangent = left_null_space(np.swapaxes(J, -1, -2))
    return ChainMotion(tangent=tangent, jacobian=J, joint_count=q.shape[-1])


LOST_RAD = 0.25
"""If a predicted step has to be corrected by more than this, the chain has jumped to another branch."""


@dataclass(frozen=True, slots=True, kw_only=True)
class DriveTraces:
    """Predicted motion of the chain in b straight moves of the drives; each move is sampled at s + 1 points.

    `q` (b, s + 1, n): angles of all arm joints, rad. `closed` (b,): whether the chain could be followed to the end.
    `leverage` (b,): least leverage of the drive joints on the way (see `ChainMotion.leverage`).
    `rate` (b,): largest ratio of any arm joint's motion to the motion of the drive joint that moves most.
    """

    q: FloatArray
    leverage: FloatArray
    rate: FloatArray
    closed: BoolArray

    def safe(self, ranges: Ranges, limits: MotionLimits) -> BoolArray:
        """Whether each move (b,) can be followed to its end, stays inside `ranges`, and keeps `limits`."""
        return np.asarray(
            self.closed
            & (ranges.clearance(self.q).min(-1) >= 0.0)
            & (self.leverage >= limits.least_leverage)
            & (self.rate <= limits.most_rate)
        )


def drive_straight(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    u: FloatArray,
    drives: Sequence[int],
    targets_rad: FloatArray,
    *,
    steps: int,
) -> DriveTraces:
    """Predict b moves from closed poses `q` (b, n), `u` (b, U) to drive angles `targets_rad` (b, d).

    `drives`: joints (1-based) in position mode; the others are free. `steps`: number of steps along each line.
    """
    columns, n = [j - 1 for j in drives], q.shape[-1]
    fixed = measure_with_fixed(drives, n)
    here, motion = np.concatenate((q, u), axis=-1), chain_motion(model, x, q, u)
    start, trace, leverage = here[:, columns], [here[:, :n]], motion.leverage(drives)
    closed, fastest = np.ones(len(q), dtype=np.bool_), np.zeros(len(q))
    for share in np.linspace(0.0, 1.0, steps + 1)[1:].tolist():
        line = start + share * (targets_rad - start)
        by_drive = line - here[:, columns]
        along = np.linalg.pinv(motion.tangent[:, columns, :]) @ by_drive[..., None]
        velocity = (motion.tangent @ along)[..., 0]
        # Past a singularity the prediction is meaningless: the line is not followed any further.
        lost = np.abs(velocity).max(-1) > 4.0 * LOST_RAD
        velocity[lost] = 0.0
        first = here + velocity
        first[:, columns] = line
        after = close_loops(
            model, x, first[:, :n],
            u=first[:, n:], sigma_rad=fixed, max_iterations=6, tolerance=1e-11,
        )  # fmt: skip
        jumped = np.abs(after.q - first[:, :n]).max(-1) > LOST_RAD
        closed &= after.closed & ~jumped & ~lost
        by_drive = np.abs(by_drive).max(-1)
        step = np.abs(after.q - here[:, :n]).max(-1) / np.maximum(by_drive, 1e-12)
        fastest = np.where(closed & (by_drive > 1e-9), np.maximum(fastest, step), fastest)
        here = np.where(closed[:, None], np.concatenate((after.q, after.u), axis=-1), here)
        trace.append(here[:, :n])
        motion = chain_motion(model, x, here[:, :n], here[:, n:])
        leverage = np.minimum(leverage, motion.leverage(drives))
    return DriveTraces(q=np.stack(trace, axis=1), leverage=leverage, rate=fastest, closed=closed)
