"""Checks that new poses can test a calibration: that they are from its arm, new, and in a suitable placement."""

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from operator_app.calibration.result import Solution
from solver.arrays import BoolArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics import limits
from solver.diagnostics.range_checks import ReadingsOutOfRangeError, range_findings
from solver.errors import SolverError

HUNDREDTH_RAD = np.deg2rad(0.01)
"""0.01 deg: if all readings are whole multiples of this, the file states degrees with two decimals."""

NAMED = 5
"""Largest number of poses that a message names."""

DEFAULT_PLACEMENT = 1
"""Placement number of poses whose file states none."""

LEAST_POINTS, LEAST_FULL_POSES = 4, 2
"""Fewest poses from another station for a test: if only points are measured, and if orientations are measured too.
With three points, the station's six unknowns would use up six of the nine equations."""


class NoTestError(SolverError, ValueError):
    """These poses cannot test the calibration; the text states why."""


def require_in_range(arm: ArmModel, new: PoseSet, solution: Solution) -> None:
    """Raise `NoTestError` if the new readings cannot be from this arm, e.g. if they are in radians."""
    try:
        range_findings(arm, new, unsensed_joints=solution.model.unsensed_joints)
    except ReadingsOutOfRangeError as error:
        raise NoTestError(str(error)) from error


def may_be_elsewhere(fixture: EndpointConstraint) -> bool:
    """Whether poses in a placement that was not calibrated (another socket or station) can test a calibration.

    The fixture must be a ball, or an instrument whose station no file fixes. Ball or target must stay on the tool.
    """
    moves = fixture.kind == "ball" or (isinstance(fixture, Measured) and not fixture.base_known)
    return moves and fixture.stays_on_hand


def is_elsewhere(new: PoseSet, made_from: PoseSet, fixture: EndpointConstraint) -> bool:
    """Whether the placements of the new poses have to be estimated, because they may not have been calibrated."""
    if not may_be_elsewhere(fixture):
        return False
    return fixture.kind == "ball" or not _are_calibrated(new, made_from)


def _are_calibrated(new: PoseSet, made_from: PoseSet) -> bool:
    """Whether all placements of `new` were calibrated: they are all those of `made_from`, or a single one of these."""
    known, states = made_from.placements, new.placements
    # Files have placement 1 by default: it stands for the only calibrated placement, whatever its number.
    if len(known) == 1 and states == (DEFAULT_PLACEMENT,):
        return True
    return states == known or (len(states) == 1 and states[0] in known)


def require_calibrated_placement(
    new: PoseSet, made_from: PoseSet, fixture: EndpointConstraint
) -> None:
    """Raise `NoTestError` unless new poses are of one or all calibrated placements, or `may_be_elsewhere` holds."""
    if may_be_elsewhere(fixture) or _are_calibrated(new, made_from):
        return
    known, states = made_from.placements, new.placements
    missing = [k for k in states if k not in known]
    if not missing:
        raise NoTestError(
            "new poses must be of one placement that was calibrated, or of all of them"
        )
    remedy = (
        f"take new poses in placement {known[0]}, or correct the column placement if they are of it"
    )
    if isinstance(fixture, Measured):
        remedy = (
            "the fixture file's base_known fixes the instrument's station; calibrate without it to test with "
            "another"
        )
    raise NoTestError(
        f"the new poses are of placement {missing[0]}, which was not calibrated (calibrated: "
        f"{', '.join(map(str, known))}): {remedy}"
    )


def require_new(new: PoseSet, made_from: PoseSet, fixture: EndpointConstraint) -> None:
    """Raise `NoTestError` if the new set contains poses of the calibration, which fit in any case.

    With an instrument, a pose measured again at the same joint readings counts as new.
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
            f"{len(own)} of the {len(new)} poses ({', '.join(names)}) are poses that the calibration was "
            "made from"
        )
    raise NoTestError(f"{who}: they verify nothing; use other poses")


def require_poses_at_a_place(new: PoseSet, made_from: PoseSet, fixture: EndpointConstraint) -> None:
    """Raise `NoTestError` if an uncalibrated placement has so few poses that they suffice only to locate it."""
    others = [k for k in new.placements if k not in made_from.placements]
    if fixture.kind == "ball" and len(new) <= len(others):
        raise NoTestError(
            "a single pose in another socket only determines where that socket is: use at least two different poses "
            "in one of the sockets"
        )
    if isinstance(fixture, Measured):
        full = fixture.full_pose and all(
            p.endpoint is not None and p.endpoint.shape[1] == 6 for p in (new, made_from)
        )
        least = LEAST_FULL_POSES if full else LEAST_POINTS
        few = [k for k in others if int((new.placement == k).sum()) < least]
        if few:
            raise NoTestError(
                f"placement {few[0]} was not calibrated, and fewer than {least} different poses only determine where "
                f"the instrument stands: measure at least {least} different poses from there"
            )


def _are_among(new: PoseSet, made_from: PoseSet, *, measured: bool) -> BoolArray:
    """Return a mask (m,) of the new poses that equal a pose of `made_from`, apart from rounding in their files.

    `measured`: whether measured endpoints have to be equal too, if both sets have them.
    """
    steps = [p.q_rad / HUNDREDTH_RAD for p in (new, made_from)]
    rounded = any(np.all(np.abs(s - np.round(s)) < 1e-6) for s in steps)
    same_rad = 0.5 * HUNDREDTH_RAD + limits.SAME_READING_RAD if rounded else limits.SAME_READING_RAD
    both = [p.q_rad / same_rad for p in (new, made_from)]
    if measured and new.endpoint is not None and made_from.endpoint is not None:
        columns = min(new.endpoint.shape[1], made_from.endpoint.shape[1])
        size = np.repeat((limits.SAME_POINT_M, limits.SAME_READING_RAD), 3)[:columns]
        ends = [p.endpoint[:, :columns] / size for p in (new, made_from) if p.endpoint is not None]
        both = [np.hstack(pair) for pair in zip(both, ends, strict=True)]
    from scipy.spatial import KDTree

    distance, _ = KDTree(both[1]).query(both[0], p=np.inf)
    return np.asarray(distance < 1.0)
