"""What is done with a session, whichever face asks: the one capture loop, the one verification.

Everything here may be ended by the operator between two deeds and gone on with. Prints nothing.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import replace

import numpy as np

from hardware.arm import ArmIdentity
from hardware.canopen.objects import EmergencyCode
from operator_app.calibration.innovation import is_unpredicted
from operator_app.calibration.instrument_registration import with_calibrated_places
from operator_app.calibration.prediction import MadeFrom
from operator_app.calibration.result import Solution
from operator_app.calibration.verification import (
    VerificationResult,
    fixed_calibration,
    verify_poses,
)
from operator_app.errors import GuardError
from operator_app.messages.errors import configured_words, unwatching_words
from operator_app.planning.forecast import is_clear
from operator_app.session.safety.resume_checks import SHIFT_RAD
from operator_app.session.safety.return_check import check_return, return_words
from operator_app.session.store.state import CapturedPose, SessionState, pose_set_of
from operator_app.session.workflow.drive_box import (
    SLOWLY_RAD_PER_S,
    away_from_box,
    go_home,
    require_in_box,
    verification_waypoints,
)
from operator_app.session.workflow.exploration import explore, reach
from operator_app.session.workflow.instrument import TargetLostError
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.planned_capture import CampaignEnd, PlannedCapture, Stop
from operator_app.session.workflow.session import Session
from operator_app.units.figure import REACH
from solver.chain.poses import PoseSet
from solver.loops.placements import Placements

MANY_PLACES = 4
"""Times as many places are looked at as where every way is known to be clear."""


def connect(session: Session, listener: Listener) -> ArmIdentity:
    """Find the arm; what an operator who was killed or frozen left behind is cleared and said."""
    session.told = listener.told
    identity = session.connect()
    listener.connected(identity)
    if words := configured_words(identity):
        listener.told(f"{words}.")
    if words := unwatching_words(identity):
        listener.told(f"{words}.")
    if _clear_lost_heartbeat(session):
        listener.told(
            "The drives had tripped because an operator's heartbeat was lost (8130h), as after a "
            "program was killed or frozen: reset. Nothing has moved."
        )
    return identity


def _clear_lost_heartbeat(session: Session) -> bool:
    """Reset drives that tripped for nothing but the loss of an operator's heartbeat; whether any had.

    Such a trip says that a program ended or froze, not that the arm met anything. The drives stay
    disabled. With any other trip among them, nothing is reset.
    """
    faults = session.arm.snapshot().faults
    if not faults or any(f.code != EmergencyCode.HEARTBEAT_LOST for f in faults):
        return False
    session.reset_stop()
    joints = sorted({f.joint for f in faults if f.joint is not None})
    session.record("reset", {"joints": joints, "code": int(EmergencyCode.HEARTBEAT_LOST)})
    return bool(joints)


def take_poses(
    session: Session,
    listener: Listener,
    drives: tuple[int, ...] | None = None,
    *,
    homing: bool = False,
) -> CampaignEnd | None:
    """Take the poses that are still wanted, as the procedure says; goes on where the journal ends.

    Parameters
    ----------
    drives
        Joints to put into position mode first; None leaves the modes as they are, but for a plan
        under way that drives others.
    homing
        The operator agrees that an arm outside its box goes home by itself.

    Returns
    -------
    How a planned capture ended; None for an explored one.

    Raises
    ------
    Cancelled
        The operator ended it.
    """
    wanted = session.position_joints if drives is None else drives
    planned = None
    if session.procedure.capture.strategy == "planned":
        planned = PlannedCapture(session, wanted, listener)
        wanted = planned.ready()
    if drives is not None or wanted != session.position_joints:
        session.set_modes(wanted)
        listener.modes_set(wanted)
    if homing and (planned is None or not planned.goes_on_from_here):
        home_if_away(session, listener)
    if session.state.resumed and session.state.poses_here and _is_going_on(session, planned):
        if planned is None:
            _show_unseen(session, listener)
        if session.state.resumed:  # no old pose was read again yet
            _there_and_back(session, listener, planned)
    end = None
    if planned is None:
        if not _has_returned(session.state):
            # Of a pose taken by hand it was said, and nothing moved for it.
            _doubt_the_last(session, listener, None)
        explore(session, listener, lambda: _doubt_the_last(session, listener, None))
    else:
        end = planned.run(lambda: _doubt_the_last(session, listener, planned))
    if session.state.poses_here and not _has_returned(session.state):
        _return_to_first(session, listener, planned)
    return end


def home_if_away(session: Session, listener: Listener) -> None:
    """Go home, which the operator has agreed to, where it takes that."""
    away = away_from_box(session)
    if away:
        listener.told(f"Going home, slowly: {away}.")
        listener.going(None)
        listener.told(f"{go_home(session)}.")


def _show_unseen(session: Session, listener: Listener) -> None:
    """Read the nearest pose again, going there slowly, if a joint's shift may not show where the arm stands.

    Raises
    ------
    GuardError
        The arm stands outside its box, or something has shifted.
    """
    if not session.unseen or not session.fixture.holds_hand:
        return
    require_in_box(session)
    here, drives = session.arm.snapshot().positions_rad, session.position_joints

    def away_rad(pose: CapturedPose) -> float:
        return max(abs(float(pose.mean_rad[j - 1] - here[j - 1])) for j in drives)

    nearest = min(session.state.poses_here, key=away_rad)
    joints = " or ".join(map(str, session.unseen))
    listener.told(
        f"Going {REACH(away_rad(nearest)).with_unit} to pose {nearest.number}, slowly, before anything else: where the "
        f"arm stands, joint {joints} may have shifted by {REACH(SHIFT_RAD).with_unit} and not show it."
    )
    _read_once_more(session, listener, nearest, None, speed_rad_per_s=SLOWLY_RAD_PER_S)


def _is_going_on(session: Session, planned: PlannedCapture | None) -> bool:
    """Whether poses are still to come: what slips after the last one has no part in a calibration."""
    if planned is not None:
        return not planned.complete
    return len(session.state.poses_here) < session.procedure.capture.poses


def _has_returned(state: SessionState) -> bool:
    """Whether an old pose was read once more since the last one was captured."""
    return any(r.again.after == state.captured for r in state.returns)


def doubt(session: Session) -> str:
    """Say that the last pose is not where those before it have it; "" where it is, or no more are wanted.

    What slips after the last one has no part in a calibration.
    """
    state, unsensed = session.state, session.procedure.unsensed_joints
    if len(state.used_poses) >= state.wanted_poses(session.procedure.capture):
        return ""
    poses = state.here.pose_set()
    if not is_unpredicted(session.model, session.fixture, poses, unsensed_joints=unsensed):
        return ""
    return (
        f"Pose {state.poses_here[-1].number} is not where the poses before it have it: something may have slipped "
        "on the way there."
    )


def _doubt_the_last(session: Session, listener: Listener, planned: PlannedCapture | None) -> None:
    """Read the first pose again at once where the last one is not where those before it have it.

    What slipped is told then, and not when all poses are taken; a pose that is odd by itself costs the way.

    Raises
    ------
    GuardError
        Something slipped: named with its size.
    """
    doubted, state = doubt(session), session.state
    if not doubted:
        return
    listener.told(doubted)
    number, before = state.poses_here[-1].number, len(state.returns)
    _there_and_back(session, listener, planned, doubted=True)
    if len(session.state.returns) > before:
        listener.told(
            f"Nothing slipped that pose {state.poses_here[0].number} tells of: the calibration judges pose {number}."
        )


def _return_to_first(
    session: Session, listener: Listener, planned: PlannedCapture | None, *, doubted: bool = False
) -> tuple[Stop, ...]:
    """Read the first pose that counts once more: what slipped since shows in it, whatever the model.

    An explored session's poses lie in a box that the drives cross straight; a planned one's may have a
    fold between them, so that its plan has to know the way. From outside the box, where somebody moved the
    arm meanwhile, nobody has spoken for the way: that takes an agreement. A pose that cannot be reached is
    said and recorded; the capture goes on without.

    Returns
    -------
    The way a planned session came.

    Raises
    ------
    GuardError
        An explored session's arm stands outside its box, or pose and reading tell that something slipped.
    """
    if planned is None:
        require_in_box(session)
    first = session.state.poses_here[0]
    listener.told(f"Back to pose {first.number}: to read it once more shows what slipped since.")
    return _read_once_more(session, listener, first, planned, doubted=doubted)


def _read_once_more(
    session: Session,
    listener: Listener,
    first: CapturedPose,
    planned: PlannedCapture | None,
    *,
    doubted: bool = False,
    speed_rad_per_s: float | None = None,
) -> tuple[Stop, ...]:
    """Go to a pose, which is the first one where there is a plan, read it again and judge the difference."""
    listener.going(None)
    way: tuple[Stop, ...] = ()
    if planned is None:
        targets = {j: float(first.mean_rad[j - 1]) for j in session.position_joints}
        missed = reach(session, targets, speed_rad_per_s=speed_rad_per_s).reason
    else:
        missed, way = planned.to_first()
    if missed:
        session.record("return_missed", {"of": first.number, "reason": missed})
        listener.told(f"Pose {first.number} could not be read once more: {missed}.")
    else:
        resumed = session.state.resumed
        try:
            session.look_again("return", of=first.number)
        except TargetLostError as lost:
            session.record("return_missed", {"of": first.number, "reason": lost.happened})
            listener.told(f"Pose {first.number} could not be read once more: {lost.happened}.")
            return way
        if resumed or doubted:
            told = _require_same_return(session)
        else:
            told = return_words(session.state, session.procedure)
        if told:
            listener.told(told)
    return way


def _require_same_return(session: Session) -> str:
    """Refuse to go on when the pose that was read again does not read as it did; what else it says."""
    told = check_return(session.state, session.procedure)
    session.record("return_holds", {"of": session.state.returns[-1].first.number, "told": told})
    return told


def _there_and_back(
    session: Session, listener: Listener, planned: PlannedCapture | None, *, doubted: bool = False
) -> None:
    """Read the first pose once more and come back: a plan under way goes on from where the arm was."""
    before = session.arm.snapshot().positions_rad
    way = _return_to_first(session, listener, planned, doubted=doubted)
    if planned is not None:
        planned.retrace(way)
        return
    listener.going(None)
    back = session.go_to({j: float(before[j - 1]) for j in session.position_joints})
    if not back.reached:
        raise GuardError(
            f"the arm does not come back to where it was before: {back.reason}",
            "look at what is in the way, then go on with this session",
        )


def verify(
    session: Session, solution: Solution, poses: int, listener: Listener
) -> tuple[VerificationResult, PoseSet]:
    """Take new poses, elsewhere than the session did, and judge them by a calibration as it is.

    The modes are set. Readings and verdict are in the journal; the poses are no part of the
    calibration.
    """
    if not session.state.poses_here:
        raise GuardError(
            f"the fixture was mounted anew since: of placement {session.state.placement} no pose was calibrated",
            "go on with the session (sarcal run --resume), then verify",
        )
    require_in_box(session)
    before = len(session.state.readings)
    for target in _new_places(session, solution, poses):
        listener.going(None)
        if reach(session, target).reached:
            try:
                session.look_again("verification")
            except TargetLostError as lost:
                listener.told(f"Passed over: {lost.happened}.")
        if len(session.state.readings) == before + poses:
            break
    else:
        raise GuardError(
            f"only {len(session.state.readings) - before} of {poses} new poses could be reached",
            "ask for fewer, or drive another pair of joints",
        )
    taken = pose_set_of(session.state.readings[before:])
    taken = replace(taken, placement=np.full(len(taken), session.state.placement))
    fixture = with_calibrated_places(session.fixture, solution.model)
    here = fixed_calibration(solution, session.state.placement)
    made = MadeFrom(solution=solution, poses=session.state.pose_set())
    verdict = verify_poses(session.model, fixture, taken, here, made=made)
    session.record("verified", _summary(verdict, taken))
    return verdict, taken


def _new_places(session: Session, solution: Solution, poses: int) -> Iterator[Mapping[int, float]]:
    """Where to take new poses, elsewhere than the session did.

    Drives of which the procedure does not say where they may go are taken only where the calibrated loop
    leaves the way clear, of many places more.
    """
    known = {box.joint for box in session.procedure.capture.exploration}
    model, x = solution.model, solution.estimate.x
    if isinstance(model, Placements):
        model, columns = model.of(session.state.placement)
        x = x[columns]
    if known >= set(session.position_joints):
        yield from verification_waypoints(session, poses)
        return
    for target in verification_waypoints(session, MANY_PLACES * poses):
        here = session.arm.snapshot().positions_rad
        if is_clear(session.model, model, x, here, target):
            yield target


def _summary(verdict: VerificationResult, taken: PoseSet) -> Mapping[str, object]:
    found = verdict.verification
    turned = found.sigmas.orientation_rad
    return {
        "poses": verdict.poses,
        "readings": [int(label) for label in taken.label],
        "position_m": found.sigmas.position_m.rms,
        "orientation_rad": None if turned is None else turned.rms,
        "chi2_per_dof": found.chi2.per_dof,
        "holds": verdict.holds,
        "why": verdict.why,
    }
