"""Workflow of a session for all user interfaces: connect, capture the missing poses, verify.

The operator may cancel at any time and resume later.
"""

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass

import numpy as np

from hardware.arm import ArmIdentity
from hardware.canopen.objects import EmergencyCode
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import is_unpredicted
from operator_app.calibration.result import Solution
from operator_app.calibration.verification import VerificationResult, verify_poses
from operator_app.errors import GuardError
from operator_app.messages.errors import configured_words, connected_words, unwatching_words
from operator_app.planning.exploration import waypoints
from operator_app.planning.live import is_path_clear
from operator_app.session.safety.resume_checks import SHIFT_RAD
from operator_app.session.safety.return_check import agreement, check_repeat
from operator_app.session.store.state import CapturedPose, pose_set_of
from operator_app.session.workflow import drive_selection
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.planned_capture import PlannedCapture
from operator_app.session.workflow.pose_reading import TargetLostError
from operator_app.session.workflow.session import Session
from operator_app.units import REACH, SPAN, joints_named, others_free
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor
from solver.design.actions import Finished
from solver.loops.placements import Placements

CANDIDATES_PER_POSE = 4
"""Factor by which more targets are generated if only targets with a clear straight path can be used."""


def connect(session: Session, listener: Listener, *, measuring: bool = True) -> ArmIdentity:
    """Connect to the arm, and return its identity; `measuring`: whether to open the instrument of an open arm first.

    Drives that tripped on a lost operator heartbeat are reset if there is no other fault. They stay disabled.
    """
    session.instruct = listener.report
    identity = session.connect(measuring=measuring)
    for words in (connected_words, configured_words, unwatching_words):
        if text := words(identity):
            listener.report(f"{text}.")
    faults = session.arm.snapshot().faults
    # With any other fault nothing is reset, since the cause of that fault may be in the arm.
    if faults and all(f.code == EmergencyCode.HEARTBEAT_LOST for f in faults):
        session.reset_stop()
        joints = sorted({f.joint for f in faults if f.joint is not None})
        session.record("reset", {"joints": joints, "code": int(EmergencyCode.HEARTBEAT_LOST)})
        listener.report(
            "The drives had tripped on a lost operator heartbeat (8130h), as after a killed program, and were reset. "
            "Nothing has moved."
        )
    return identity


def take_poses(
    session: Session,
    listener: Listener,
    drives: tuple[int, ...] | None = None,
    *,
    homing: bool = False,
) -> Finished | None:
    """Capture the missing poses of the procedure, continuing where the journal ends.

    `drives`: joints to put into position mode, by default those in this mode now. A plan in progress keeps its drives.
    `homing`: whether the operator has agreed that an arm outside its box first goes home. Returns how a planned capture
    ended; None for an explored capture. Raises Cancelled if the operator ended the capture.
    """
    joints = session.state.position_joints if drives is None else drives
    planned = end = None
    if session.procedure.capture.strategy == "planned":
        planned = PlannedCapture(session, joints, listener)
        joints = planned.ready()
    if drives is not None or joints != session.state.position_joints:
        session.set_modes(joints)
        driven = joints_named(joints).capitalize()
        others = others_free(len(joints), session.model.joint_count)
        listener.report(f"{driven} in position mode{others}; read back from the drives.")
    if homing and (planned is None or not planned.continues_in_place):
        go_home_if_outside(session, listener)
    drift_check = _DriftCheck(session, listener, planned)
    # Once all poses are captured, shifts no longer affect the calibration; then only a sensor fault requires a drift
    # check before anything else.
    captured = len(session.state.poses_here)
    missing = (
        captured < session.procedure.capture.poses if planned is None else not planned.complete
    )
    due = missing or bool(session.state.sensor_jump)
    if session.state.resumed and session.state.poses_here and due:
        if planned is None:
            drift_check.repeat_nearest_pose_if_unresolved()
        if session.state.resumed:  # no pose has been repeated yet
            drift_check.repeat_first_pose_and_come_back()
    elif missing and session.state.here.repeated_since_capture:
        try:
            check_repeat(session.state, session.procedure, refuse=True)
        except GuardError:
            drift_check.repeat_first_pose_and_come_back(suspect=True)
            # If the first pose could not be measured again now, the earlier repeat decides.
            check_repeat(session.state, session.procedure, refuse=True)
    if planned is None:
        if not session.state.repeated_since_capture:
            # The last pose may have been captured by hand, without this check.
            drift_check.check_last_pose()
        drive_selection.explore(session, listener, drift_check.check_last_pose)
    else:
        end = planned.run(drift_check.check_last_pose)
    if session.state.poses_here and not session.state.repeated_since_capture:
        drift_check.repeat_first_pose()
    return end


def go_home_if_outside(session: Session, listener: Listener) -> None:
    """Go home if a drive joint is outside its box; call it only if the operator has agreed."""
    away = drive_selection.joints_outside_box(session, session.arm.snapshot().positions_rad)
    if away:
        listener.report(f"Going home at 5 deg/s: {', '.join(away.values())}.")
        listener.going(None)
        listener.report(f"{drive_selection.go_home(session)}.")


def outlier_warning(session: Session) -> str:
    """Return a warning if the last pose does not fit the earlier poses; "" if it fits or no more poses are required."""
    state, unsensed = session.state, session.procedure.unsensed_joints
    if len(state.used_poses) >= state.required_poses(session.procedure.capture):
        return ""
    poses = state.here.pose_set()
    if not is_unpredicted(
        Experiment(arm=session.model, fixture=session.fixture, poses=poses, unsensed=unsensed)
    ):
        return ""
    return (
        f"Pose {state.poses_here[-1].number} does not fit the poses before it: a joint or the fixture may have "
        "shifted."
    )


SAME_PLACE_RAD = float(np.deg2rad(0.2))
"""Two poses are at one place if every joint differs by less than this: over three times the noise of a mean reading."""


def place_warning(session: Session) -> str:
    """Return a warning if a joint of the last pose is out of its range, or the pose equals an earlier one; else ""."""
    *earlier, last = session.state.poses_here
    for j, (joint, q) in enumerate(
        zip(session.model.joints, last.mean_rad.tolist(), strict=True), 1
    ):
        unread = isinstance(joint.sensor, NoSensor) or j in session.procedure.unsensed_joints
        if not (unread or joint.lower_rad <= q <= joint.upper_rad):
            return (
                f"Pose {last.number}: joint {j} reads {REACH(q).with_unit}, outside its range "
                f"{SPAN(joint.lower_rad).shown} .. {SPAN(joint.upper_rad).with_unit}. Undo the pose, and check the "
                "counter and the range of that joint."
            )
    for pose in earlier:
        if np.abs(pose.mean_rad - last.mean_rad).max() < SAME_PLACE_RAD:
            return (
                f"Pose {last.number} is at the place of pose {pose.number} and determines nothing new. Undo it, and "
                "move the arm before the next capture."
            )
    return ""


@dataclass(frozen=True, slots=True)
class _DriftCheck:
    """Measures captured poses again to detect shifts of joints and fixture.

    `planned`: the planned capture, whose paths the drives follow. None in an explored capture, in which the drives move
    straight, within their box.

    Methods that move the arm raise GuardError if the repeated pose shows a shift (see `_repeat`) or, in an explored
    capture, if the arm is outside its box.
    """

    session: Session
    listener: Listener
    planned: PlannedCapture | None

    def repeat_nearest_pose_if_unresolved(self) -> None:
        """Repeat the nearest captured pose, at 5 deg/s, if a joint's shift cannot be detected at the current pose."""
        session = self.session
        if not session.unresolved_joints or not session.fixture.holds_hand:
            return
        drive_selection.require_in_box(session)
        q_rad, drives = session.arm.snapshot().positions_rad, session.state.position_joints

        def away_rad(pose: CapturedPose) -> float:
            return max(abs(float(pose.mean_rad[j - 1] - q_rad[j - 1])) for j in drives)

        nearest = min(session.state.poses_here, key=away_rad)
        joints = " or ".join(map(str, session.unresolved_joints))
        self.listener.report(
            f"Moving {REACH(away_rad(nearest)).with_unit} to pose {nearest.number} at 5 deg/s first: at the present "
            f"pose a shift of joint {joints} by {REACH(SHIFT_RAD).with_unit} would not show."
        )
        self._repeat(nearest, speed_rad_per_s=drive_selection.HOMING_SPEED_RAD_PER_S)

    def check_last_pose(self) -> None:
        """If the last pose does not fit the earlier poses, repeat the first pose immediately."""
        suspect, state = outlier_warning(self.session), self.session.state
        if not suspect:
            return
        self.listener.report(suspect)
        number, before = state.poses_here[-1].number, len(state.repeats)
        self.repeat_first_pose_and_come_back(suspect=True)
        if len(self.session.state.repeats) > before:
            self.listener.report(
                f"Pose {state.poses_here[0].number} is unchanged; the calibration decides whether pose {number} is "
                "an outlier."
            )

    def repeat_first_pose_and_come_back(self, *, suspect: bool = False) -> None:
        """Repeat the first pose, then move the arm back to its present position.

        `suspect`: whether the last pose may be an outlier; if so, a shift of the first pose raises GuardError.
        """
        drive_selection.retrace(self.session, self.repeat_first_pose(suspect=suspect))

    def repeat_first_pose(self, *, suspect: bool = False) -> Sequence[Mapping[int, float]]:
        """Repeat the first used pose; return the drives' angles (rad) at the start of each move, for `retrace`."""
        if self.planned is None:
            drive_selection.require_in_box(self.session)
        first = self.session.state.poses_here[0]
        self.listener.report(f"Re-measuring pose {first.number} (drift check).")
        return self._repeat(first, suspect=suspect)

    def _repeat(
        self, pose: CapturedPose, *, suspect: bool = False, speed_rad_per_s: float | None = None
    ) -> Sequence[Mapping[int, float]]:
        """Measure a captured pose again and compare the two readings; if the pose cannot be measured, record why.

        Returns the drives' angles (rad) at the start of each move, for `retrace`. A shift is reported. If the session
        was resumed, or `suspect` is true because the last pose may be an outlier, a shift raises GuardError instead.
        """
        session, report = self.session, self.listener.report
        self.listener.going(None)
        if self.planned is None:
            q_rad, drives = session.arm.snapshot().positions_rad, session.state.position_joints
            way: Sequence[Mapping[int, float]] = [{j: float(q_rad[j - 1]) for j in drives}]
            targets = {j: float(pose.mean_rad[j - 1]) for j in drives}
            missed = drive_selection.reach(session, targets, speed_rad_per_s=speed_rad_per_s).reason
        else:
            missed, way = self.planned.to_first()
        resumed = session.state.resumed
        if not missed:
            try:
                session.take_check_reading("return", of=pose.number)
            except TargetLostError as lost:
                missed = lost.happened
        if missed:
            session.record("return_missed", {"of": pose.number, "reason": missed})
            report(f"Pose {pose.number} could not be measured again: {missed}.")
            return way
        refuse = resumed or suspect
        text = check_repeat(session.state, session.procedure, refuse=refuse)
        if refuse:
            session.record("return_holds", {"of": pose.number, "told": text})
        report(text or agreement(session.state, session.procedure))
        return way


def verify(
    session: Session, solution: Solution, poses: int, listener: Listener
) -> tuple[VerificationResult, PoseSet]:
    """Test a calibration with new poses, different from the session's; the calibration does not change.

    The joint modes must have been set. The result and the new poses are recorded in the journal.
    Raises `GuardError` if fewer than `poses` new poses can be reached.
    """
    if not session.state.poses_here:
        raise GuardError(
            f"the fixture was remounted: the calibration has no pose of placement {session.state.placement}",
            "go on with the session (sarcal run --resume), then verify",
        )
    drive_selection.require_in_box(session)
    before = len(session.state.readings)
    for target in _new_targets(session, solution, poses):
        listener.going(None)
        if drive_selection.reach(session, target).reached:
            try:
                session.take_check_reading("verification")
            except TargetLostError as lost:
                listener.report(f"Skipped: {lost.happened}.")
        if len(session.state.readings) == before + poses:
            break
    else:
        raise GuardError(
            f"only {len(session.state.readings) - before} of {poses} new poses could be reached",
            "request fewer, or drive another pair of joints",
        )
    new_poses = pose_set_of(session.state.readings[before:])
    made_from = session.state.pose_set()
    verdict = verify_poses(session.model, session.fixture, new_poses, solution, made_from)
    tested = verdict.verification
    turned = tested.sigmas.orientation_rad
    record = {
        "poses": verdict.poses,
        "readings": [int(label) for label in new_poses.label],
        "position_m": tested.sigmas.position_m.rms,
        "orientation_rad": None if turned is None else turned.rms,
        "chi2_per_dof": tested.chi2.per_dof,
        "holds": verdict.holds,
        "why": verdict.why,
    }
    session.record("verified", record)
    return verdict, new_poses


def _new_targets(session: Session, solution: Solution, poses: int) -> Iterator[Mapping[int, float]]:
    """Yield targets (rad, by drive joint) for new poses, different from the session's poses.

    If the procedure gives exploration ranges for all drive joints, yields all targets. Otherwise yields only targets to
    which the straight path is clear, according to the calibrated loop.
    """
    known = {box.joint for box in session.procedure.capture.exploration}
    model, x = solution.model, solution.estimate.x
    if isinstance(model, Placements):
        model, columns = model.of(session.state.placement)
        x = x[columns]
    clear = known >= set(session.state.position_joints)
    candidates = poses if clear else CANDIDATES_PER_POSE * poses
    # Neither the session nor an earlier verification has used this seed.
    seed = session.procedure.capture.seed + 1 + session.state.verifications
    for target in waypoints(drive_selection.drive_box(session), poses=candidates, seed=seed):
        q_rad = session.arm.snapshot().positions_rad
        if clear or is_path_clear(session.model, model, x, q_rad, target):
            yield target
