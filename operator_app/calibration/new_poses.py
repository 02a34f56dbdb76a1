"""Whether poses can judge a calibration at all: new ones, of its fixture and placement. Knows no file, no screen."""

from __future__ import annotations

import numpy as np
from scipy.spatial import KDTree

from fixtures.base import Fixture
from operator_app.calibration.foretold import MadeFrom
from operator_app.calibration.placed import as_calibrated
from operator_app.calibration.solution import Solution
from operator_app.calibration.verify import Prediction, fixed_by, judge_poses
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet

SAME_RAD = 1e-5
"""Readings that differ by less in every joint are one reading, written with three decimals of a degree."""

NAMED = 5
"""Poses named one by one."""


class NoTestError(ValueError):
    """These poses say nothing of the calibration, or nothing can be said of them; says why."""


def judge_new(
    arm: ArmModel, fixture: Fixture, solution: Solution, *, made_from: PoseSet, new: PoseSet
) -> Prediction:
    """Judge a calibration by poses that took no part in it.

    Parameters
    ----------
    made_from
        The poses of `solution`.
    new
        Others, of one placement that was calibrated, or of all of them.

    Raises
    ------
    NoTestError
        They are not.
    """
    require_new(new, made_from)
    if new.endpoint is not None and fixture.kind != "measured":
        raise NoTestError(
            f"the new poses have measured endpoints, which a {fixture.kind} knows nothing of: sarcal verify "
            "--open-loop judges by them; without it, leave them out"
        )
    known, there = made_from.placements, new.placements
    if len(there) > 1 and there != known:
        raise NoTestError(
            "new poses must be of one placement that was calibrated, or of all of them"
        )
    if len(known) > 1 and not set(there) <= set(known):
        raise NoTestError(f"the new poses are of placement {there[0]}, which was not calibrated")
    fixed = fixed_by(solution, there[0] if len(there) == 1 else None)
    made = MadeFrom(solution=solution, poses=made_from)
    return judge_poses(arm, as_calibrated(fixture, solution.model), new, fixed, made=made)


def require_new(new: PoseSet, made_from: PoseSet) -> None:
    """Refuse a set in which a calibration's own poses are: those it fits, whatever else is wrong with it.

    Raises
    ------
    NoTestError
        Says how many and which.
    """
    if new.joint_count != made_from.joint_count:
        return
    own = np.flatnonzero(_nearest_rad(new.q_rad, made_from.q_rad) < SAME_RAD)
    if len(own) == 0:
        return
    if len(own) == len(new):
        who = "these are poses that the calibration was made from"
    else:
        names = [new.label[k] for k in own[:NAMED]] + ["..."] * (len(own) > NAMED)
        who = (
            f"{len(own)} of the {len(new)} poses ({', '.join(names)}) are of those that the calibration was "
            "made from"
        )
    raise NoTestError(f"{who}: they verify nothing; use poses that took no part in it")


def _nearest_rad(q: FloatArray, among: FloatArray) -> FloatArray:
    """Largest difference of a joint to the pose that is nearest by it, for each of q (m, n): (m,)."""
    distance, _ = KDTree(among).query(q, p=np.inf)
    return np.asarray(distance)
