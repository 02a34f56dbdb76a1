"""Selects the drive joints, captures poses within their box (the allowed ranges of their angles), moves the arm home.

Inside the box, the drives move without confirmation. An arm outside the box moves only after confirmation, and only
straight home, at low speed.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import asdict
from typing import Any

import numpy as np

from hardware.arm import MoveResult
from operator_app.errors import GuardError
from operator_app.planning.drives import (
    TRIED_SETS,
    DriveChoice,
    choose_drives,
    predict_drives,
    usable_sets,
)
from operator_app.planning.exploration import Box, box_of, overload, waypoints
from operator_app.session.store.logbook import Logbook
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.pose_reading import TargetLostError
from operator_app.session.workflow.session import Session
from operator_app.units import REACH, names
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.chain.sensors import Encoder
from solver.design.drive_joints import DriveTrial, RankedDrives

WIGGLE_RAD = float(np.deg2rad(1.5))
KEPT_CANDIDATES = 6
"""Number of best sets of drive joints that the journal records from each ranking."""


def drives_of(session: Session, listener: Listener | None = None) -> tuple[int, ...]:
    """Return the drive joints: those of the procedure, or those chosen earlier in the session, or a new choice."""
    named = session.procedure.position_joints
    if named is not None:
        return named
    if session.state.drives:
        return session.state.drives
    choice = choose(session)
    if listener is not None:
        listener.report(f"Drive joints: {names(choice.drives)} ({'; '.join(choice.reasons)}).")
    return choice.drives


def choose(session: Session, *, may_move: bool = True) -> DriveChoice:
    """Rank the sets of drive joints at the current pose and record the best usable one.

    If `may_move` is true and the procedure requires a trial, the choice is preceded by this trial: the drives are
    enabled, and the joints of each of the best sets are moved by 1.5 deg.
    """
    arm, model = session.model, session.fixture.model(session.model)
    q_rad = session.arm.snapshot().positions_rad
    prediction = predict_drives(
        arm, model, nominal_vector(model.parameters), q_rad, seed=session.procedure.capture.seed
    )
    unsensed = session.procedure.unsensed_joints
    trials: tuple[DriveTrial, ...] = ()
    if session.procedure.trial and may_move:
        best = usable_sets(prediction, unsensed)[:TRIED_SETS]
        trials = tuple(wiggle(session, ranked.drives) for ranked in best)
    choice = choose_drives(prediction, unsensed_joints=unsensed, trials=trials)
    session.record(
        "drives_chosen",
        {
            "drives": list(choice.drives),
            "sets": [list(drives) for drives in choice.sets],
            "reasons": list(choice.reasons),
            "here": [_facts(r) for r in prediction.here[:KEPT_CANDIDATES]],
            "region": [_facts(r) for r in prediction.region[:KEPT_CANDIDATES]],
            "trial": [_facts(r) for r in choice.trial],
        },
    )
    return choice


def wiggle(session: Session, drives: tuple[int, ...]) -> DriveTrial:
    """Move each drive joint by 1.5 deg to either side and back, and measure the motion of all joints."""
    session.set_modes(drives)
    start = session.reader.read().mean_rad
    commanded, displacements, stopped = [], [], ""
    for column, joint in enumerate(drives):
        for step in (WIGGLE_RAD, -WIGGLE_RAD):
            result = session.go_to({joint: float(start[joint - 1]) + step})
            stopped = stopped or ("" if result.reached else result.reason)
            if result.reached:
                command = np.zeros(len(drives))
                command[column] = step
                commanded.append(command)
                displacements.append(session.reader.read().mean_rad - start)
            session.go_to({joint: float(start[joint - 1])})
    measured = np.linalg.matrix_rank(np.array(commanded)) if commanded else 0
    if measured < len(drives):
        # Too few moves were completed: report no motion.
        commanded = list(WIGGLE_RAD * np.eye(len(drives)))
        displacements = [np.zeros(len(start))] * len(drives)
    return DriveTrial(
        drives=drives,
        commanded_rad=np.array(commanded),
        moved_rad=np.array(displacements),
        stopped=stopped,
    )


def _facts(ranked: RankedDrives) -> dict[str, Any]:
    return {key: value for key, value in asdict(ranked).items() if value is not None}


BOX_MARGIN_RAD = float(np.deg2rad(5.0))
"""Tolerance at the edge of the box, since the loop may close at a pose slightly different from the procedure's home."""

RESET_COUNTER_RAD = float(np.deg2rad(0.25))
"""Largest reading of a counter that was reset, including the motion of a joint when its drive is enabled."""

HOMING_SPEED_RAD_PER_S = float(np.deg2rad(5.0))
"""Speed of moves home, slow enough for a person beside the arm to react."""


def joints_outside_box(session: Session, q_rad: FloatArray) -> dict[int, str]:
    """Return text about each drive joint outside the procedure's box at readings `q_rad` (n,), by joint."""
    box = drive_box(session)
    beyond = box.beyond_rad(q_rad)
    return {
        j: f"joint {j} is at {REACH(float(q_rad[j - 1])).with_unit}, outside "
        f"{REACH(float(low)).shown} to {REACH(float(high)).with_unit}"
        for j, low, high, by in zip(box.joints, box.lower_rad, box.upper_rad, beyond, strict=True)
        if by > BOX_MARGIN_RAD
    }


def require_no_reset_counter(session: Session) -> None:
    """Raise GuardError if a drive joint outside its box reads zero: its counter may have been reset.

    The operator cannot override this: with a wrong reading, the move would not end at the home of the joint.
    """
    q_rad = session.arm.snapshot().positions_rad
    zeros = [
        j
        for j in joints_outside_box(session, q_rad)
        if abs(q_rad[j - 1]) <= RESET_COUNTER_RAD
        and isinstance(session.model.joints[j - 1].sensor, Encoder)
    ]
    if zeros:
        joints = " and ".join(str(j) for j in zeros)
        raise GuardError(
            f"joint {joints} reads zero, outside the box of this procedure: the counter may have been reset, as "
            "after a loss of power, and the arm would move to a wrong position",
            f"home joint {joints}; if it really is at zero, move it into its box by hand while its drives are off",
        )


def require_in_box(session: Session) -> None:
    """Raise GuardError if a drive joint is outside the box."""
    away = joints_outside_box(session, session.arm.snapshot().positions_rad)
    if away:
        require_no_reset_counter(session)
        raise GuardError(
            f"the arm is outside the box of this procedure: {', '.join(away.values())}",
            "move it there by hand while its drives are off, or let it go home by itself, straight and at 5 deg/s "
            "(--go-home; in the terminal app: Go home)",
        )


def go_home(session: Session) -> str:
    """Move the drive joints straight home at 5 deg/s; return a message. Raises GuardError if the move ends early."""
    require_no_reset_counter(session)
    box = drive_box(session)
    targets = dict(zip(box.joints, box.centre_rad, strict=True))
    outcome = session.go_to(targets, speed_rad_per_s=HOMING_SPEED_RAD_PER_S)
    session.reader.settle()
    q = session.arm.snapshot().positions_rad
    session.record(
        "went_home", {"joints": list(box.joints), "q_rad": q.tolist(), "stopped": outcome.reason}
    )
    if not outcome.reached:
        raise GuardError(
            f"the arm was stopped on its way home: {outcome.reason}",
            "the arm holds; clear the way, and move it home by hand while its drives are off",
        )
    return "Home: " + ", ".join(
        f"joint {j} at {REACH(float(q[j - 1])).with_unit}" for j in box.joints
    )


def drive_box(session: Logbook) -> Box:
    """Return the box of the joints in position mode; raises GuardError if the modes are not set."""
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
    """Return all waypoints of this session, visited or not."""
    own = session.procedure.capture
    return waypoints(drive_box(session), poses=own.poses, seed=own.seed)


def waypoints_from(
    session: Logbook, start_rad: FloatArray, joints: tuple[int, ...]
) -> tuple[Mapping[int, float], ...]:
    """Return the waypoints of a session that has the drive joints `joints` and starts at `start_rad` (n,)."""
    own, model = session.procedure.capture, session.model
    box = box_of(model, own, joints, home_rad=model.home_rad, start_rad=start_rad)
    return waypoints(box, poses=own.poses, seed=own.seed)


STARTING_SYNCS = 20
STANDS_STILL_RAD = float(np.deg2rad(0.2))
"""A move counts as not started if it ends within `STARTING_SYNCS` SYNCs and less than this angle from its start."""


def reach(
    session: Session, targets_rad: Mapping[int, float], *, speed_rad_per_s: float | None = None
) -> MoveResult:
    """Move to the angles `targets_rad`, by joint, and return the result; if the move ends early, go back to its start.

    Raises GuardError if the arm cannot start to move because a joint is overloaded.
    """
    before = session.arm.snapshot().positions_rad
    outcome = session.go_to(targets_rad, speed_rad_per_s=speed_rad_per_s)
    if not outcome.reached:
        back = session.go_to(
            {j: float(before[j - 1]) for j in targets_rad}, speed_rad_per_s=speed_rad_per_s
        )
        still = float(np.abs(back.positions_rad - before).max()) < STANDS_STILL_RAD
        loaded = overload(session.model, session.arm.snapshot())
        if loaded and still and not back.reached and outcome.syncs <= STARTING_SYNCS:
            raise GuardError(
                f"the arm cannot start to move: {outcome.reason}",
                "no waypoint was skipped. Check what blocks it, and the drive of that joint, then go on "
                "with this session",
            )
    return outcome


def retrace(session: Session, stops: Sequence[Mapping[int, float]]) -> None:
    """Move to all of `stops` (rad, by drive joint) in reverse order; raises GuardError if one is not reached."""
    for stop in reversed(stops):
        if session.state.position_joints != tuple(stop):
            session.set_modes(tuple(stop))
            session.reader.settle()
        outcome = session.go_to(stop)
        if not outcome.reached:
            raise GuardError(
                f"the arm does not reach its position before the drift check: {outcome.reason}",
                "clear the way, then go on with this session",
            )


def visit(session: Session, index: int) -> bool:
    """Move to the waypoint `index`; return whether it was reached. A waypoint not reached is recorded as skipped."""
    require_in_box(session)
    outcome = reach(session, waypoints_of(session)[index])
    if not outcome.reached:
        session.record("waypoint_skipped", {"waypoint": index, "reason": outcome.reason})
    return outcome.reached


def explore(session: Session, listener: Listener, after_pose: Callable[[], None]) -> None:
    """Capture missing poses, and call `after_pose` after each. Raises GuardError if too few waypoints are reachable."""
    plan, total = waypoints_of(session), session.procedure.capture.poses
    while (count := len(session.state.poses_here)) < total:
        waypoint = session.state.next_waypoint
        if waypoint >= len(plan):
            reasons = list(filter(None, session.state.skipped_waypoints.values()))
            last = (
                f"; the last skipped waypoint was skipped because {reasons[-1]}" if reasons else ""
            )
            raise GuardError(
                f"only {count} of {total} poses could be reached{last}",
                "drive another pair of joints, widen the exploration ranges, mount the hinge elsewhere, or "
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
                session.state, session.state.required_poses(session.procedure.capture)
            )
            after_pose()
