"""Taking an arm from waypoint to waypoint: what cannot be reached is left the way it came, and passed over.

Knows no screen.
"""

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
"""A move that ends within a fifth of a second, this near to where it began, has not begun."""


def reach(
    session: Session, targets_rad: Mapping[int, float], *, speed_rad_per_s: float | None = None
) -> MoveResult:
    """Go there; what stops the arm lies ahead, so that it goes back the way it came."""
    before = session.arm.snapshot().positions_rad
    moved = session.go_to(targets_rad, speed_rad_per_s=speed_rad_per_s)
    if not moved.reached:
        back = session.go_to(
            {j: float(before[j - 1]) for j in targets_rad}, speed_rad_per_s=speed_rad_per_s
        )
        still = float(np.abs(back.positions_rad - before).max()) < STANDS_STILL_RAD
        loaded = overload(session.model, session.arm.snapshot())
        if loaded and still and not back.reached and moved.syncs <= STARTING_SYNCS:
            # Not this target's affair: no other could be reached either.
            raise GuardError(
                f"the arm cannot begin to move: {moved.reason}",
                "look at what holds or pushes it, and at that joint's drive; no waypoint was "
                "passed over: go on with this session then",
            )
    return moved


def visit(session: Session, index: int) -> bool:
    """Go to a waypoint; one that cannot be reached is passed over (False)."""
    require_in_box(session)
    moved = reach(session, waypoints_of(session)[index])
    if not moved.reached:
        session.record("waypoint_skipped", {"waypoint": index, "reason": moved.reason})
    return moved.reached


def explore(session: Session, listener: Listener, taken_one: Callable[[], None]) -> None:
    """Visit waypoints in turn until there are enough poses; `taken_one` is called after each."""
    plan, wanted = waypoints_of(session), session.procedure.capture.poses
    while (taken := len(session.state.poses_here)) < wanted:
        waypoint = session.state.next_waypoint
        if waypoint >= len(plan):
            raise GuardError(
                f"only {taken} of {wanted} poses could be reached",
                "drive another pair of joints, widen the span, mount the hinge elsewhere, or "
                "calibrate from what there is",
            )
        listener.going(None)
        if visit(session, waypoint):
            listener.arrived(waypoint)
            try:
                session.capture(waypoint)
            except TargetLostError as lost:
                session.record("waypoint_skipped", {"waypoint": waypoint, "reason": lost.happened})
                listener.told(f"Passed over: {lost.happened}.")
                continue
            listener.pose_captured(
                session.state, session.state.wanted_poses(session.procedure.capture)
            )
            taken_one()
