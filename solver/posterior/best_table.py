"""The D-H table with which an arm without corrections of readings best reproduces the full model's tool positions.

The full model corrects the readings q by r(q) = S(q) b, where b are the coefficients of the effects. Many controllers,
and a URDF, have no such corrections. So the table is changed by dT to give, without corrections, nearly the tool
positions of the full model at the poses where the arm is used (method, section 10, "Best table"). With J_T and J_q the
derivatives of the tool position with respect to table entries and joint angles, dT minimises

    sum_q w_q |J_T dT - J_q r|^2 / s^2 + |dT / d|^2,

where s is a small tool error and d the largest plausible error of an entry. The solution is linear in b: dT = G b. So
the table's covariance follows from that of parameters and b. The tool displacement that no table can represent is
(J_q S - J_T G) b. Its rms is `left_m`.
"""

from collections.abc import Sequence
from dataclasses import dataclass, replace
from math import radians

import numpy as np

from solver.arrays import FloatArray, even_points
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.loops.endpoints import TIP, PointClosure
from solver.posterior.corrections import CorrectionShapes, JointCorrections

CLOSE_M = 1e-4
"""s of the module's formula: tool error that weighs as much as a change of a table entry by d."""

LENGTH_M, TWIST_RAD, OFFSET_RAD = 1e-3, radians(0.2), radians(1.0)
"""d of the module's formula: largest plausible errors of entries. It keeps undetermined entries near their values."""

NEAR_RAD, NEAR_SHARE, ANYWHERE_SHARE, TIMES = np.deg2rad(20.0), 0.25, 0.01, 2
"""Poses for which the table is computed, apart from the m poses of the session. TIMES m poses, within NEAR_RAD of the
session's, have the share NEAR_SHARE of the weight. TIMES m poses anywhere in the ranges, where a table could otherwise
be arbitrary, have the share ANYWHERE_SHARE."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class BestTable:
    """A D-H table, the tool's point in its last frame, and the uncertainty of both.

    `rows` (5, n): theta_off, s, a, alpha and beta of links 1..n, rad and m. `tip_m` (3,): the tool's point in frame n.
    `entries`: names of the k entries and tip coordinates that the fit determines.
    `covariance` (k, k): covariance of `entries`, rad and m.
    `left_m`: rms position error of the tool, m, from corrections that no D-H table represents, and their uncertainty.
    `sigma_m`: expected rms position error of the tool where the arm is used.
    """

    rows: FloatArray
    tip_m: FloatArray
    entries: tuple[str, ...]
    covariance: FloatArray
    left_m: float
    sigma_m: float = 0.0

    @property
    def table(self) -> DhTable:
        """The best table as a `DhTable`, without the tool's point."""
        return DhTable.from_stacked(self.rows)

    def tool(self, q: FloatArray) -> tuple[FloatArray, FloatArray]:
        """Return the tool's point in the base frame (m, 3), m, and the standard deviation of its error (m,), m."""
        position, by_names, _ = tool_positions(self.table, self.tip_m, self.entries, q)
        J = by_names.reshape(3 * len(q), -1)
        spread = ((J @ self.covariance) * J).reshape(len(q), -1).sum(-1)
        return position, np.sqrt(np.maximum(spread, 0.0) + self.left_m**2)


def tool_positions(
    table: DhTable, tip_m: FloatArray, names: Sequence[str], q: FloatArray
) -> tuple[FloatArray, FloatArray, FloatArray]:
    """Return the tool's point in the base frame (m, 3), m, at readings q (m, n), rad, and two arrays of derivatives.

    One array (m, 3, k) is with respect to the k entries and tip coordinates in `names`, the other (m, 3, n) with
    respect to the readings.
    """
    point = PointClosure(
        table=table,
        entries=tuple(_entries_of(names)),
        tip_m=tip_m,
        ground_m=np.zeros(3),
        own=tuple(name for name in names if name in TIP),
    )
    # With the socket at the base's origin, the closure error is the position.
    at = point.loop(nominal_vector(point.parameters), q, np.zeros((*q.shape[:-1], 0)))
    order = [p.name for p in point.parameters]
    return at.residual, at.jac_x[..., [order.index(name) for name in names]], at.jac_q


def _entries_of(names: Sequence[str]) -> list[DhEntry]:
    return [DhEntry.parse(name) for name in names if name not in TIP]


def every_entry(links: int, hayati: Sequence[int] = ()) -> list[DhEntry]:
    """Return all entries of a D-H table of links 1..n: theta_off, s, a, alpha; rows `hayati` have beta instead of s."""
    return [
        DhEntry(kind, row)
        for row in range(1, links + 1)
        for kind in (
            DhKind.THETA_OFF, DhKind.BETA if row in hayati else DhKind.S, DhKind.A, DhKind.ALPHA,
        )
    ]  # fmt: skip


def where_used(
    q: FloatArray, lower_rad: FloatArray, upper_rad: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return readings (m, n), rad, at which an arm is likely to be used, and their weights (m,), whose sum is 1.

    The first k are the session's `q` (k, n); others are near these, or anywhere from `lower_rad` to `upper_rad` (n,).
    """
    k = len(q)
    even = even_points(TIMES * k, q.shape[1])
    near = np.tile(q, (TIMES, 1)) + NEAR_RAD * (2.0 * even - 1.0)
    anywhere = lower_rad + even * (upper_rad - lower_rad)
    share = np.array(
        (1.0 - NEAR_SHARE - ANYWHERE_SHARE, NEAR_SHARE / TIMES, ANYWHERE_SHARE / TIMES)
    )
    weight = np.repeat(share / k, (k, TIMES * k, TIMES * k))
    return np.concatenate((q, near, anywhere)), weight


def best_table(
    table: DhTable,
    tip_m: FloatArray,
    corrections: JointCorrections,
    readings: CorrectionShapes,
    weight: FloatArray,
    *,
    known: Sequence[str],
    covariance: FloatArray,
    hayati: Sequence[int] = (),
    fixed: Sequence[str] = (),
    tip: bool = True,
) -> BestTable:
    """Return the table near `table` with which an arm without corrections best reproduces the corrected tool positions.

    `readings`, `weight` (m,): poses where the arm is used, and their weights of sum 1; see `where_used`.
    `known`: names of the entries of `table` and tip coordinates (k of them) that the calibration identified.
    `covariance` (k + c, k + c): covariance of the values of `known`, followed by the c coefficients of `corrections`.
    `hayati`: rows with beta instead of s. `fixed`: entries of the fixture's placement, which do not change.
    `tip`: whether the tool's point may move in the last frame. A ball's centre must, because it is no D-H entry.
    """
    m = len(weight)
    every = (*(entry.name for entry in every_entry(table.links, hayati)), *TIP)
    names = [n for n in every if n in known or (n not in fixed and (tip or n not in TIP))]
    _, by_names, by_q = tool_positions(table, tip_m, names, readings.q)
    size = np.array([_size(name) for name in names])
    root = np.sqrt(np.repeat(weight, 3))
    J = by_names.reshape(3 * m, -1)
    by_corrections = by_q[..., corrections.joint_of] * readings.shapes[:, None, :]
    base = (by_q @ readings.expected[..., None]).reshape(-1)
    corrected = np.column_stack((by_corrections.reshape(3 * m, -1), base))
    A = (root / CLOSE_M)[:, None] * J * size
    # With the unit matrix, the normal equations are well conditioned.
    normal = A.T @ A + np.eye(len(names))
    right = A.T @ ((root / CLOSE_M)[:, None] * corrected)
    G = size[:, None] * np.linalg.solve(normal, right)
    b = np.append(corrections.coefficients, 1.0)
    not_represented = corrected - J @ G
    k = len(known)
    spread = ((not_represented[:, :-1] @ covariance[k:, k:]) * not_represented[:, :-1]).sum(-1)
    mean_square = float(root**2 @ ((not_represented @ b) ** 2 + np.maximum(spread, 0.0)))
    to_names = np.zeros((len(names), k))
    to_names[[names.index(name) for name in known], range(k)] = 1.0
    M = np.column_stack((to_names, G[:, :-1]))
    step = dict(zip(names, G @ b, strict=True))
    rows = table.stacked()
    for entry in _entries_of(names):
        rows[entry.kind, entry.row - 1] += step[entry.name]
    best = BestTable(
        rows=rows,
        tip_m=tip_m + np.array([step.get(name, 0.0) for name in TIP]),
        entries=tuple(names),
        covariance=M @ covariance @ M.T,
        left_m=float(np.sqrt(mean_square)),
    )
    return replace(best, sigma_m=float(np.sqrt(weight @ best.tool(readings.q)[1] ** 2)))


def _size(name: str) -> float:
    if name in TIP:
        return 10.0 * LENGTH_M
    kind = DhEntry.parse(name).kind
    if kind is DhKind.THETA_OFF:
        return OFFSET_RAD
    return TWIST_RAD if kind.is_angle else LENGTH_M
