"""Home poses to propose: bent ones of an arm alone, and closed ones of an arm in its fixture.

A home is good where every joint takes part when the closed chain moves: a stretched arm's does not. Judged by
nominal geometry. Knows no file and moves nothing.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fixtures.base import Fixture
from operator_app.planning.outlook import Outlook, outlook
from solver.arrays import BoolArray, FloatArray, frozen
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import forward
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.loops.closure import ClosureModel

TRIED = 2000
"""Poses looked at."""
MIDDLE = 0.6
"""Share of every range, about its middle, from which they are drawn."""
CLEAR = 0.1
"""Share of a range that a home leaves to either end, for the joint to move both ways."""
AS_GOOD = 0.6
"""A pose nearer to the middle of the ranges is preferred where it is this good, the best being 1."""
FAR_RAD = float(np.deg2rad(30.0))
"""A home further than this from every closed pose is none: more than a ruler errs by."""
CONDITION_LIMIT = 100.0
"""The paper's: a home from whose poses a calibration would be refused is none."""
BEST = 2
"""Closed poses that are asked whether a calibration would get anywhere from them."""
AXES = frozen(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]))
"""Ways a hinge's axis may lie in the hand, none along the last joint's: of which fixture it will be nobody knows."""


def bent_home(arm: ArmModel) -> FloatArray | None:
    """Return a pose (n,) whose joints all move in a hinge; None where the arm's home is as good, or none is.

    Rounded to whole degrees: it is to be read, and changed, by a person.
    """
    q = np.concatenate((arm.home_rad[None], _drawn(arm)))
    score = np.mean([_least_motion(_in_a_hinge(arm, q, axis)) for axis in AXES], axis=0)
    best = float(score.max())
    if best == 0.0 or score[0] >= 0.5 * AS_GOOD * best:
        return None
    good = q[score >= AS_GOOD * best]
    ranges = _ranges(arm)
    off = (good - ranges.mean(axis=1)) / np.diff(ranges, axis=1)[:, 0]
    return _whole_degrees(good[np.argmin(np.abs(off).max(axis=1))])


def closing_home(
    arm: ArmModel, fixture: Fixture, from_home: Outlook
) -> tuple[FloatArray, Outlook] | None:
    """Return a pose (n,) that closes in the fixture, from which all can be done, and what would come of it.

    None where the arm's own home will do, as `from_home` says, and where no pose was found. It is within a
    degree of a closed one, and of the good ones among these the nearest to home.
    """
    off = from_home.from_home_rad
    if not fixture.holds_hand or (
        not from_home.refused and off is not None and float(np.abs(off).max()) <= FAR_RAD
    ):
        return None
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    for q in _closed(arm, model, x):
        there = replace(arm, home_rad=frozen(_whole_degrees(q)))
        found = outlook(there, fixture)
        if not found.refused and found.from_home_rad is not None and _is_seen_well(found):
            return there.home_rad, found
    return None


def _closed(arm: ArmModel, model: ClosureModel, x: FloatArray) -> Iterator[FloatArray]:
    """Yield some closed poses, clear of the ends of the ranges, whose joints all move; those near home first."""
    found = close_loops(model, x, np.concatenate((arm.home_rad[None], _drawn(arm))))
    here = found.closed & _clear(arm, found.q)
    if not here.any():
        return
    q = found.q[here]
    error = model.at_poses(np.flatnonzero(here)).loop(x, q, found.u[here])
    columns = np.concatenate((error.jac_q, error.jac_u), axis=-1)
    # Of six rows the last three are lengths; fewer are lengths alone.
    columns[:, -3:] /= _size_m(arm)
    score = _least_motion(columns, joints=arm.joint_count)
    good = q[(score > 0.0) & (score >= AS_GOOD * score.max())]
    off = np.abs(good - arm.home_rad).max(axis=1)
    yield from good[np.argsort(off, kind="stable")[:BEST]]


def _is_seen_well(found: Outlook) -> bool:
    return found.seen is None or found.seen.scaled_condition_number <= CONDITION_LIMIT


def _least_motion(columns: FloatArray, joints: int | None = None) -> FloatArray:
    """How much the joint moves that moves least, in a chain of these velocities (m, k, freedoms); 0: a joint is still.

    Less where the chain is nearly singular, and its motion another one just beside.
    """
    rows, freedoms = columns.shape[1:]
    if freedoms <= rows:
        return np.zeros(len(columns))
    _, size, Vt = np.linalg.svd(columns)
    moves = np.linalg.norm(Vt[:, rows:, : (joints or freedoms)], axis=1)
    return np.asarray(moves.min(axis=1) * size[:, -1] / size[:, 0])


def _in_a_hinge(arm: ArmModel, q: FloatArray, axis: FloatArray) -> FloatArray:
    """Velocities (m, 6, n + 1) of the hand at `q` (m, n), and of a hinge at it along `axis` (3,) of its frame."""
    theta_off, *rest = arm.table.stacked()
    frames = forward(q + theta_off, *rest)
    z, at = frames.axes[:, :-1, :, 2], frames.origins_m[:, :-1]
    lever = (frames.p_end[:, None] - at) / _size_m(arm)
    joints = np.concatenate((z, np.cross(z, lever)), axis=2)
    hinge = frames.R_end @ (axis / np.linalg.norm(axis))
    own = np.concatenate((hinge, np.zeros_like(hinge)), axis=1)
    return np.swapaxes(np.concatenate((joints, own[:, None]), axis=1), 1, 2)


def _drawn(arm: ArmModel) -> FloatArray:
    """Poses (m, n) evenly over the middle of the ranges, always the same."""
    from scipy.stats import qmc

    ranges = _ranges(arm)
    share = qmc.Halton(arm.joint_count, scramble=False).random(TRIED)
    return np.asarray(ranges.mean(axis=1) + MIDDLE * (share - 0.5) * np.diff(ranges, axis=1)[:, 0])


def _clear(arm: ArmModel, q: FloatArray) -> BoolArray:
    low, high = _ranges(arm).T
    room = CLEAR * (high - low)
    return np.asarray(((q > low + room) & (q < high - room)).all(axis=1))


def _ranges(arm: ArmModel) -> FloatArray:
    return np.column_stack((arm.lower_rad, arm.upper_rad))


def _size_m(arm: ArmModel) -> float:
    return max(float(np.abs(arm.table.s_m).sum() + np.abs(arm.table.a_m).sum()), 1e-3)


def _whole_degrees(q: FloatArray) -> FloatArray:
    return np.deg2rad(np.rint(np.rad2deg(q)))
