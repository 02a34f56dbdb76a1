"""Proposes home poses, and fixtures from measured lines and points.

In a good home pose every joint moves if the closed chain moves; if the arm is stretched, some joints do not move. The
proposals use nominal geometry.
"""

from collections.abc import Iterator
from dataclasses import replace

import numpy as np

from fixtures.ball import Ball
from fixtures.base import EndpointConstraint
from fixtures.hinge import Hinge
from operator_app.planning.feasibility import Feasibility, assess_feasibility, home_to_closed_rad
from solver.arrays import FloatArray, frozen
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.loops.closure import ClosureModel
from solver.loops.endpoint_geometry import Line

TRIED_HOMES = 2000
"""Number of poses from which a home is chosen."""
MIDDLE = 0.6
"""Share of every range, around its middle, from which the tried poses are drawn."""
CLEAR = 0.1
"""Smallest distance of a proposed home from either end of a joint's range, as a share of the range."""
AS_GOOD = 0.6
"""A pose nearer to the middle of the ranges is preferred if its score is at least this share of the best score."""
HOME_DISTANCE_RAD = float(np.deg2rad(30.0))
"""Largest allowed distance of home from a closed pose; errors in measuring the fixture alone cause less than this."""
CONDITION_LIMIT = 100.0
"""The paper's limit of the scaled condition number, applied to proposed homes."""
BEST = 2
"""Number of closed poses whose identifiability is predicted."""
AXES = frozen(np.array([[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [1.0, 1.0, 1.0], [1.0, -1.0, 1.0]]))
"""Hinge axis directions in the tool frame, tried while the fixture is unknown; none is along the last joint's axis."""


def bent_home(arm: ArmModel) -> FloatArray | None:
    """Return a pose (n,), rad, in whole degrees, in which every joint can move while a hinge holds the tool.

    The result is None if the arm's home is good enough, or if no such pose was found.
    """
    q = np.concatenate((arm.home_rad[None], _drawn(arm)))
    score = np.mean([_least_motion(_in_a_hinge(arm, q, axis)) for axis in AXES], axis=0)
    best = float(score.max())
    if best == 0.0 or score[0] >= 0.5 * AS_GOOD * best:
        return None
    good = q[score >= AS_GOOD * best]
    ranges = _ranges(arm)
    from_middle = (good - ranges.mean(axis=1)) / np.diff(ranges, axis=1)[:, 0]
    return _whole_degrees(good[np.argmin(np.abs(from_middle).max(axis=1))])


def closing_home(
    arm: ArmModel,
    fixture: EndpointConstraint,
    from_home: Feasibility,
    *,
    position_joints: tuple[int, ...] | None = None,
    unsensed_joints: tuple[int, ...] = (),
) -> tuple[FloatArray, Feasibility] | None:
    """Return a home pose (n,), rad, within a degree of a closed pose near the arm's home, and its `Feasibility`.

    `from_home`: feasibility with the home in the arm file and the same drive and unsensed joints. Returns None if
    that home is good enough, if the chain is open, or if no pose is found.
    """
    distance_rad = from_home.home_to_closed_rad
    if not fixture.holds_hand or (
        not from_home.refused
        and distance_rad is not None
        and float(np.abs(distance_rad).max()) <= HOME_DISTANCE_RAD
    ):
        return None
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    for q in _closed(arm, model, x):
        arm_there = replace(arm, home_rad=frozen(_whole_degrees(q)))
        prospect = assess_feasibility(
            arm_there, fixture, position_joints=position_joints, unsensed_joints=unsensed_joints
        )
        identified = prospect.identifiability
        if prospect.refused or prospect.home_to_closed_rad is None:
            continue
        if identified is None or identified.scaled_condition_number <= CONDITION_LIMIT:
            return arm_there.home_rad, prospect
    return None


def _closed(arm: ArmModel, model: ClosureModel, x: FloatArray) -> Iterator[FloatArray]:
    """Yield closed poses, nearest to home first, with all joints mobile and away from the ends of their ranges."""
    closed = close_loops(model, x, np.concatenate((arm.home_rad[None], _drawn(arm))))
    low, high = _ranges(arm).T
    room = CLEAR * (high - low)
    inside = closed.closed & ((closed.q > low + room) & (closed.q < high - room)).all(axis=1)
    if not inside.any():
        return
    q = closed.q[inside]
    error = model.at_poses(np.flatnonzero(inside)).loop(x, q, closed.u[inside])
    columns = np.concatenate((error.jac_q, error.jac_u), axis=-1)
    # The last three rows are positions, in m; a loop without rotation equations has only these.
    columns[:, -3:] /= _size_m(arm)
    score = _least_motion(columns, joints=arm.joint_count)
    good = q[(score > 0.0) & (score >= AS_GOOD * score.max())]
    distance = np.abs(good - arm.home_rad).max(axis=1)
    yield from good[np.argsort(distance, kind="stable")[:BEST]]


def _least_motion(columns: FloatArray, joints: int | None = None) -> FloatArray:
    """Return how well (m,) the least mobile joint of each of m closed chains can move, from 0 (not at all) to 1.

    The measure is the joint's largest motion in a self-motion of norm 1, multiplied by the ratio of the smallest to the
    largest singular value of the Jacobian. This ratio is small near a singularity. `columns` (m, k, d): Jacobians, with
    k rows and a column for each of d angles. Only the first `joints` angles (default: all) are considered.
    """
    rows, freedoms = columns.shape[1:]
    if freedoms <= rows:
        return np.zeros(len(columns))
    _, size, Vt = np.linalg.svd(columns)
    moves = np.linalg.norm(Vt[:, rows:, : (joints or freedoms)], axis=1)
    return np.asarray(moves.min(axis=1) * size[:, -1] / size[:, 0])


def _in_a_hinge(arm: ArmModel, q: FloatArray, axis: FloatArray) -> FloatArray:
    """Return the tool's Jacobians (m, 6, n + 1) at `q` (m, n), with respect to the n joints and a hinge on the tool.

    The hinge passes through the tool point, along `axis` (3,) of the tool frame. Lengths are divided by the arm's size.
    """
    frames = arm.table.frames(q)
    z, at = frames.axes[:, :-1, :, 2], frames.origins_m[:, :-1]
    lever = (frames.p_end[:, None] - at) / _size_m(arm)
    joints = np.concatenate((z, np.cross(z, lever)), axis=2)
    hinge = frames.R_end @ (axis / np.linalg.norm(axis))
    own = np.concatenate((hinge, np.zeros_like(hinge)), axis=1)
    return np.swapaxes(np.concatenate((joints, own[:, None]), axis=1), 1, 2)


def _drawn(arm: ArmModel) -> FloatArray:
    """Return poses (m, n), rad, evenly spread over the middle of the ranges; every call returns the same poses."""
    from scipy.stats import qmc

    ranges = _ranges(arm)
    share = qmc.Halton(arm.joint_count, scramble=False).random(TRIED_HOMES)
    return np.asarray(ranges.mean(axis=1) + MIDDLE * (share - 0.5) * np.diff(ranges, axis=1)[:, 0])


def _ranges(arm: ArmModel) -> FloatArray:
    return np.column_stack((arm.lower_rad, arm.upper_rad))


def _size_m(arm: ArmModel) -> float:
    return max(float(np.abs(arm.table.s_m).sum() + np.abs(arm.table.a_m).sum()), 1e-3)


def _whole_degrees(q: FloatArray) -> FloatArray:
    return np.deg2rad(np.rint(np.rad2deg(q)))


def ball_between(arm: ArmModel, hand_m: FloatArray, base_m: FloatArray | None) -> Ball:
    """Return the ball with its centre at `hand_m` (3,), tool frame, and its socket at `base_m` (3,), base frame, in m.

    If `base_m` is None, the socket is where the ball's centre is at the arm's home pose.
    """
    if base_m is None:
        home = arm.table.frames(arm.home_rad)
        base_m = home.p_end + home.R_end @ hand_m
    x, y, z = hand_m.tolist()
    u, v, w = base_m.tolist()
    return Ball(tip_m=(x, y, z), ground_m=(u, v, w))


def hinge_between(arm: ArmModel, hand: Line, base: Line | None) -> Hinge:
    """Return the hinge in which the line `hand` of the tool frame coincides with the line `base` of the base frame.

    The points that define the lines coincide too. The lines point the same way or opposite ways, whichever lets the
    loop close nearer to the arm's home. If `base` is None, the hinge is where `hand` lies at the arm's home pose.
    """
    if base is None:
        home = arm.table.frames(arm.home_rad)
        return Hinge.between(arm, hand.in_frame(home.R_end, home.p_end), hand)

    def largest_distance(hinge: Hinge) -> float:
        distances = home_to_closed_rad(arm, hinge)
        return np.inf if distances is None else float(np.abs(distances).max())

    ways = [
        Hinge.between(arm, Line(point_m=base.point_m, direction=sign * base.direction), hand)
        for sign in (1.0, -1.0)
    ]
    return min(ways, key=largest_distance)
