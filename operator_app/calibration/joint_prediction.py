"""Does a pose lie where those before it have it? What slips on the way to a pose shows in it. Knows no session.

A drive makes up within a SYNC for what the sensor of its joint loses: nothing jumps alone, and the loop stays
closed by readings that are wrong. The poses before know better, within what the files leave open.
"""

from __future__ import annotations

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.closed_loops import pick
from operator_app.calibration.prior import Fitted, fitted, noise_of
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.cross_validation import verify
from solver.diagnostics.limits import POSE_CHI2_RATIO_UNPREDICTED, POSE_CHI2_UNPREDICTED

LEAST, AT_MOST = 10, 60
"""Poses before it from which it is asked, and on which it is looked back: what it costs stays the same."""


def out_of_line(
    arm: ArmModel, fixture: Fixture, poses: PoseSet, *, unsensed_joints: tuple[int, ...] = ()
) -> bool:
    """Whether the last of these poses is not where those before it have it."""
    count = len(poses)
    if count <= LEAST or not fixture.holds_hand:
        return False
    before, last = pick(poses, np.arange(count - 1)), pick(poses, np.array([count - 1]))
    by = line_of(arm, fixture, before, unsensed_joints=unsensed_joints)
    return by is not None and is_off(by, arm, fixture, last, unsensed_joints=unsensed_joints)


def line_of(
    arm: ArmModel, fixture: Fixture, before: PoseSet, *, unsensed_joints: tuple[int, ...] = ()
) -> Fitted | None:
    """Fit the poses on which it is looked back; None where they do not give a fit."""
    count = len(before)
    recent = pick(before, np.arange(max(0, count - AT_MOST), count))
    return fitted(arm, fixture, recent, unsensed_joints=unsensed_joints)


def is_off(
    by: Fitted,
    arm: ArmModel,
    fixture: Fixture,
    last: PoseSet,
    *,
    unsensed_joints: tuple[int, ...] = (),
) -> bool:
    """Whether one pose is not where those of `by` have it."""
    found = verify(
        by.model.at_poses(np.array([0])),
        by.fit.x,
        by.fit.covariance,
        last.q_rad,
        noise_of(arm, fixture, last, unsensed_joints),
    )
    return float(found.pose_chi2[0]) > max(
        POSE_CHI2_UNPREDICTED, POSE_CHI2_RATIO_UNPREDICTED * float(by.fit.pose_chi2.max())
    )
