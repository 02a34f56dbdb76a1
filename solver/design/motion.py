"""How a closed chain moves at its poses: tangent directions and what each choice of drive joints makes of them."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.closing import left_null_space
from solver.loops.closure import ClosureModel

RANK_TOLERANCE = 1e-6


@dataclass(frozen=True, slots=True, kw_only=True)
class ChainMotion:
    """First-order motion of a closed chain at m closed poses.

    Attributes
    ----------
    tangent
        (m, n + U, d): orthonormal directions of the self-motion, arm joints first, then the unsensed
        angles of the model.
    jacobian
        (m, k, n + U): closure Jacobian of all joints.
    joint_count
        n.
    """

    tangent: FloatArray
    jacobian: FloatArray
    joint_count: int

    @property
    def degrees(self) -> int:
        """Mobility d: exactly this many joints belong in position mode."""
        return int(self.tangent.shape[-1])

    def leverage(self, drives: Sequence[int]) -> FloatArray:
        """How much of any motion of the chain the drive joints see, (m,), 0 at a fold, at most 1.

        It is the smallest singular value of the drives' rows of the tangent: moving the drives by
        one radian moves the whole chain by at most its inverse.
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

    def orientation(self, drives: Sequence[int]) -> FloatArray:
        """Signed volume of the drives' rows of the tangent (m,); its sign is the tangent's own."""
        return np.asarray(np.linalg.det(self.tangent[:, [j - 1 for j in drives], :]))

    def rates(self, drives: Sequence[int]) -> FloatArray:
        """Rate of every arm joint per rate of each drive joint, (m, n, d); huge near a fold."""
        rows = self.tangent[:, [j - 1 for j in drives], :]
        # The ridge keeps an exact fold from raising: its rates are as huge as they should be.
        inverse = np.linalg.inv(rows + 1e-12 * np.eye(rows.shape[-1]))
        return np.asarray(self.tangent[:, : self.joint_count] @ inverse)

    def passive_conditioning(self, drives: Sequence[int]) -> FloatArray:
        """Smallest singular value of the passive joints' closure Jacobian (m,), 1 m : 1 rad."""
        passive = [c for c in range(self.jacobian.shape[-1]) if c + 1 not in drives]
        return np.asarray(np.linalg.svd(self.jacobian[..., passive], compute_uv=False)[..., -1])

    def fixture_load(self, drives: Sequence[int]) -> FloatArray:
        """Wrench on the fixture for torques on the passive joints (m,): Frobenius norm of J_p^-1."""
        passive = [c for c in range(self.jacobian.shape[-1]) if c + 1 not in drives]
        return np.asarray(
            np.linalg.norm(np.linalg.pinv(self.jacobian[..., passive]), axis=(-2, -1))
        )


def chain_motion(model: ClosureModel, x: FloatArray, q: FloatArray, u: FloatArray) -> ChainMotion:
    """First-order motion at closed poses `q` (m, n), `u` (m, U), rad, for parameters `x` (P,).

    Poses whose closure Jacobian loses rank there get arbitrary extra directions: judge mobility with
    `fixtures.setup_checks` at the poses where it matters.
    """
    error = model.loop(x, q, u)
    J = np.concatenate((error.jac_q, error.jac_u), axis=-1)
    equations, joints = J.shape[-2:]
    if joints <= equations:
        raise ValueError(f"{joints} joints in {equations} closure equations leave no motion")
    return ChainMotion(
        tangent=np.asarray(left_null_space(np.swapaxes(J, -1, -2))),
        jacobian=J,
        joint_count=q.shape[-1],
    )
