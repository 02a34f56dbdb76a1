"""Gravity's torque on every joint, and the displacements of a fixture of unknown compliance.

A fixture has two halves, one on the table and one on the tool. The compliance matrix C of each half is unknown, but
symmetric, positive definite and constant in the half's own axes. The model is C = S M S. S is diagonal; its elements
s_i have one value for angles and another for positions. M is random, with mean I and the second moments of a Wishart
matrix of nu degrees of freedom. With d_ij = 1 if i = j, otherwise 0, these second moments are

    E[M_ik M_jl] = d_ik d_jl + (d_ij d_kl + d_il d_kj) / nu.

At pose p, the wrench on the fixture is W(p) z and displaces a half by C W(p) z. z ~ N(0, I) are the errors of the
stated masses and centres. The displacements (components i and j) at two poses p and p' have the covariance

    s_i s_j (G_ij + (d_ij sum_k G_kk + G_ji) / nu),     G = S W(p) W(p')' S.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.kinematics import forward
from solver.chain.parameters import DhEntry, DhKind, is_entry
from solver.chain.statics import LinkMasses, torque_rates
from solver.loops.closure import ClosureModel

WISHART_DOF = 6.0
"""Degrees of freedom nu of the Wishart matrix: the fewest for which a 6 x 6 compliance is positive definite."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class FixtureLoads:
    """Loads on a fixture at m poses, due to errors of the stated masses and centres of mass.

    `pull` (m, k, a): product ``S W`` (see the module) along k closure components, in the frame of the deflection. There
    is one column for each pair of an error and a possible set of joints in position mode.
    `halves`: for each half of the fixture, its share of the deflection's standard deviation, and the rotation (m, k, k)
    from the half's axes to the frame of the deflection (None if the two coincide). Such rotations commute with S.
    """

    pull: FloatArray
    halves: tuple[tuple[float, FloatArray | None], ...]

    def at_poses(self, poses: IntArray) -> FixtureLoads:
        """Return the loads for a selection of poses."""
        halves = tuple((s, None if turn is None else turn[poses]) for s, turn in self.halves)
        return FixtureLoads(pull=self.pull[poses], halves=halves)


def compliance_sizes(stated_deflection: tuple[float, float], *, rotations: int) -> FloatArray:
    """Return the diagonal (k,) of S with which a random moment and force, each of rms 1, cause the stated deflection.

    `stated_deflection`: rms of each rotation, give_rad, and of each translation, give_m. `rotations`: number of closure
    components that are rotations, 3 or 0. Let a and b be the squares of the elements of S for angles and for positions.
    S and nu are explained in the module. The variances of the rotations and those of the translations have the sums

        a^2 (1 + 4 / nu) + 3 a b / nu = 3 give_rad^2,   b^2 (1 + 4 / nu) + 3 a b / nu = 3 give_m^2.
    """
    turn, shift = 3.0 * stated_deflection[0] ** 2, 3.0 * stated_deflection[1] ** 2
    own, other = 1.0 + 4.0 / WISHART_DOF, 3.0 / WISHART_DOF
    if not rotations or turn == 0.0:
        return np.array([0.0] * rotations + [(shift / own) ** 0.25] * 3)
    if shift == 0.0:
        return np.array([(turn / own) ** 0.25] * rotations + [0.0] * 3)
    # The ratio of the two equations is a quadratic equation for a / b.
    ratio = turn / shift
    half = 0.5 * other * (1.0 - ratio) / own
    quotient = -half + np.sqrt(half**2 + ratio)
    b = np.sqrt(shift / (own + other * quotient))
    return np.asarray(np.sqrt([quotient * b] * rotations + [b] * 3))


def blocks(k: int) -> list[slice]:
    """Return a slice for each kind of the k closure components: rotations and positions if k = 6, else positions."""
    return [slice(0, 3), slice(3, 6)] if k == 6 else [slice(0, k)]


def covariance(one: FixtureLoads, two: FixtureLoads, s: FloatArray) -> FloatArray:
    """Return the covariance (m k, m' k) of the displacements at m poses (`one`) with those at m' poses (`two`).

    See the module for the formula, whose term in 1 / nu is evaluated in the halves' own axes. `s` (k,): diagonal of S.
    """
    k, a, b = len(s), len(one.pull), len(two.pull)
    product = (one.pull.reshape(a * k, -1) @ two.pull.reshape(b * k, -1).T).reshape(a, k, b, k)
    total = np.zeros_like(product)
    for (share, turn_a), (_, turn_b) in zip(one.halves, two.halves, strict=True):
        own = _turned(product, _transposed(turn_a), _transposed(turn_b))
        C = own.transpose(0, 3, 2, 1).copy()
        C[:, range(k), :, range(k)] += np.einsum("aibi->ab", own)
        total += share**2 * (product + _turned(C, turn_a, turn_b) / WISHART_DOF)
    total *= s[:, None, None] * s
    return total.reshape(a * k, b * k)


def _transposed(turn: FloatArray | None) -> FloatArray | None:
    return None if turn is None else np.swapaxes(turn, -1, -2)


def _turned(C: FloatArray, turn_a: FloatArray | None, turn_b: FloatArray | None) -> FloatArray:
    """Return C (a, k, b, k) with its rows rotated by `turn_a` (a, k, k) and its columns by `turn_b` (b, k, k)."""
    if turn_a is None or turn_b is None:
        return C
    a, k, b, _ = C.shape
    # One product for all columns of a pose, first along the rows and then along the columns.
    rows = (turn_a @ C.reshape(a, k, b * k)).reshape(a * k, b, k)
    return (turn_b @ rows.transpose(1, 2, 0)).reshape(b, k, a, k).transpose(2, 3, 0, 1)


def variance(loads: FixtureLoads, s: FloatArray) -> FloatArray:
    """Return the variances (m, k) of the displacements at m poses: the diagonal of ``covariance(loads, loads, s)``.

    They do not depend on the axes of the fixture's halves. `s` (k,): diagonal of S.
    """
    squares = (loads.pull**2).sum(-1)
    every = squares + (squares + squares.sum(-1, keepdims=True)) / WISHART_DOF
    return np.asarray(sum(share**2 for share, _ in loads.halves) * every * s**2)


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ArmPoses:
    """Poses of an arm in one placement: joint angles q (m, n) and unsensed angles u (m, U), rad; parameters x (P,)."""

    model: ClosureModel
    x: FloatArray
    q: FloatArray
    u: FloatArray
    masses: LinkMasses

    def arm_rows(self) -> FloatArray:
        """Return the D-H rows 1..n (5, n) of the arm without the fixture: calibrated where possible, else nominal.

        The offsets of the first and the last joint are nominal, because their calibrated values are measured from the
        fixture's axis and would give a wrong direction of gravity.
        """
        rows = self.model.arm_rows().copy()
        ends = {f"{DhKind.THETA_OFF.symbol}_{j}" for j in (1, rows.shape[1])}
        for parameter, value in zip(self.model.parameters, self.x, strict=True):
            if is_entry(parameter.name) and parameter.name not in ends:
                entry = DhEntry.parse(parameter.name)
                if entry.row > 0:
                    rows[int(entry.kind), entry.row - 1] = value
        return rows

    @property
    def shapes(self) -> int:
        """Number s of torques that `torques` returns for each joint and pose."""
        return 1 + 4 * len(self.masses.mass_kg) + len(self.masses.tilted)

    def torques(self, poses: IntArray | slice) -> FloatArray:
        """Return gravity's torque on each joint (m, n, s), N m: as stated, then its change for each error of one sigma.

        The errors are those of each link's mass and centre x, y, z (4 n of them), then the tilts of the base.
        """
        rows, masses = self.arm_rows(), self.masses
        arm = forward(self.q[poses] + rows[DhKind.THETA_OFF], *rows[DhKind.S :])
        rates = torque_rates(arm, np.vstack((masses.down, masses.tilted)))
        stated, *tilts = rates.reshape(*rates.shape[:-2], -1) @ masses.moments.reshape(-1)
        shapes = (stated[..., None], _by_moment(rates[0], masses), np.stack(tilts, axis=-1))
        return np.concatenate(shapes, axis=-1)


def _by_moment(rates: FloatArray, masses: LinkMasses) -> FloatArray:
    """Return the changes of gravity's torques (m, n, 4 n), N m, for an error of one sigma in each mass and centre.

    The 4 n errors are the mass and the centre x, y, z of every link. `rates` (m, n, n, 4): result of `torque_rates`.
    """
    m, n = rates.shape[:2]
    # One product for each link: all joints at all poses with its moments.
    by_link = rates.transpose(2, 0, 1, 3).reshape(n, m * n, 4) @ masses.moments_sd
    return by_link.reshape(n, m, n, 4).transpose(1, 2, 0, 3).reshape(m, n, -1)
