"""The loop of a rigid or hinge fixture, which is itself a D-H link of the chain (paper, section 2.3, eqs. 8 to 13)."""

from dataclasses import dataclass
from typing import ClassVar

import numpy as np

from solver.arrays import ComplexArray, FloatArray
from solver.chain.kinematics import NO_ENTRIES, DhTable, poses_first, screws
from solver.chain.parameters import DhKind
from solver.chain.rotations import rotation_about_z, rotation_vector, rotation_vector_differential
from solver.loops.arm_loop import ArmLoop
from solver.loops.closure import ClosureModel, ConstrainedPart, LoopError, ReducedError
from solver.loops.endpoint_geometry import Line, constrained_axis_entries, constrained_frame_entries


@dataclass(frozen=True, slots=True, kw_only=True)
class DhLoop(ArmLoop):
    """A closed chain of D-H links 0..n: link 0 is the fixture, links 1..n the arm (paper, section 2.3).

    ``A_0(theta_0) A_1 ... A_n = I``: frame n is frame -1, and z_n = z_-1 is the fixture's axis.

    `hinge`: whether theta_0 is an unsensed joint (hinge) or a constant (rigid).
    """

    FIRST_LINK: ClassVar[int] = 0
    GROUND_SIDE: ClassVar[tuple[str, ...]] = (
        *(f"{kind.symbol}_0" for kind in DhKind),
        "theta_off_1",
        "s_1",
    )

    components: ClassVar[int] = 6

    hinge: bool

    @property
    def unsensed_rows(self) -> tuple[int, ...]:
        """Links whose angle is an unknown of each pose: the hinge, then the unsensed joints."""
        return ((0,) if self.hinge else ()) + self.unsensed_joints

    def loop(self, x: FloatArray, q: FloatArray, u: FloatArray) -> LoopError:
        """Six closure components: rotation vector (rad), then position (m), in frame -1 (eqs. 8 and 10)."""
        frames = self.frames(x, q, u)
        r = rotation_vector(frames.R_end)
        J = self.columns(frames)
        J[..., :3, :] = rotation_vector_differential(r) @ J[..., :3, :]
        return self.loop_error(np.concatenate((r, frames.p_end), axis=-1), J)

    def initial_unsensed(self, x: FloatArray, q: FloatArray) -> FloatArray:
        """Return u (..., m, U), rad: hinge angle by eq. 12, then reading plus nominal offset of each unsensed joint."""
        joints = ArmLoop.initial_unsensed(self, x, q)
        if not self.hinge:
            return joints
        u = np.concatenate((np.zeros((*joints.shape[:-1], 1)), joints), axis=-1)
        R11, R21, _ = self.frames(x, q, u).axes_of[-1, 0]
        u[..., 0] = -np.arctan2(R21, R11)
        return u

    def reduced(self, x: FloatArray, q: FloatArray, *, rates: bool = True) -> ReducedError:
        """Return the closure error in frame -1 with the hinge angle eliminated (paper, eqs. 10 to 13).

        The two rotation components are the swing, the shortest rotation that carries z_-1 onto z_n. To first order they
        equal ``dx = -R23``, ``dy = R13`` of eq. 12. If the tool is upside down (the flipped branch), dx and dy are zero
        as well, but the swing is not, so such a pose does not count as closed. Raises `ValueError` if arm joints are
        unsensed, because eqs. 10-13 eliminate the hinge only.
        """
        if not self.hinge or self.unsensed_joints:
            return ClosureModel.reduced(self, x, q, rates=rates)
        at_zero = self.frames(x, q, np.zeros((*q.shape[:-1], 1)))
        (R11, R21, R31), _, (R13, R23, R33) = at_zero.axes_of[-1]
        px, py, pz = at_zero.origin_of[-1]
        columns = screws(at_zero, self._unknown if rates else NO_ENTRIES)
        # Vectors across the hinge axis are complex numbers; a rotation about the axis is a factor.
        x_end = R11 + 1j * R21
        size = np.abs(x_end)
        turned = x_end.conj() / size
        n, p = turned * (R13 + 1j * R23), turned * (px + 1j * py)
        w, v = (turned * (columns[:, k] + 1j * columns[:, k + 1]) for k in (0, 3))
        # theta_0 changes with every parameter so that R21 stays zero (eq. 12): w_z R11 = w_x R31. This change turns the
        # end about z_-1 and so changes w_z and the position.
        w_z = w.real * (R31 / size)
        swing, swing_rate = _swing(n, R33, w, w_z)
        jac = np.empty((len(columns), 5, *columns.shape[2:]))
        jac[:, 0], jac[:, 1] = swing_rate.real, swing_rate.imag
        p_rate = v + (1j * p) * (w_z - columns[:, 2])
        jac[:, 2], jac[:, 3], jac[:, 4] = p_rate.real, p_rate.imag, columns[:, 5]
        return ReducedError(
            residual=poses_first(np.stack((swing.real, swing.imag, p.real, p.imag, pz)), 0),
            jac_x=poses_first(jac, 1, 0),
            rotation_rows=2,
            flipped=R33 < 0.0,
        )

    def fixture_axes(
        self, x: FloatArray, q: FloatArray, u: FloatArray
    ) -> tuple[FloatArray, FloatArray]:
        """Return axes (m, 3, 3), in frame -1, of the fixture's table half, which theta_0 turns, and its tool half."""
        table, hand = ClosureModel.fixture_axes(self, x, q, u)
        if self.hinge:
            table = rotation_about_z(u[..., 0])
        return table, hand

    def equivalents(self, x: FloatArray) -> FloatArray:
        """Return up to eight equivalent parameter vectors of a hinge loop; for a rigid loop only `x` itself.

        Each vector combines some of three changes. First, a_0 and alpha_0 change sign and theta_off_1 grows by pi.
        Second, a_n and alpha_n change sign and theta_off_n grows by pi. Third, the hinge axis is reversed: s_0 changes
        sign, alpha_0 grows by pi and alpha_n shrinks by pi. A change is used only if all its entries, except offsets of
        unsensed joints, are unknowns.
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
                # An unsensed joint's offset is part of its angle in each pose and needs no entry.
                changes = [c for c in move if c[0] not in unsensed]
                if all(name in index for name, _, _ in changes):
                    for y in list(candidates):
                        z = y.copy()
                        for name, sign, shift in changes:
                            z[index[name]] = sign * z[index[name]] + shift
                        candidates.append(z)
        return np.stack(candidates)

    @property
    def hand_side(self) -> tuple[str, ...]:
        """Names of the unknown entries of link n, including theta_off_n, which locate the fixture on the tool."""
        return tuple(e.name for e in self.entries if e.row == self.joint_count)

    @property
    def constrained_part(self) -> ConstrainedPart:
        """Part of the tool that the fixture constrains: a line (hinge) or the whole frame (rigid)."""
        return ConstrainedPart.AXIS if self.hinge else ConstrainedPart.FRAME

    def constraint_entries(
        self, ground: Line, hand: Line, rotation: FloatArray
    ) -> dict[str, float]:
        """D-H entries of the fixture by name, rad and m; a rigid fixture uses `ground.point_m` and `rotation` only."""
        if not self.hinge:
            return constrained_frame_entries(rotation, ground.point_m, self.joint_count)
        return constrained_axis_entries(ground, hand, self.joint_count)

    def dh_table(self, x: FloatArray) -> DhTable:
        """D-H table of links 0..n."""
        return DhTable.from_stacked(self.tables(x))

    def drawn(self, x: FloatArray, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origins of frames 0..n (n + 1, 3), m, and the hinge axis (3,), in frame 0, for joint angles `q` (n,)."""
        # The hinge angle may have any value: seen from frame 0 it changes nothing.
        frames = self.frames(x, q[None, :], np.zeros((1, len(self.unsensed_rows))))
        R_0, p_0 = frames.axes[0, 1], frames.origins_m[0, 1]
        return (frames.origins_m[0, 1:] - p_0) @ R_0, frames.axes[0, -1, :, 2] @ R_0

    def fixture_axis(self, x: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Origin (3,), m, and z axis (3,) of frame -1, both constant in frame 0."""
        still = np.zeros(self.joint_count)
        frames = self.frames(x, still[None, :], np.zeros((1, len(self.unsensed_rows))))
        R_0, p_0 = frames.axes[0, 1], frames.origins_m[0, 1]
        return -p_0 @ R_0, R_0[2]


def _swing(
    n: ComplexArray, nz: FloatArray, w: ComplexArray, wz: FloatArray
) -> tuple[ComplexArray, ComplexArray]:
    """Return the swing (...), rad, which turns z onto a unit vector, and its changes (C, ...), rad, by small rotations.

    The swing is a rotation vector in the xy plane. Vectors in this plane are written as complex numbers x + iy.
    `n`, `nz` (...): the unit vector, as x + iy and z. `w`, `wz` (C, ...): C small rotations of the unit vector, rad,
    in the fixed frame, as x + iy and z.

    The swing is ``i f n``, where f is the angle between z and the unit vector, divided by the sine of this angle. A
    small rotation changes n by ``dn = i (wz n - nz w)``. With n* the complex conjugate of n, the swing changes by

        d(i f n) = f (nz w - wz n) + i g Im(n* w) n,   g = 1 + nz (nz - f) / sine^2.
    """
    sine = np.abs(n)
    # Below this the quotients lose digits and their series are exact to double precision.
    tiny = (sine < 1e-4) & (nz > 0.0)
    safe = np.where(tiny | (sine == 0.0), 1.0, sine)
    f = np.where(tiny, 1.0 + sine**2 / 6.0, np.arctan2(sine, nz) / safe)
    g = 1.0 + nz * np.where(tiny, -2.0 / 3.0, (nz - f) / safe**2)
    rate = (f * nz) * w - (f * n) * wz + (1j * g * n) * (n.conj() * w).imag
    return 1j * f * n, rate
