"""Closure error of a chain that should end where it starts, and the derivatives of the error.

The estimators know a fixture only as a `ClosureModel`. There is a subclass for each kind of fixture, which calculates
the closure error and its Jacobians.
"""

from __future__ import annotations

import math
from abc import ABC, abstractmethod
from collections.abc import Collection, Sequence
from dataclasses import dataclass
from enum import Enum
from typing import Self

import numpy as np

from solver.arrays import BLOCK_POSES, BoolArray, FloatArray, IntArray, pose_slices
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, Parameter, nominal_vector, wrap_angles
from solver.loops.endpoint_geometry import Line

Which = IntArray | slice
"""Indices of some parameters or poses, or ``slice(None)`` for all."""


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopError:
    """Closure error of every pose, with the unsensed angles as explicit variables.

    `residual`: c (..., m, k): rotation vector (rad), then position (m), of the end in the fixture's frame; 0 if closed.
    `jac_x` (..., m, k, P), `jac_q` (..., m, k, n), `jac_u` (..., m, k, U): exact derivatives of c with respect to the
    parameters (the paper's C = dc/dphi), the joint angles and the unsensed angles.
    """

    residual: FloatArray
    jac_x: FloatArray
    jac_q: FloatArray
    jac_u: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ReducedError:
    """Closure error with the unsensed angles eliminated, as the paper minimises it.

    `residual` (..., m, r): in the fixture's frame. For a hinge, r is 5: dx and dy (rad), then x, y and z (m) of eq. 13.
    `jac_x` (..., m, r, P): exact derivative of `residual` with respect to the parameters (the paper's C).
    `rotation_rows`: the first `rotation_rows` of the r rows are rotations.
    `flipped` (..., m), bool: whether the pose is on the flipped branch: the tool is upside down on the hinge.
    """

    residual: FloatArray
    jac_x: FloatArray
    rotation_rows: int
    flipped: BoolArray

    @property
    def flipped_poses(self) -> tuple[int, ...]:
        """Indices of poses on the flipped branch."""
        return tuple(np.flatnonzero(self.flipped).tolist())

    @property
    def sigmas(self) -> ClosureSigmas:
        """sigma_pos and sigma_ori of all poses."""
        return closure_sigmas(self.residual, self.rotation_rows)


@dataclass(frozen=True, slots=True, kw_only=True)
class ResidualSigma:
    """A standard deviation of k components in m poses, according to two interpretations of the paper's formula.

    `rms`: sqrt(S / (k m)), with S the sum of squares. Only this interpretation gives values as large as the paper's.
    `as_printed`: sqrt(S) / (k m).
    """

    rms: float
    as_printed: float

    @classmethod
    def of(cls, rows: FloatArray) -> ResidualSigma:
        """Return the standard deviation of residuals (m, k); 0 if there are none."""
        # In one order of memory, so that a residual read from a journal has the same sum to the last digit.
        total, count = float(np.sum(np.square(rows, order="C"))), max(rows.size, 1)
        return cls(rms=math.sqrt(total / count), as_printed=math.sqrt(total) / count)


@dataclass(frozen=True, slots=True, kw_only=True)
class ClosureSigmas:
    """Standard deviations of the closure error: position in m, orientation in rad.

    `orientation_rad` is None if orientation is not part of the closure error (ball, measured positions).
    """

    position_m: ResidualSigma
    orientation_rad: ResidualSigma | None


def closure_sigmas(residual: FloatArray, rotation_rows: int) -> ClosureSigmas:
    """Compute both sigmas of reduced residuals (m, r), rotation rows first (eqs. 14 and 15)."""
    return ClosureSigmas(
        position_m=ResidualSigma.of(residual[:, rotation_rows:]),
        orientation_rad=ResidualSigma.of(residual[:, :rotation_rows]) if rotation_rows else None,
    )


class ConstrainedPart(Enum):
    """The part of the tool that a fixture constrains."""

    POINT = "point"
    AXIS = "axis"
    FRAME = "frame"


class ClosureModel(ABC):
    """A loop formed by an arm and a fixture.

    Joint angles `q` are always the readings of *all* n joints at m poses, (..., m, n), rad, never wrapped. A model
    ignores the readings of joints that it treats as unsensed; their columns of `jac_q` are zero. `x` (..., P) are
    values of `parameters`, the paper's phi. `u` (..., m, U) are the unsensed angles, rad.
    """

    __slots__ = ()

    @property
    @abstractmethod
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns, in the order of every parameter vector."""

    @property
    @abstractmethod
    def joint_count(self) -> int:
        """Number n of columns of `q`."""

    @property
    @abstractmethod
    def unsensed_joints(self) -> tuple[int, ...]:
        """Arm joints (1-based) whose readings are not used."""

    @property
    @abstractmethod
    def components(self) -> int:
        """Number k of closure components: 6 (rotation and position) or 3 (position only)."""

    @property
    @abstractmethod
    def equations_per_pose(self) -> int:
        """Number of closure equations of each pose after the unsensed angles are eliminated."""

    @property
    @abstractmethod
    def ground_side(self) -> tuple[str, ...]:
        """Names of the unknowns that locate the fixture on the table; their values change if the fixture is moved."""

    @property
    @abstractmethod
    def hand_side(self) -> tuple[str, ...]:
        """Names of the unknowns that locate the fixture on the tool; their values change at every mounting."""

    @abstractmethod
    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Closure error for parameters `x` (..., P), joint angles and unsensed angles (..., m, U)."""

    @abstractmethod
    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Return initial values of the unsensed angles (..., m, U), rad, for the readings `q`."""

    @abstractmethod
    def with_all_joints_sensed(self) -> Self:
        """Return the same loop with the readings of all joints used; offsets of unsensed joints become unknowns."""

    @abstractmethod
    def without(self, names: Collection[str]) -> Self:
        """Return the same loop with the named unknowns fixed at their nominal values."""

    @abstractmethod
    def freed(self, entries: Sequence[DhEntry]) -> Self:
        """Return the same loop with `entries` of the arm's table as additional unknowns."""

    def angle_of(self, u: FloatArray, joint: int) -> FloatArray:
        """Return the angle (..., m), rad, of an unsensed joint (1-based); in `u` (..., m, U), arm joints are last."""
        return u[..., self.unsensed_joints.index(joint) - len(self.unsensed_joints)]

    def reduced(self, x: FloatArray, q: FloatArray, *, rates: bool = True) -> ReducedError:
        """Return the closure error after eliminating the hinge angle, if the loop has a hinge.

        `rates`: whether to calculate the Jacobian (else it is empty). Raises `ValueError` if arm joints are unsensed.
        """
        if self.unsensed_joints:
            raise ValueError(
                "eqs. 10-13 eliminate the hinge angle only; unsensed joints need `loop`"
            )
        error = self.loop(x, q, self.initial_unsensed(x, q))
        return ReducedError(
            residual=error.residual,
            jac_x=error.jac_x if rates else error.jac_x[..., :0],
            rotation_rows=self.components - 3,
            flipped=np.zeros(error.residual.shape[:-1], dtype=np.bool_),
        )

    def equivalents(self, x: FloatArray) -> FloatArray:
        """All parameter vectors (E, P) that describe the same loop as `x` (P,)."""
        return np.asarray(x, dtype=np.float64)[None, :]

    def at_poses(self, poses: IntArray) -> Self:
        """Return the model for the poses `poses`, in this order; a model that holds no data of poses returns itself."""
        return self

    def parts(self) -> tuple[tuple[ClosureModel, Which, Which], ...]:
        """Return each placement's loop, with the indices of the loop's parameters and of its poses."""
        return ((self, slice(None), slice(None)),)

    def merged(self, errors: Sequence[ReducedError]) -> ReducedError:
        """Join the reduced errors of all `parts` in the order of the poses."""
        return errors[0]

    def fixture_axes(
        self, x: FloatArray, q: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return the axes (m, 3, 3) of the fixture's half on the table, and those of its half on the tool.

        Both are given in the frame of the closure error. The axes of a half that does not turn in this frame are
        identity matrices. The loop must have a single placement.
        """
        still = np.broadcast_to(np.eye(3), (len(q), 3, 3))
        return still, still

    @property
    def entries(self) -> tuple[DhEntry, ...]:
        """Unknown D-H entries; empty for several placements, because each of them has its own D-H table."""
        return ()

    def arm_rows(self) -> FloatArray:
        """Nominal rows 1..n (5, n): theta_off, s, a, alpha, beta; ValueError if each placement has its own table."""
        raise ValueError("several placements have no common table: use their `parts`")

    @property
    def constrained_part(self) -> ConstrainedPart | None:
        """Part of the tool that the fixture constrains; None if it does not constrain the tool."""
        return None

    def constraint_entries(
        self, ground: Line, hand: Line, rotation: FloatArray
    ) -> dict[str, float]:
        """Values of the fixture's unknowns, by name; ValueError if the tool is not constrained.

        `ground`, `hand`: the line on the table and the line on the tool that a hinge makes coincide, in the frames of
        `constrained_axis_entries`. Other fixtures use only the points of these lines. `rotation`: mean (3, 3) of the
        tool's rotation matrices over the poses, in the frame of `ground`; used only by a rigid fixture.
        """
        raise ValueError(f"{type(self).__name__} does not constrain the tool")

    def dh_table(self, x: FloatArray) -> DhTable | None:
        """D-H table of links 0..n, with the entries in `x` (P,); None if the loop does not consist of links 0..n."""
        return None

    def drawn(self, x: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Return points (k, 3), m, and the fixture's axis (3,), in the arm's base frame, for a drawing of the arm.

        The last point is at the fixture. The axis is zero if the fixture has none. None if the arm cannot be drawn.
        """
        return None

    def fixture_axis(self, x: FloatArray) -> tuple[FloatArray, FloatArray] | None:
        """Position (3,), m, and axis (3,) of the fixture, in the arm's base frame; None if they are not known."""
        return None


def pose_blocks(model: ClosureModel, q: FloatArray) -> tuple[tuple[ClosureModel, FloatArray], ...]:
    """Split the poses `q` (m, n) into blocks; return the model and the joint angles (m_k, n) of each block."""
    if len(q) <= BLOCK_POSES:
        return ((model, q),)
    every = np.arange(len(q))
    return tuple((model.at_poses(every[cut]), q[cut]) for cut in pose_slices(len(q)))


def unsensed_at_readings(model: ClosureModel, x: FloatArray, q: FloatArray) -> FloatArray:
    """Return `ClosureModel.initial_unsensed` (m, U), calculated block by block to limit the memory used."""
    return np.concatenate(
        [part.initial_unsensed(x, part_q) for part, part_q in pose_blocks(model, q)]
    )


def nearest_equivalent(model: ClosureModel, x: FloatArray, reference: FloatArray) -> FloatArray:
    """Return the vector nearest to `reference` (P,) among those equivalent to `x` (P,); 1 rad counts as 1 m."""
    parameters = model.parameters
    nearest, distance = np.asarray(x), np.inf
    while True:
        candidates = model.equivalents(nearest)
        squares = (wrap_angles(parameters, candidates - reference) ** 2).sum(-1)
        best = int(np.argmin(squares))
        # `Placements` lists only some of many combinations: continue from the best of them.
        if not squares[best] < distance * (1.0 - 1e-12):
            return nearest
        unchanged = bool((candidates[best] == nearest).all())
        nearest, distance = wrap_angles(parameters, candidates[best]), float(squares[best])
        if unchanged:
            return nearest


def in_order(model: ClosureModel, other: ClosureModel, x: FloatArray) -> FloatArray:
    """Return the parameters (P,) of `model`: values in `x`, a vector of `other`, or nominal where `other` has none."""
    known = {p.name: float(v) for p, v in zip(other.parameters, x, strict=True)}
    return nominal_vector(model.parameters, known)


def poses_needed(parameters: int, equations_per_pose: int) -> int:
    """Fewest poses with more closure equations than parameters; 0 if a pose has no equation."""
    return parameters // equations_per_pose + 1 if equations_per_pose > 0 else 0
