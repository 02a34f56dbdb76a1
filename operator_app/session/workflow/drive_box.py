"""The way to the box of the procedure from elsewhere: only when the operator agrees, slowly, and once.

Inside its box a drive goes anywhere by itself: that is what the procedure says of it. From outside,
the way leads through places nobody has spoken for. Knows no screen; asks nobody itself.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from operator_app.errors import GuardError
from operator_app.planning.exploration import Box, box_of, waypoints
from operator_app.session.store.logbook import Logbook
from operator_app.session.workflow.session import Session
from operator_app.units.figure import REACH
from solver.arrays import FloatArray
from solver.chain.sensors import Encoder

AT_THE_EDGE_RAD = float(np.deg2rad(5.0))
"""As near to its box as this the arm counts as in it: where it closes need not be where home was stated."""

NEAR_ZERO_RAD = float(np.deg2rad(0.25))
"""A counter that began anew, and what a joint gives when it is enabled."""

SLOWLY_RAD_PER_S = float(np.deg2rad(5.0))
"""A person beside the arm sees in time where it goes."""


def away_from_box(session: Session) -> str:
    """Say which drive joints stand outside their box; empty when none does."""
    box, here = drive_box(session), session.arm.snapshot().positions_rad
    beyond = box.beyond_rad(here)
    return ", ".join(
        f"joint {j} stands at {REACH(float(here[j - 1])).with_unit}, outside "
        f"{REACH(float(low)).shown} to {REACH(float(high)).with_unit}"
        for j, low, high, by in zip(box.joints, box.lower_rad, box.upper_rad, beyond, strict=True)
        if by > AT_THE_EDGE_RAD
    )


def require_counted(session: Session) -> None:
    """Refuse to move a drive joint whose counter stands at zero outside its box: it may have begun anew.

    No agreement helps: by such a reading it would be driven somewhere else than home.

    Raises
    ------
    GuardError
    """
    box, here = drive_box(session), session.arm.snapshot().positions_rad
    zeros = [
        j
        for j, by in zip(box.joints, box.beyond_rad(here), strict=True)
        if by > AT_THE_EDGE_RAD
        and abs(here[j - 1]) <= NEAR_ZERO_RAD
        and isinstance(session.model.joints[j - 1].sensor, Encoder)
    ]
    if zeros:
        joints = " and ".join(str(j) for j in zeros)
        raise GuardError(
            f"joint {joints} reads zero, where this procedure does not expect it: its counter may "
            "have begun anew, as after a loss of power, and what is driven by it goes astray",
            f"home joint {joints}; if it really stands at zero, bring it into its box by hand while its "
            "drives are off",
        )


def require_in_box(session: Session) -> None:
    """Refuse to move by itself an arm that stands where the procedure does not expect it."""
    away = away_from_box(session)
    if away:
        require_counted(session)
        raise GuardError(
            f"the arm is not where this procedure may move it: {away}",
            "bring it there by hand while its drives are off, or agree that it goes by itself, slowly "
            "and straight (--go-home; in the terminal app: Go home)",
        )


def go_home(session: Session) -> str:
    """Take the drive joints straight and slowly to their home, and say what was done.

    What ends the move ends it for good: the arm holds there, and nothing is tried a second time.
    """
    require_counted(session)
    box = drive_box(session)
    targets = dict(zip(box.joints, box.centre_rad.tolist(), strict=True))
    moved = session.go_to(targets, speed_rad_per_s=SLOWLY_RAD_PER_S)
    session.settle()
    q = session.arm.snapshot().positions_rad
    session.record(
        "went_home", {"joints": list(box.joints), "q_rad": q.tolist(), "stopped": moved.reason}
    )
    if not moved.reached:
        raise GuardError(
            f"the arm was stopped on its way home: {moved.reason}",
            "it holds where it is; look at what is in the way, and bring it home by hand while its "
            "drives are off",
        )
    return "Home: " + ", ".join(
        f"joint {j} at {REACH(float(q[j - 1])).with_unit}" for j in box.joints
    )


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
