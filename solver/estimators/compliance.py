"""A fixture that gives by a compliance nobody knows: what its displacements at two poses have in common.

Both halves of a fixture give by a compliance, constant in that half's own axes. It is symmetric and
positive: C = S M S, S one size for angles and one for positions, M of mean I and with the second moments
of a Wishart matrix of nu degrees of freedom,

    E[M_ik M_jl] = d_ik d_jl + (d_ij d_kl + d_il d_kj) / nu,

so that under wrenches W z, z ~ N(0, I), the displacements C W z at two poses p, p' have the covariance

    s_i s_j (G_ij + (d_ij sum_k G_kk + G_ji) / nu),     G = S W(p) W(p')' S.

Knows no loop and nothing of where the wrenches come from.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray

WISHART_DOF = 6.0
"""nu: the fewest for which a 6 x 6 compliance is positive."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Half:
    """Half of a fixture at m poses.

    Attributes
    ----------
    turn
        (m, k, k): its axes, seen where the displacement is, times its share of the give.
    pull
        (m, k, a): wrenches S W in its axes, for a unit of each of a uncertain coefficients.
    """

    turn: FloatArray
    pull: FloatArray


def compliance_sizes(give: tuple[float, float], *, rotations: int) -> FloatArray:
    """S (k,) with which moments and forces of unit size give as stated, rms a component.

    With a and b the squares of its two sizes, by the module head's covariance summed over three components,

        a^2 (1 + 4 / nu) + 3 a b / nu = 3 give_rad^2,   b^2 (1 + 4 / nu) + 3 a b / nu = 3 give_m^2.
    """
    turn, shift = 3.0 * give[0] ** 2, 3.0 * give[1] ** 2
    own, other = 1.0 + 4.0 / WISHART_DOF, 3.0 / WISHART_DOF
    if not rotations or turn == 0.0:
        return np.array([0.0] * rotations + [(shift / own) ** 0.25] * 3)
    if shift == 0.0:
        return np.array([(turn / own) ** 0.25] * rotations + [0.0] * 3)
    # Divided by b^2 turn and shift leave a quadratic equation for a / b.
    ratio = turn / shift
    half = 0.5 * other * (1.0 - ratio) / own
    quotient = -half + np.sqrt(half**2 + ratio)
    b = np.sqrt(shift / (own + other * quotient))
    return np.asarray(np.sqrt([quotient * b] * rotations + [b] * 3))


def blocks(k: int) -> list[slice]:
    """Rows of k closure components that have one unit: rotations and positions, or positions alone."""
    return [slice(0, 3), slice(3, 6)] if k == 6 else [slice(0, k)]


def covariance(one: list[Half], two: list[Half], s: FloatArray) -> FloatArray:
    """Covariance (k m, k m') of the displacements at two lots of poses (module's head)."""
    k, nu = len(s), WISHART_DOF
    total = np.zeros((len(one[0].pull) * k, len(two[0].pull) * k))
    for here, there in zip(one, two, strict=True):
        a, b = len(here.pull), len(there.pull)
        flat = here.pull.reshape(a * k, -1) @ there.pull.reshape(b * k, -1).T
        G = flat.reshape(a, k, b, k)
        trace = np.einsum("aibi->ab", G)
        C = G + G.transpose(0, 3, 2, 1) / nu
        C[:, range(k), :, range(k)] += trace / nu
        C *= s[:, None, None] * s
        # One product for all of a pose's columns, first along the rows and then along the columns.
        half_turned = (here.turn @ C.reshape(a, k, b * k)).reshape(a * k, b, k).transpose(1, 2, 0)
        total += (there.turn @ half_turned).reshape(b * k, a * k).T
    return total


def variance(halves: list[Half], s: FloatArray) -> FloatArray:
    """Diagonal (m, k) of `covariance`."""
    k, nu = len(s), WISHART_DOF
    total = np.zeros((len(halves[0].pull), k))
    for half in halves:
        G = half.pull @ np.swapaxes(half.pull, -1, -2)
        C = (1.0 + 1.0 / nu) * G
        C[:, range(k), range(k)] += np.trace(G, axis1=-2, axis2=-1)[:, None] / nu
        C *= s[:, None] * s
        total += ((half.turn @ C) * half.turn).sum(-1)
    return np.asarray(total)
