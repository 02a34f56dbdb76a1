"""What has to hold before a step opens or an action starts: pure functions that say what is missing.

Each takes a snapshot and returns sentences, none when nothing is missing. Both faces ask them; the
workflow checks again what could do harm.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping

from fixtures.base import Severity
from hardware.arm import DriveState, JointMode
from operator_app.config.procedure import MOST_PLACEMENTS
from operator_app.messages.errors import drive_words
from operator_app.planning import mode_rule
from operator_app.session.ui.snapshot import STALE_S, DataState, SessionSnapshot, TaskKind, Work
from operator_app.session.ui.steps import Step
from operator_app.units.figure import DATA_AGE, SILENCE
from solver.loops.closure import poses_needed

Missing = tuple[str, ...]

UNSEEN = "what slipped while the session was interrupted is not known"


def missing_for(step: Step, s: SessionSnapshot) -> Missing:
    """Sentences saying what keeps a step closed."""
    return () if step is Step.CONNECT else _STEPS[step](s)


def first_closed(s: SessionSnapshot) -> Step | None:
    """First step that is not open."""
    return next((step for step in Step if missing_for(step, s)), None)


def fixture_ready(s: SessionSnapshot) -> Missing:
    """Fixture needs an arm that was checked, and the hardware stop tested on a real one."""
    if not s.connected:
        return ("no arm is connected: connect first (step 1)",)
    if not s.simulated and not s.stop_tested:
        return ("the hardware stop is not tested: press it, see the drives drop out, confirm",)
    return ()


def modes_ready(s: SessionSnapshot) -> Missing:
    """Modes need a placement that no check refuses and a check list that is ticked."""
    before = fixture_ready(s)
    if before:
        return before
    if not s.checks:
        return ("the fixture has not been checked (step 2)",)
    refused = tuple(f"{c.text}: {c.remedy}" for c in s.checks if c.severity is Severity.REFUSED)
    left = len(s.procedure.fixture.checklist) - len(s.ticked)
    if left:
        refused += (f"{left} item{'s' if left > 1 else ''} of the check list not ticked (step 2)",)
    return refused


def capture_ready(s: SessionSnapshot) -> Missing:
    """Capture needs drives that are enabled in the modes that were confirmed."""
    before = modes_ready(s)
    if before:
        return before
    if s.stopped:
        return ("STOP is latched: reset it (R), then apply the modes again (step 3)",)
    if not s.modes:
        return ("the joint modes are not set: apply them (step 3)",)
    if all(m is JointMode.POSITION for m in s.modes) and s.mobility < len(s.modes):
        return ("all joints are held: apply the modes again (step 3)",)
    if not s.drives_ready:
        return (f"{_not_ready(s)}: apply the modes again (step 3)",)
    return modes_problem(s, tuple(k for k, m in enumerate(s.modes, 1) if m is JointMode.POSITION))


def calibrate_ready(s: SessionSnapshot) -> Missing:
    """Calibrate needs enough poses to leave a degree of freedom."""
    used, needed = len(s.state.used_poses), poses_for(s)
    if used < needed:
        return (f"{used} of at least {needed} poses captured (step 4)",)
    return ()


def results_ready(s: SessionSnapshot) -> Missing:
    """Results need a calibration of the poses as they are."""
    if s.solution is None:
        return ("there is no calibration of these poses yet (step 5)",)
    return ()


def export_ready(s: SessionSnapshot) -> Missing:
    """Export needs a calibration that was accepted."""
    before = results_ready(s)
    if before:
        return before
    if s.solution is not None and not s.solution.accepted:
        return tuple(f"not accepted: {reason}" for reason in s.solution.reasons)
    return ()


_STEPS: Mapping[Step, Callable[[SessionSnapshot], Missing]] = {
    Step.FIXTURE: fixture_ready,
    Step.MODES: modes_ready,
    Step.CAPTURE: capture_ready,
    Step.CALIBRATE: calibrate_ready,
    Step.RESULTS: results_ready,
    Step.EXPORT: export_ready,
}


def poses_for(s: SessionSnapshot) -> int:
    """Fewest poses that can be solved as the next calibration is set up."""
    model = s.procedure.fixture.fixture.model(s.procedure.arm, unsensed_joints=s.unsensed_joints)
    return poses_needed(len(model.parameters), model.equations_per_pose)


# -- actions ---------------------------------------------------------------------------------------


def idle(s: SessionSnapshot) -> Missing:
    """One thing at a time."""
    return () if s.task is None else (f"wait: {s.task.text}",)


def may_connect(s: SessionSnapshot) -> Missing:
    """Connect once; again when the data are lost, or an alarm stands that this may resolve."""
    asked = any(TaskKind.CONNECT in alarm.until for alarm in s.alarms)
    if s.connected and s.data is not DataState.LOST and not asked:
        return ("the arm is connected already",)
    return idle(s)


def may_use_data(s: SessionSnapshot) -> Missing:
    """Readings must be fresh and nothing may be latched."""
    if not s.connected:
        return ("no arm is connected: connect first (step 1)",)
    if s.stopped:
        return ("STOP is latched: reset it first (R)",)
    if s.data is DataState.LOST:
        return (
            f"no data for {SILENCE(s.oldest_s).with_unit}: look at bus and controller, then connect again (step 1, c)",
        )
    if s.data is DataState.STALE:
        joints = ", ".join(f"J{j}" for j in s.stale_joints)
        ours = s.arm is not None and s.oldest_s - s.arm.late_s <= STALE_S
        why = " as this computer is late" if ours else ""
        return (
            f"the data of {joints} are {DATA_AGE(s.oldest_s).with_unit} old{why}: wait for fresh ones",
        )
    return ()


def may_check_fixture(s: SessionSnapshot) -> Missing:
    """Judging the placement needs to see where the arm stands."""
    return idle(s) or may_use_data(s)


def may_tick_all(s: SessionSnapshot) -> Missing:
    """On a real arm somebody looks at each item."""
    return () if s.simulated else ("on a real arm each item is looked at and ticked by itself",)


def may_suggest(s: SessionSnapshot) -> Missing:
    """The best pair is known when the arm has been seen."""
    return () if s.ranked else ("no ranking yet: connect first (step 1)",)


def may_apply_modes(s: SessionSnapshot) -> Missing:
    """Exactly as many joints in position mode as the chain has freedoms."""
    return idle(s) or modes_ready(s) or may_use_data(s) or modes_problem(s, s.wanted_joints)


def modes_problem(s: SessionSnapshot, position_joints: tuple[int, ...]) -> Missing:
    """Too few or too many joints in position mode, with the reason."""
    problem = mode_rule.modes_problem(
        position_joints,
        joint_count=s.procedure.arm.joint_count,
        mobility=s.mobility,
        kind=s.procedure.fixture.kind,
    )
    return () if problem is None else (f"{problem.happened}: {problem.remedy}",)


def may_move(s: SessionSnapshot) -> Missing:
    """Moving needs the Capture step open, fresh data and a waypoint that is left."""
    missing = idle(s) or capture_ready(s) or may_use_data(s)
    if missing:
        return missing
    if s.next_waypoint is None:
        return ("every waypoint of the plan was visited",)
    return ()


def may_go_home(s: SessionSnapshot) -> Missing:
    """Going home needs drives in their modes and fresh data."""
    return idle(s) or capture_ready(s) or may_use_data(s)


def may_go_best(s: SessionSnapshot) -> Missing:
    """The pose that would tell most is known when there is an estimate."""
    if s.best_waypoint is None:
        return ("no best pose yet: it needs an estimate from a few poses",)
    return may_move(s)


def may_capture(s: SessionSnapshot) -> Missing:
    """Capturing by hand needs the Capture step open, fresh data, and nothing that may have slipped."""
    missing = idle(s) or capture_ready(s) or may_use_data(s)
    if missing:
        return missing
    if s.state.slipped:
        return (s.state.slipped,)
    if s.state.resumed and s.state.poses_here:
        return (
            f"{UNSEEN}: automatic capture reads pose {s.state.poses_here[0].number} again first",
        )
    return ()


def may_run_automatically(s: SessionSnapshot) -> Missing:
    """Automatic capture also needs poses that are still wanted."""
    missing = may_move(s)
    if missing:
        return missing
    if len(s.state.used_poses) >= s.wanted_poses:
        return (f"all {s.wanted_poses} poses are captured",)
    return ()


def moves_metal(s: SessionSnapshot) -> bool:
    """Whether drives move a real arm: neither a simulated one nor one that a person moves."""
    return not s.simulated and not (s.identity is not None and s.identity.by_hand)


def may_remount(s: SessionSnapshot) -> Missing:
    """Mounting the fixture anew needs a fixture, and all poses of the placement it is in."""
    missing = idle(s)
    if missing:
        return missing
    if not s.procedure.fixture.fixture.holds_hand:
        return ("nothing holds the hand: there is no fixture to mount anew",)
    if s.procedure.capture.strategy == "planned":
        return ("a plan is made for one placement of the fixture",)
    if s.state.placement >= MOST_PLACEMENTS:
        return (f"there are {MOST_PLACEMENTS} placements already",)
    if s.state.slipped:
        return (s.state.slipped,)
    left = s.procedure.capture.poses - len(s.state.poses_here)
    if left > 0:
        return (f"{left} poses of this placement are still to be captured",)
    return ()


def may_edit_pose(s: SessionSnapshot) -> Missing:
    """Undo, note and exclude need a pose."""
    return idle(s) or (() if s.state.poses else ("there is no pose yet: capture one first",))


def may_calibrate(s: SessionSnapshot) -> Missing:
    """Calibrating needs enough poses and an estimator that can do without unsensed joints."""
    missing = idle(s) or calibrate_ready(s)
    if missing:
        return missing
    if s.estimator == "paper" and s.unsensed_joints:
        return ("the paper's estimator needs every joint sensed: choose implicit",)
    return ()


def may_write(s: SessionSnapshot) -> Missing:
    """Writing needs an accepted calibration."""
    return idle(s) or export_ready(s)


def may_report(s: SessionSnapshot) -> Missing:
    """A report needs a calibration, accepted or not."""
    return idle(s) or results_ready(s)


def may_upload(s: SessionSnapshot) -> Missing:
    """Uploading needs an accepted calibration and an arm; a file is transferred with drives on or off."""
    return may_write(s) or _may_send(s)


def may_force(s: SessionSnapshot) -> Missing:
    """Uploading for a reason is for a calibration that was not accepted."""
    missing = idle(s) or results_ready(s)
    if missing:
        return missing
    if s.solution is not None and s.solution.accepted:
        return ("the calibration was accepted: upload it in step 7, no reason is needed",)
    return _may_send(s)


def _may_send(s: SessionSnapshot) -> Missing:
    if s.identity is not None and not s.identity.keeps_parameters:
        return ("this arm keeps no parameters: they are in the session's folder",)
    return may_use_data(s)


def serial_number(s: SessionSnapshot) -> str:
    """Of the connected arm, or of the one that the session was taken with; empty before there is one."""
    return s.state.serial_number if s.identity is None else s.identity.serial_number


def may_show_history(s: SessionSnapshot) -> Missing:
    """A history is that of one arm."""
    return () if serial_number(s) else ("of which arm? connect first (step 1)",)


def may_verify(s: SessionSnapshot) -> Missing:
    """Verifying needs a calibration to judge by, and modes that are set or may be."""
    missing = idle(s) or results_ready(s) or may_use_data(s)
    return missing or (() if in_modes(s) else may_apply_modes(s))


def in_modes(s: SessionSnapshot) -> bool:
    """Whether the drives are enabled in modes in which the arm can move."""
    return s.drives_ready and sum(m is JointMode.POSITION for m in s.modes) == s.mobility


def may_reset(s: SessionSnapshot) -> Missing:
    """Only a latched STOP can be reset, or a drive that tripped, or is off though it was told to be enabled."""
    arm = s.arm
    tripped = arm is not None and any(j.drive is DriveState.FAULT for j in arm.joints)
    if s.stopped or tripped or (arm is not None and arm.faults):
        return idle(s)
    return ("STOP is not latched",)


def ends_with_any_key(task: Work | None) -> bool:
    """Hold-to-run: whether any key ends what the arm is doing."""
    return task is not None and task.moves


def _not_ready(s: SessionSnapshot) -> str:
    """Which drive is not as confirmed, in words."""
    if s.arm is None:
        return "there is no data from the drives"
    for joint, mode in zip(s.arm.joints, s.modes, strict=False):
        if joint.drive is not DriveState.OPERATION_ENABLED:
            return f"drive {joint.joint} is {drive_words(joint.drive)}"
        if joint.mode is not mode:
            found = "no mode" if joint.mode is None else joint.mode.value
            wanted = "position" if mode is JointMode.POSITION else "free"
            return f"joint {joint.joint} reports {found} instead of {wanted}"
    return "the drives are not ready"
