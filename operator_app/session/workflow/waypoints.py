"""Where the drive joints of a session go before there is a model to plan with: by procedure and journal alone.

Needs no arm.
"""

from __future__ import annotations

from collections.abc import Mapping

from operator_app.errors import GuardError
from operator_app.planning.exploration import Box, box_of, waypoints
from operator_app.session.store.logbook import Logbook
from solver.arrays import FloatArray


def drive_box(session: Logbook) -> Box:
    """Where the joints in position mode may be taken."""
    state = session.state
    if state.start_rad is None or state.home_rad is None or not state.position_joints:
        raise GuardError("the joint modes are not set", "set the modes first (step 3)")
    return box_of(
        session.model,
        session.procedure.capture,
        state.position_joints,
        home_rad=state.home_rad,
        start_rad=state.start_rad,
    )


def waypoints_of(session: Logbook) -> tuple[Mapping[int, float], ...]:
    """All waypoints of this session, visited ones included."""
    own = session.procedure.capture
    return waypoints(drive_box(session), poses=own.poses, seed=own.seed)


def waypoints_from(
    session: Logbook, start_rad: FloatArray, joints: tuple[int, ...]
) -> tuple[Mapping[int, float], ...]:
    """Waypoints of these drive joints in a session that would begin at `start_rad` (n,)."""
    own, model = session.procedure.capture, session.model
    box = box_of(model, own, joints, home_rad=model.home_rad, start_rad=start_rad)
    return waypoints(box, poses=own.poses, seed=own.seed)


def verification_waypoints(session: Logbook, poses: int) -> tuple[Mapping[int, float], ...]:
    """Waypoints elsewhere than those of the session, others for every verification."""
    seed = session.procedure.capture.seed + 1 + session.state.verifications
    return waypoints(drive_box(session), poses=poses, seed=seed)
