"""Guards: pure functions that return why a step or an action is not allowed, as text; "" if it is allowed.

The workflow repeats the check before an action that could do harm. Most actions are refused while a task is running.
"""

from collections.abc import Callable, Mapping

from fixtures.base import Severity
from hardware.arm import DriveState
from operator_app.messages.errors import drive_words
from operator_app.planning import drives
from operator_app.session.ui.snapshot import (
    STALE_S,
    DataState,
    RunningTask,
    SessionSnapshot,
    TaskKind,
)
from operator_app.session.ui.steps import Step
from operator_app.session.workflow.remounting import mounting_problem
from operator_app.units import DATA_AGE, SILENCE, joints_named, plural
from solver.loops.closure import poses_needed

Guard = Callable[[SessionSnapshot], str]


def all_of(*guards: Guard) -> Guard:
    """Return a guard that calls `guards` in order and returns the first reason that is not "", or "" if all allow."""
    return lambda s: next(filter(None, (guard(s) for guard in guards)), "")


def unless(allowed: Callable[[SessionSnapshot], object], reason: str) -> Guard:
    """Return a guard that returns `reason` unless `allowed` returns something true."""
    return lambda s: "" if allowed(s) else reason


def missing_for(step: Step, s: SessionSnapshot) -> str:
    """Return the reason why a step cannot be opened; "" if it can."""
    return "" if step is Step.CONNECT else _STEPS[step](s)


def fixture_ready(s: SessionSnapshot) -> str:
    """Return why the Fixture step is closed; "" if an arm is connected and, if real, its hardware stop was tested."""
    if not s.connected:
        return "no arm is connected: connect first (step 1)"
    if not s.simulated and not s.stop_tested:
        return "the hardware stop is not tested: press it, check that all drives switch off, then confirm"
    return ""


def modes_ready(s: SessionSnapshot) -> str:
    """Return why the Modes step is closed; "" if Fixture is open, its checks passed and every item is ticked."""
    if before := fixture_ready(s):
        return before
    if not s.checks:
        return "the fixture has not been checked (step 2)"
    for check in s.checks:
        if check.severity is Severity.REFUSED:
            return f"{check.text}: {check.remedy}"
    unticked = len(s.procedure.fixture.checklist) - len(s.ticked)
    are = "are" if unticked > 1 else "is"
    missing = f"{plural(unticked, 'item')} of the check list {are} not ticked (step 2)"
    return missing if unticked else ""


def capture_ready(s: SessionSnapshot) -> str:
    """Return why the Capture step is closed; "" if Modes is open and every drive is enabled in its confirmed mode."""
    if before := modes_ready(s):
        return before
    if s.stopped:
        return "STOP is latched: reset it (R), then apply the modes again (step 3)"
    if not s.state.modes:
        return "the joint modes are not set: apply them (step 3)"
    if s.mobility < len(s.state.position_joints) == len(s.state.modes):
        return "all joints are in position mode: apply the modes again (step 3)"
    if not s.drives_ready:
        reset = "reset (R), then " if s.drive_faults else ""
        return f"{_not_ready(s)}: {reset}apply the modes again (step 3)"
    return modes_problem(s, s.state.position_joints)


def calibrate_ready(s: SessionSnapshot) -> str:
    """Return why the Calibrate step is closed; "" if the used poses give more equations than parameters."""
    model = s.procedure.fixture.fixture.model(s.procedure.arm, unsensed_joints=s.unsensed_joints)
    used = len(s.state.used_poses)
    needed = poses_needed(len(model.parameters), model.equations_per_pose)
    are = "is" if used == 1 else "are"
    return f"{used} of the {needed} required poses {are} captured (step 4)" if used < needed else ""


def results_ready(s: SessionSnapshot) -> str:
    """Return why the Results step is closed; "" if a calibration is loaded. On a resume, connecting loads it."""
    if s.solution is not None:
        return ""
    if s.state.solved and not s.connected:
        return "the calibration of this session is shown once the arm is connected (step 1)"
    return f"there is no calibration of these poses {'with these options' if s.state.solved else 'yet'} (step 5)"


def export_ready(s: SessionSnapshot) -> str:
    """Return why the Export step is closed; "" if the calibration is accepted."""
    if s.solution is None or s.solution.accepted:
        return results_ready(s)
    return f"the calibration is not accepted: {s.solution.reasons[0]}"


_STEPS: Mapping[Step, Guard] = {
    Step.FIXTURE: fixture_ready,
    Step.MODES: modes_ready,
    Step.CAPTURE: capture_ready,
    Step.CALIBRATE: calibrate_ready,
    Step.RESULTS: results_ready,
    Step.EXPORT: export_ready,
}


# -- actions ---------------------------------------------------------------------------------------


def idle(s: SessionSnapshot) -> str:
    """Return a request to wait for the running task; "" if no task is running."""
    return "" if s.task is None else f"wait: {s.task.text}"


def may_connect(s: SessionSnapshot) -> str:
    """Return why connecting is refused; "" if no arm is connected, data are lost, or connecting resolves an alarm."""
    offered = any(TaskKind.CONNECT in alarm.resolving_tasks for alarm in s.alarms)
    if s.connected and s.data is not DataState.LOST and not offered:
        return "the arm is already connected"
    return idle(s)


def may_use_data(s: SessionSnapshot) -> str:
    """Return why joint data cannot be used; "" if an arm is connected, STOP is not latched and the data are fresh."""
    if not s.connected:
        return "no arm is connected: connect first (step 1)"
    if s.stopped:
        return "STOP is latched: reset it first (R)"
    if s.data is DataState.LOST:
        silence = SILENCE(s.oldest_s).with_unit
        return f"no data for {silence}: check bus and controller, then connect again (step 1, c)"
    if s.data is DataState.STALE:
        ours = s.arm is not None and s.oldest_s - s.arm.late_s <= STALE_S
        cause = " because this computer is late" if ours else ""
        age = DATA_AGE(s.oldest_s).with_unit
        return f"the data of {joints_named(s.stale_joints)} are {age} old{cause}: wait for new data"
    return ""


def powered(s: SessionSnapshot) -> bool:
    """Whether any drive is enabled."""
    return s.arm is not None and any(j.drive is DriveState.OPERATION_ENABLED for j in s.arm.joints)


may_hold = all_of(may_use_data, unless(powered, "the drives are off: apply the modes (step 3)"))
may_check_fixture = all_of(idle, may_use_data)

may_tick_all = unless(
    lambda s: s.simulated, "on a real arm the items are checked and ticked one at a time"
)
may_suggest = unless(lambda s: s.ranked, "no ranking yet: connect first (step 1)")
may_apply_modes = all_of(
    idle, modes_ready, may_use_data, lambda s: modes_problem(s, s.selected_joints)
)


def modes_problem(s: SessionSnapshot, position_joints: tuple[int, ...]) -> str:
    """Return why `position_joints` is not a valid set of joints for position mode; "" if it is valid."""
    problem = drives.modes_problem(
        position_joints,
        joint_count=s.procedure.arm.joint_count,
        mobility=s.mobility,
        kind=s.procedure.fixture.kind,
    )
    return "" if problem is None else f"{problem.happened}: {problem.remedy}"


may_go_home = all_of(idle, capture_ready, may_use_data)
ALL_VISITED = "all waypoints of the plan are visited"
may_move = all_of(may_go_home, unless(lambda s: s.next_waypoint is not None, ALL_VISITED))
_NO_BEST = "no best pose yet: it needs an estimate from a few poses"
may_go_best = all_of(unless(lambda s: s.best_waypoint is not None, _NO_BEST), may_move)


def may_capture(s: SessionSnapshot) -> str:
    """Return why capturing is refused; "" if Capture is open, data are fresh and no drift check is due."""
    if missing := may_go_home(s) or s.state.sensor_jump:
        return missing
    if s.state.resumed and s.state.poses_here:
        first = s.state.poses_here[0].number
        return f"a drift check is due: start the automatic capture, which begins by measuring pose {first} again"
    return ""


def may_run_automatically(s: SessionSnapshot) -> str:
    """Return why automatic capture is refused; "" if the arm may move and poses are missing or a drift check is due."""
    complete = len(s.state.used_poses) >= s.required_poses
    if lacks_drift_check(s) or (s.state.resumed and s.state.poses_here and not complete):
        return may_go_home(s)  # a captured pose is measured again: no unvisited waypoint is needed
    return may_move(s) or (f"all {s.required_poses} poses are captured" if complete else "")


def lacks_drift_check(s: SessionSnapshot) -> bool:
    """Whether all poses are captured, but exploration or a sensor fault still requires a drift check."""
    complete = len(s.state.used_poses) >= s.required_poses > 0
    explored = s.procedure.capture.strategy != "planned"
    unrepeated = explored and not s.state.repeated_since_capture
    return complete and (unrepeated or bool(s.state.sensor_jump))


def moves_real_arm(s: SessionSnapshot) -> bool:
    """Whether the arm is real and moved by its drives, i.e. neither simulated nor moved by hand."""
    return not s.simulated and not (s.identity is not None and s.identity.by_hand)


def may_remount(s: SessionSnapshot) -> str:
    """Return why remounting is refused; "" if another placement is allowed, and this one has all poses and no fault."""
    if missing := idle(s):
        return missing
    if problem := mounting_problem(s.procedure, s.state.placement + 1):
        return problem.happened
    if s.state.sensor_jump:
        return s.state.sensor_jump
    poses_left = s.procedure.capture.poses - len(s.state.poses_here)
    left = f"{plural(poses_left, 'pose')} of this placement must still be captured"
    return left if poses_left > 0 else ""


may_edit_pose = all_of(
    idle, unless(lambda s: s.state.poses, "there is no pose yet: capture one first")
)
"""Undoing, noting and excluding need a pose."""


def may_calibrate(s: SessionSnapshot) -> str:
    """Return why calibrating is refused; "" if there are enough poses and the estimator allows the unsensed joints."""
    if missing := idle(s) or calibrate_ready(s):
        return missing
    if s.estimator == "paper" and s.unsensed_joints:
        unsensed = f"{joints_named(s.unsensed_joints)} {'is' if len(s.unsensed_joints) == 1 else 'are'} not"
        return f"the paper's estimator needs every joint sensed, and {unsensed}: use the implicit estimator (e)"
    return ""


may_write = all_of(idle, export_ready)
may_report = all_of(idle, results_ready)
"""A report needs a calibration, accepted or not."""


def may_force(s: SessionSnapshot) -> str:
    """Return why a forced upload is refused; "" if the calibration was not accepted and the arm can store it."""
    if missing := idle(s) or results_ready(s):
        return missing
    if s.solution is not None and s.solution.accepted:
        return "the calibration is accepted: upload it in step 7, without a reason"
    return _may_send(s)


def _may_send(s: SessionSnapshot) -> str:
    if s.identity is not None and not s.identity.keeps_parameters:
        return "this arm stores no parameters: use the files in the session folder"
    return may_use_data(s)


may_upload = all_of(may_write, _may_send)


def serial_number(s: SessionSnapshot) -> str:
    """Return the serial number of the connected arm, else of the session's arm; "" if unknown."""
    return s.state.serial_number if s.identity is None else s.identity.serial_number


may_show_history = unless(serial_number, "the arm is not known: connect first (step 1)")


def in_modes(s: SessionSnapshot) -> bool:
    """Whether the drives are enabled, with one joint in position mode for each degree of freedom."""
    return s.drives_ready and len(s.state.position_joints) == s.mobility


may_verify = all_of(
    idle, results_ready, may_use_data, lambda s: "" if in_modes(s) else may_apply_modes(s)
)
"""Verifying needs a calibration, and modes that are set or can be applied."""


def needs_reset(s: SessionSnapshot) -> bool:
    """Whether STOP is latched or a drive has a fault."""
    return s.stopped or bool(s.drive_faults) or (s.arm is not None and bool(s.arm.faults))


may_reset = all_of(unless(needs_reset, "STOP is not latched"), idle)


def stops_on_any_key(task: RunningTask | None) -> bool:
    """Whether any key cancels this task."""
    return task is not None and task.moves


def _not_ready(s: SessionSnapshot) -> str:
    if s.arm is None:
        return "there is no data from the drives"
    others = [j.drive for j in s.arm.joints if j.drive is not DriveState.OPERATION_ENABLED]
    if len(others) > 1:
        states = set(map(drive_words, others))
        return f"{len(others)} drives are {states.pop() if len(states) == 1 else 'not enabled'}"
    for joint, mode in zip(s.arm.joints, s.state.modes, strict=False):
        if joint.drive is not DriveState.OPERATION_ENABLED:
            return f"drive {joint.joint} is {drive_words(joint.drive)}"
        if joint.mode is not mode:
            actual = "no mode" if joint.mode is None else joint.mode.value
            return f"joint {joint.joint} reports {actual} instead of {mode.value}"
    return "the drives are not ready"
