"""Checks that new poses can verify a calibration: of its fixture and placement, and none of its own poses."""

from __future__ import annotations

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration.instrument_registration import with_calibrated_places
from operator_app.calibration.prediction import MadeFrom
from operator_app.calibration.result import Solution
from operator_app.calibration.verification import (
    VerificationResult,
    fixed_calibration,
    verify_poses,
)
from solver.arrays import BoolArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.limits import SAME_POINT_M, SAME_READING_RAD

HUNDREDTH_RAD = np.deg2rad(0.01)
"""Readings that are all whole multiples of this were written with two decimals."""


NAMED = 5
"""Most poses named one by one."""


class NoTestError(ValueError):
    """These poses cannot test the calibration; the text says why."""


def verify_new_poses(
    arm: ArmModel,
    fixture: EndpointConstraint,
    solution: Solution,
    *,
    made_from: PoseSet,
    new: PoseSet,
) -> VerificationResult:
    """Test a calibration with poses that are not its own.

    `made_from`: the poses of `solution`. `new`: other poses, of one calibrated placement or of all of them. Raises
    `NoTestError` if the new poses cannot test this calibration.
    """
    require_new(new, made_from, fixture)
    if new.endpoint is not None and fixture.kind != "measured":
        raise NoTestError(
            f"the new poses have measured endpoints, which a {fixture.kind} fixture does not use: "
            "verify with them by sarcal verify --open-loop, or leave them out"
        )
    known, there = made_from.placements, new.placements
    fixed, made = fixed_calibration(solution), MadeFrom(solution=solution, poses=made_from)
    fixture = with_calibrated_places(fixture, solution.model)
    if fixture.kind == "ball" and fixture.stays_on_hand:
        # The place of another socket is found from the new poses themselves.
        return verify_poses(arm, fixture, new, fixed, calibrated=known, made=made)
    if len(there) > 1 and there != known:
        raise NoTestError(
            "new poses must be of one placement that was calibrated, or of all of them"
        )
    if len(known) > 1 and not set(there) <= set(known):
        raise NoTestError(f"the new poses are of placement {there[0]}, which was not calibrated")
    if len(there) == 1:
        fixed = fixed_calibration(solution, there[0])
    return verify_poses(arm, fixture, new, fixed, made=made)


def require_new(new: PoseSet, made_from: PoseSet, fixture: EndpointConstraint) -> None:
    """Refuse a set that contains a calibration's own poses, which it fits in any case.

    With an instrument, a pose measured again at the same reading is a new one.

    Raises `NoTestError`, whose text states how many and which.
    """
    if new.joint_count != made_from.joint_count:
        return
    own = np.flatnonzero(_are_among(new, made_from, measured=fixture.kind == "measured"))
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


def _are_among(new: PoseSet, made_from: PoseSet, *, measured: bool) -> BoolArray:
    """Whether each of the new poses equals one of the others to the written decimals: (m,)."""
    rounded = any(_in_hundredths(p) for p in (new, made_from))
    same_rad = 0.5 * HUNDREDTH_RAD + SAME_READING_RAD if rounded else SAME_READING_RAD
    both = [p.q_rad / same_rad for p in (new, made_from)]
    if measured and new.endpoint is not None and made_from.endpoint is not None:
        columns = min(new.endpoint.shape[1], made_from.endpoint.shape[1])
        size = np.repeat((SAME_POINT_M, SAME_READING_RAD), 3)[:columns]
        ends = [p.endpoint[:, :columns] / size for p in (new, made_from) if p.endpoint is not None]
        both = [np.hstack(pair) for pair in zip(both, ends, strict=True)]
    from scipy.spatial import KDTree

    distance, _ = KDTree(both[1]).query(both[0], p=np.inf)
    return np.asarray(distance < 1.0)


def _in_hundredths(poses: PoseSet) -> bool:
    steps = poses.q_rad / HUNDREDTH_RAD
    return bool(np.all(np.abs(steps - np.round(steps)) < 1e-6))
