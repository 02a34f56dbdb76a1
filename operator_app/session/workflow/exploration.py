"""Explored capture: moves from waypoint to waypoint; returns from one that cannot be reached, and skips it."""

from __future__ import annotations

from collections.abc import Callable, Mapping

import numpy as np

from hardware.arm import MoveResult
from operator_app.errors import GuardError
from operator_app.planning.exploration import overload
from operator_app.session.workflow.drive_box import require_in_box, waypoints_of
from operator_app.session.workflow.instrument import TargetLostError
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session

STARTING_SYNCS = 20
STANDS_STILL_RAD = float(np.deg2rad(0.2))
"""A move that ends within `STARTING_SYNCS` this close to its start has not started."""


def reach(
    session: Session, targets_rad: Mapping[int, float], *, speed_rad_per_s: float | None = None
) -> MoveResult:
    """Move to these angles; if the move is stopped, go back the same way."""
    before = session.arm.snapshot().positions_rad
    moved = session.go_to(targets_rad, speed_rad_per_s=speed_rad_per_s)
    if not moved.reached:
        back = session.go_to(
            {j: float(before[j - 1]) for j in targets_rad}, speed_rad_per_s=speed_rad_per_s
        )
        still = float(np.abs(back.positions_rad - before).max()) < STANDS_STILL_RAD
        loaded = overload(session.model, session.arm.snapshot())
        if loaded and still and not back.reached and moved.syncs <= STARTING_SYNCS:
            raise GuardError(
                f"the arm cannot start to move: {moved.reason}",
                "check what holds or pushes it, and the drive of that joint; no waypoint was skipped: then go on "
                "with this session",
            )
    return moved


def visit(session: Session, index: int) -> bool:
    """Move to a waypoint; record it as skipped and return False if it cannot be reached."""
    require_in_box(session)
    moved = reach(session, waypoints_of(session)[index])
    if not moved.reached:
        session.record("waypoint_skipped", {"waypoint": index, "reason": moved.reason})
    return moved.reached


def explore(session: Session, listener: Listener, after_pose: Callable[[], None]) -> None:
    """Capture poses at the waypoints until there are enough; calls `after_pose` after each."""
    plan, wanted = waypoints_of(session), session.procedure.capture.poses
    while (taken := len(session.state.poses_here)) < wanted:
        waypoint = session.state.next_waypoint
        if waypoint >= len(plan):
            raise GuardError(
                f"only {taken} of {wanted} poses could be reached",
                "drive another pair of joints, widen the span, mount the hinge elsewhere, or "
                "calibrate from these poses",
            )
        listener.going(None)
        if visit(session, waypoint):
            listener.arrived(waypoint)
            try:
                session.capture(waypoint)
            except TargetLostError as lost:
                session.record("waypoint_skipped", {"waypoint": waypoint, "reason": lost.happened})
                listener.report(f"Skipped: {lost.happened}.")
                continue
            listener.pose_captured(
                session.state, session.state.wanted_poses(session.procedure.capture)
            )
            after_pose()
