"""Loop closure: how far a chain that ends where it began is from closing, and the derivatives of that.

A `ClosureModel` is all that the estimators know of a fixture. `DhLoop` is the model of every fixture
that is itself a D-H link (rigid, hinge); it knows no estimator, no fixture and no number of joints.
"""

from __future__ import annotations

from collections.abc import Collection, Sequence
from dataclasses import dataclass, replace
from typing import Protocol

import numpy as np

from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.kinematics import DhTable, Frames, forward, jacobian, picked, turned
from solver.chain.parameters import DhEntry, DhKind, Parameter, wrap_angles
from solver.chain.rotations import rotation_vector, rotation_vector_differential, skew


@dataclass(frozen=True, slots=True, kw_only=True)
class LoopError:
    """Closure error of every pose with the unsensed freedoms as explicit angles.

    Attributes
    ----------
    residual
        (..., m, k): rotation vector (rad) over position (m) of the end point, both in the frame on
        the fixture. Zero when the loop closes.
    jac_x, jac_q, jac_u
        Its exact derivatives for the parameters (..., m, k, P), the joint angles (..., m, k, n) and
        the unsensed angles (..., m, k, U).
    """

    residual: FloatArray
    jac_x: FloatArray
    jac_q: FloatArray
    jac_u: FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class ReducedError:
    """Closure error with the unsensed freedoms eliminated: what the paper minimises.

    Attributes
    ----------
    residual
        (..., m, r) in the fixture frame: for a hinge dx, dy (rad), then x, y, z (m) of eq. 13.
    jac_x
        Its exact derivative (..., m, r, P).
    rotation_rows
        How many of the r rows are rotations; they come first.
    unsensed
        The eliminated angles (..., m, U), rad.
    flipped
        (..., m) bool: poses on the other branch of the elimination (hand upside down on the hinge).
    """

    residual: FloatArray
    jac_x: FloatArray
    rotation_rows: int
    unsensed: FloatArray
    flipped: BoolArray


class ClosureModel(Protocol):
    """A loop formed by an arm and a fixture.

    Joint angles `q` are always the sensed angles of *all* n joints as read, (..., m, n), rad, never
    wrapped; a model ignores the columns of joints it treats as unsensed (`jac_q` is zero there).
    """

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns, in the order of every parameter vector."""
        ...

    @property
    def joint_count(self) -> int:
        """Number n of columns of `q`."""
        ...

    @property
    def unsensed_joints(self) -> tuple[int, ...]:
        """Arm joints (1-based) whose reading is not used."""
        ...

    @property
    def equations_per_pose(self) -> int:
        """Closure equations that remain a pose once the unsensed freedoms are eliminated."""
        ...

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Closure error for parameters `x` (..., P), joint angles and unsensed angles (..., m, U)."""
        ...

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Return first values of the unsensed angles (..., m, U), rad, for the readings `q`."""
        ...

    def reduced(self, x: FloatArray, q: FloatArray) -> ReducedError:
        """Closure error with the unsensed freedoms eliminated."""
        ...

    def equivalents(self, x: FloatArray) -> FloatArray:
        """All parameter vectors that describe the very same loop as `x` (P,), shape (E, P)."""
        ...

    def with_all_joints_sensed(self) -> ClosureModel:
        """Return the same loop with every joint's reading used and its offset an unknown."""
        ...

    @property
    def ground_side(self) -> tuple[str, ...]:
        """Names of the unknowns that say where the fixture stands: new wherever it is put."""
        ...

    @property
    def hand_side(self) -> tuple[str, ...]:
        """Names of the unknowns that say how the hand holds the fixture: new at every mounting."""
        ...

    def without(self, names: Collection[str]) -> ClosureModel:
        """Return the same loop with the named unknowns held at their nominal values."""
        ...

    def at_poses(self, poses: IntArray) -> ClosureModel:
        """Return the model of a selection (or order) of poses: itself unless bound to its poses."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class DhLoop:
    """A closed chain of D-H links 0..n: link 0 is the fixture, links 1..n the arm (section 2.3).

    ``A_0(theta_0) A_1 ... A_n = I``: frame n is frame -1, and z_n = z_-1 is the fixture's axis.

    Attributes
    ----------
    table
        Nominal D-H table of links 0..n.
    entries
        Which entries are unknown, in the order of the parameter vector.
    hinge
        Whether theta_0 is an unsensed joint (hinge) or a constant (rigid).
    unsensed_joints
        Arm joints (1-based) whose readings are not used.
    """

    table: DhTable
    entries: tuple[DhEntry, ...]
    hinge: bool
    unsensed_joints: tuple[int, ...] = ()

    def __post_init__(self) -> None:
        if any(not 0 <= e.row < self.table.links for e in self.entries):
            raise ValueError("a free entry names a link the table does not have")
        if len(set(self.entries)) != len(self.entries):
            raise ValueError("a free entry is listed twice")
        lost = [f"theta_off_{j}" for j in self.unsensed_joints]
        if any(e.name in lost for e in self.entries):
            raise ValueError(f"joints {self.unsensed_joints} are unsensed: they have no offset")

    @property
    def parameters(self) -> tuple[Parameter, ...]:
        """The unknowns with their nominal values."""
        stacked = self.table.stacked()
        return tuple(
            Parameter(name=e.name, is_angle=e.kind.is_angle, nominal=float(stacked[e.kind, e.row]))
            for e in self.entries
        )

    @property
    def joint_count(self) -> int:
        """Joints of the arm."""
        return self.table.links - 1

    @property
    def unsensed_rows(self) -> tuple[int, ...]:
        """Links whose angle is an unknown of each pose: the hinge, then the unsensed joints."""
        return ((0,) if self.hinge else ()) + self.unsensed_joints

    @property
    def equations_per_pose(self) -> int:
        """Six, less one for each unsensed freedom."""
        return 6 - len(self.unsensed_rows)

    def tables(self, x: FloatArray) -> FloatArray:
        """Fill parameter vectors (..., P) into the nominal table: (..., 4, links)."""
        x = np.asarray(x, dtype=np.float64)
        stacked = np.broadcast_to(self.table.stacked(), (*x.shape[:-1], 4, self.table.links)).copy()
        kinds, rows = self._indices()
        stacked[..., kinds, rows] = x
        return stacked

    def frames(self, x: FloatArray, q: FloatArray, u: FloatArray) -> Frames:
        """All frames of the loop, seen in frame -1, for every pose."""
        table = self.tables(x)[..., None, :, :]
        offsets = table[..., 0, :]
        theta = np.broadcast_to(
            offsets, np.broadcast_shapes(offsets.shape, (*q.shape[:-1], self.table.links))
        ).copy()
        theta[..., 1:] += q
        for k, row in enumerate(self.unsensed_rows):
            theta[..., row] = u[..., k]
        return forward(theta, table[..., 1, :], table[..., 2, :], table[..., 3, :])

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Six closure components: rotation vector over position, in frame -1 (eqs. 8 and 10)."""
        frames = self.frames(x, q, u)
        r = rotation_vector(frames.R_end)
        J = self._columns(jacobian(frames))
        J[..., :3, :] = rotation_vector_differential(r) @ J[..., :3, :]
        jac_x, jac_theta = J[..., : len(self.entries)], J[..., len(self.entries) :]
        jac_q = jac_theta[..., 1:]
        if self.unsensed_joints:
            jac_q = jac_q.copy()
            jac_q[..., [j - 1 for j in self.unsensed_joints]] = 0.0
        return LoopError(
            residual=np.concatenate((r, frames.p_end), axis=-1),
            jac_x=jac_x,
            jac_q=jac_q,
            jac_u=jac_theta[..., list(self.unsensed_rows)],
        )

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Hinge angle by eq. 12; unsensed arm joints start from their readings and nominal offsets."""
        x = np.asarray(x, dtype=np.float64)
        lead = np.broadcast_shapes((*x.shape[:-1], 1), q.shape[:-1])
        u = np.zeros((*lead, len(self.unsensed_rows)))
        for k, row in enumerate(self.unsensed_rows):
            if row > 0:
                u[..., k] = q[..., row - 1] + self.table.theta_off_rad[row]
        if self.hinge:
            R_c = self.frames(x, q, u).R_end
            u[..., 0] = -np.arctan2(R_c[..., 1, 0], R_c[..., 0, 0])
        return u

    def reduced(self, x: FloatArray, q: FloatArray) -> ReducedError:
        """Eliminate the hinge angle and see the loop in frame -1 (paper, eqs. 10 to 13).

        The two rotations are the swing that carries z_-1 onto z_7. To first order they are
        eq. 12's ``dx = -R23``, ``dy = R13``; unlike those they do not vanish again when the hand is
        upside down, so a pose on the flipped branch cannot pass for a closed one.

        Raises
        ------
        ValueError
            If arm joints are unsensed: eqs. 10-13 eliminate the hinge only.
        """
        if self.unsensed_joints:
            raise ValueError(
                "eqs. 10-13 eliminate the hinge angle only; unsensed joints need `loop`"
            )
        if not self.hinge:
            u = self.initial_unsensed(x, q)
            whole = self.loop(x, q, u)
            return ReducedError(
                residual=whole.residual,
                jac_x=whole.jac_x,
                rotation_rows=3,
                unsensed=u,
                flipped=np.zeros(whole.residual.shape[:-1], dtype=np.bool_),
            )
        frames, u = self._upon_hinge(x, q)
        J = self._columns(jacobian(frames))
        by_hinge = J[..., len(self.entries), None]
        jac = J[..., : len(self.entries)]
        R = frames.R_end
        # theta_0 answers to every parameter so that R21 stays zero (eq. 12): w_z R11 = w_x R31.
        hinge_rate = jac[..., 0, :] * (R[..., 2, 0] / R[..., 0, 0])[..., None] - jac[..., 2, :]
        jac = jac + by_hinge * hinge_rate[..., None, :]
        swing, by_rotation = _swing(R[..., :, 2])
        return ReducedError(
            residual=np.concatenate((swing, frames.p_end), axis=-1),
            jac_x=np.concatenate((by_rotation @ jac[..., :3, :], jac[..., 3:, :]), axis=-2),
            rotation_rows=2,
            unsensed=u[..., None],
            flipped=R[..., 2, 2] < 0.0,
        )

    def _upon_hinge(self, x: FloatArray, q: FloatArray) -> tuple[Frames, FloatArray]:
        """Frames with the hinge at theta_0 (..., m) such that R21 = 0: eqs. 11 to 13."""
        R_c = (at_zero := self.frames(x, q, np.zeros((*q.shape[:-1], 1)))).R_end
        theta_0 = -np.arctan2(R_c[..., 1, 0], R_c[..., 0, 0])
        return turned(at_zero, theta_0), theta_0

    def equivalents(self, x: FloatArray) -> FloatArray:
        """Eight equal descriptions of a hinge loop, none of which a rigid loop has.

        (a_0, alpha_0, theta_off_1) -> (-a_0, -alpha_0, theta_off_1 + pi); likewise at link n; and the
        hinge axis turned round: (s_0, alpha_0, alpha_n) -> (-s_0, alpha_0 + pi, alpha_n - pi).
        A description needs all entries it changes to be free.
        """
        candidates = [np.asarray(x, dtype=np.float64)]
        if self.hinge:
            n = self.joint_count
            moves = (
                (("a_0", -1.0, 0.0), ("alpha_0", -1.0, 0.0), ("theta_off_1", 1.0, np.pi)),
                ((f"a_{n}", -1.0, 0.0), (f"alpha_{n}", -1.0, 0.0), (f"theta_off_{n}", 1.0, np.pi)),
                (("s_0", -1.0, 0.0), ("alpha_0", 1.0, np.pi), (f"alpha_{n}", 1.0, -np.pi)),
            )
            index = {e.name: k for k, e in enumerate(self.entries)}
            unsensed = {f"theta_off_{j}" for j in self.unsensed_joints}
            for move in moves:
                # An unsensed joint's offset is part of its per-pose angle and needs no entry.
                changes = [c for c in move if c[0] not in unsensed]
                if all(name in index for name, _, _ in changes):
                    for y in list(candidates):
                        z = y.copy()
                        for name, sign, shift in changes:
                            z[index[name]] = sign * z[index[name]] + shift
                        candidates.append(z)
        return np.stack(candidates)

    def with_all_joints_sensed(self) -> DhLoop:
        """Return the same loop with every joint's reading used and its offset an unknown."""
        offsets = tuple(DhEntry(DhKind.THETA_OFF, j) for j in self.unsensed_joints)
        return replace(self, entries=self.entries + offsets, unsensed_joints=())

    @property
    def ground_side(self) -> tuple[str, ...]:
        """Link 0, and what of joint 1 is measured from its common normal: s_1 and theta_off_1."""
        return tuple(
            e.name
            for e in self.entries
            if e.row == 0 or (e.row == 1 and e.kind in (DhKind.THETA_OFF, DhKind.S))
        )

    @property
    def hand_side(self) -> tuple[str, ...]:
        """Link n whole: its offset too is measured to the common normal of the fixture's axis."""
        return tuple(e.name for e in self.entries if e.row == self.joint_count)

    def without(self, names: Collection[str]) -> DhLoop:
        """Return the same loop with the named entries held at their nominal values."""
        return replace(self, entries=tuple(e for e in self.entries if e.name not in names))

    def at_poses(self, poses: IntArray) -> DhLoop:
        """Return the loop itself: it is bound to no poses."""
        return self

    def _indices(self) -> tuple[list[int], list[int]]:
        return [int(e.kind) for e in self.entries], [e.row for e in self.entries]

    def _columns(self, columns: FloatArray) -> FloatArray:
        """Columns of the unknown entries, then those of all links' angles: (..., 6, P + links)."""
        kinds, rows = self._indices()
        links = self.table.links
        return picked(columns, kinds + [DhKind.THETA_OFF] * links, rows + list(range(links)))


def _swing(n: FloatArray) -> tuple[FloatArray, FloatArray]:
    """Rotation in the xy plane that carries z onto the unit vector `n`, and its rate.

    Returns
    -------
    swing
        (..., 2), rad: angle between z and n, along z x n.
    by_rotation
        (..., 2, 3): derivative of the swing for a spatial angular increment w, ``dn = w x n``.
    """
    nx, ny, nz = n[..., 0], n[..., 1], n[..., 2]
    sine = np.hypot(nx, ny)
    # Below this the quotients lose digits and their series are exact to double precision.
    tiny = (sine < 1e-4) & (nz > 0.0)
    safe = np.where(tiny | (sine == 0.0), 1.0, sine)
    ratio = np.where(tiny, 1.0 + sine**2 / 6.0, np.arctan2(sine, nz) / safe)
    slope = np.where(tiny, -2.0 / 3.0, (nz - ratio) / safe**2)
    dn = -skew(n)
    dratio = slope[..., None] * (nx[..., None] * dn[..., 0, :] + ny[..., None] * dn[..., 1, :])
    dratio = dratio - dn[..., 2, :]
    first = -dn[..., 1, :] * ratio[..., None] - ny[..., None] * dratio
    second = dn[..., 0, :] * ratio[..., None] + nx[..., None] * dratio
    swing = np.stack((-ny * ratio, nx * ratio), axis=-1)
    return swing, np.stack((first, second), axis=-2)


def nearest_equivalent(
    model: ClosureModel, x: FloatArray, reference: FloatArray, length_scale_m: float = 1.0
) -> FloatArray:
    """Of all equal descriptions of the loop `x`, the one nearest to `reference` (P,)."""
    scale = np.array([1.0 if p.is_angle else 1.0 / length_scale_m for p in model.parameters])
    nearest, distance = np.asarray(x), np.inf
    while True:
        candidates = wrap_angles(model.parameters, model.equivalents(nearest))
        difference = wrap_angles(model.parameters, candidates - reference)
        squares = ((difference * scale) ** 2).sum(-1)
        best = int(np.argmin(squares))
        # Several placements list only some of their many combinations: go on from the best of them.
        if not squares[best] < distance * (1.0 - 1e-12):
            return nearest
        nearest, distance = np.asarray(candidates[best]), float(squares[best])


def poses_needed(parameters: int, equations_per_pose: int) -> int:
    """Fewest poses that leave at least one degree of freedom; 0 where no number does."""
    return parameters // equations_per_pose + 1 if equations_per_pose > 0 else 0


def entries(names: Sequence[str]) -> tuple[DhEntry, ...]:
    """Parse names such as ``theta_off_1``."""
    return tuple(DhEntry.parse(name) for name in names)
