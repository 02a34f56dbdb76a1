"""Pure functions that return the next action of each step, with the hint shown to the operator."""

from collections.abc import Callable, Mapping
from dataclasses import dataclass

from fixtures.base import Severity
from operator_app.messages.errors import unstopped_words
from operator_app.session.ui import guards
from operator_app.session.ui.snapshot import DataState, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step
from operator_app.units import names, others_free


@dataclass(frozen=True, slots=True)
class NextAction:
    """Action of the Enter key: name (empty if Enter does nothing), label, and hint."""

    action: str
    label: str
    hint: str


def next_action(step: Step, s: SessionSnapshot) -> NextAction:
    """Return the next action of a step, for the state in the snapshot."""
    if s.data is DataState.LOST and s.task is None:
        return _lost(step)
    if s.task is not None and not s.task.moves:
        return NextAction("", "", f"{s.task.progress} ...")
    if s.stopped:
        when = "STOP is latched: when it is safe,"
        if s.stopped_for:
            when = "the arm stopped by itself: keep clear until the cause is known, then"
        hint = f"{when} Enter (or R) resets it; nothing moves by itself"
        if s.unstopped_joints:
            hint = f"{unstopped_words(s.unstopped_joints)}: use the hardware stop; then Enter (or R) resets STOP"
        return NextAction("reset", "Reset STOP", hint)
    if s.drive_faults or (s.task is None and guards.needs_reset(s) and not s.needs_reconnect):
        return NextAction("reset", "Reset fault", f"{_faults(s.drive_faults)}; nothing moves")
    if s.task is not None:
        key = "" if s.task.ending else ": any key stops it"
        return NextAction("", "", f"{s.task.progress}{key}")
    if not s.connected and Step.CONNECT < step < Step.CALIBRATE:
        return NextAction("step_1", "To Connect", "no arm is connected: Enter goes to step 1")
    return _BY_STEP[step](s)


def _faults(faults: Mapping[int, str]) -> str:
    if not faults:  # the drive is only off: it is not enabled before a reset
        return "a drive reported a fault: follow the alarm's remedy; then Enter (or R) resets it"
    what = "; ".join(sorted({text for text in faults.values() if text}))
    known = f" ({what})" if what else ""
    which, them = f"{len(faults)} drives are", "them"
    if len(faults) == 1:
        which, them = f"the drive of J{min(faults)} is", "it"
    return f"{which} in fault{known}: find the cause, then Enter (or R) resets {them}"


def _lost(step: Step) -> NextAction:
    what = "no data from the arm: its state is not known, look before you go near. Check bus and controller; "
    if step is Step.CONNECT:
        return NextAction("connect", "Connect again", what + "Enter connects again")
    return NextAction("step_1", "To Connect", what + "Enter goes to step 1")


_CONNECT_AGAIN = NextAction(
    "step_1",
    "To Connect",
    "correct what the alarm reports; then Enter goes to step 1, to connect again",
)


def _next(step: Step, hint: str) -> NextAction:
    return NextAction("next", step.title, f"{hint}: Enter goes on to {step.title}")


def _connect(s: SessionSnapshot) -> NextAction:
    if not s.connected:
        what = "the simulated arm" if s.simulated else "the arm"
        hint = f"Enter connects to {what} on {s.bus}"
        if s.state.unconfirmed_placement:
            hint = f"placement {s.state.placement}: when the fixture is mounted and everybody is clear, {hint}"
        return NextAction("connect", "Connect", hint)
    if not s.simulated and not s.stop_tested:
        hint = (
            "press the hardware stop, check that every drive switches off, release it; then Enter"
        )
        return NextAction("stop_tested", "Stop tested", hint)
    if s.needs_reconnect:
        hint = "correct what the alarm reports, then Enter connects again"
        return NextAction("connect", "Connect again", hint)
    return _next(Step.FIXTURE, "the arm is connected and checked")


def _fixture(s: SessionSnapshot) -> NextAction:
    if not s.checks or any(c.severity is Severity.REFUSED for c in s.checks):
        hint = "remount the fixture as the refused check states, then Enter checks it again"
        return NextAction("check_fixture", "Check", hint)
    unticked = len(s.procedure.fixture.checklist) - len(s.ticked)
    if unticked and s.simulated:
        hint = (
            "on a real arm the items are checked and ticked one at a time; this arm is simulated: "
        )
        return NextAction("confirm_all", "Tick all", f"{hint}Enter ticks all {unticked}")
    if unticked:
        hint = f"check each item of the list, then Enter ticks it: {unticked} left"
        return NextAction("confirm", "Tick", hint)
    return _next(Step.MODES, "the fixture is checked")


def _modes(s: SessionSnapshot) -> NextAction:
    if missing := guards.missing_for(Step.MODES, s):
        return NextAction("back", "Back to Fixture", f"{missing}; Enter goes back")
    marked = s.selected_joints
    if problem := guards.modes_problem(s, marked):
        return NextAction("suggest", "Best set", problem)
    if s.state.position_joints == marked and not guards.missing_for(Step.CAPTURE, s):
        return _next(Step.CAPTURE, "the modes are set and read back")
    if s.needs_reconnect:
        return _CONNECT_AGAIN
    if any(alarm.resolving_tasks == {TaskKind.MODES} for alarm in s.alarms):
        hint = "follow the alarm's remedy; then Enter applies the modes again, or N starts a new session"
        return NextAction("apply_modes", "Apply modes", hint)
    driven = names(f"J{k}" for k in marked)
    others = others_free(len(marked), s.procedure.arm.joint_count)
    hint = f"Enter applies the modes: {driven} drive{'s' if len(marked) == 1 else ''}{others} (it asks first)"
    return NextAction("apply_modes", "Apply modes", hint)


def _capture(s: SessionSnapshot) -> NextAction:
    if s.needs_reconnect:
        return _CONNECT_AGAIN
    missing = guards.missing_for(Step.CAPTURE, s)
    used = len(s.state.used_poses)
    poses_left = s.required_poses - used
    if poses_left > 0 and missing:
        return NextAction("back", "Back to Modes", f"{missing}; Enter goes back")
    if poses_left > 0:
        poses = "the last pose" if poses_left == 1 else f"the {poses_left} remaining poses"
        hint = f"Enter captures {poses} automatically; g and c capture one by hand"
        if s.procedure.capture.strategy == "planned":
            planned = s.procedure.capture.poses
            hint = f"Enter explores as far as needed, then captures the {planned} most informative poses"
        if s.state.resumed and s.state.poses_here:
            first = s.state.poses_here[0].number
            hint = f"Enter measures pose {first} again (drift check), then captures {poses}"
        if guards.moves_real_arm(s):
            hint += " (it asks first)"
        return NextAction("automatic", "Automatic", hint)
    captured = f"all {used} poses are captured"
    if guards.lacks_drift_check(s) and not guards.may_run_automatically(s):
        captured += ", but the drift check is missing (key a starts it)"
    return _next(Step.CALIBRATE, captured)


def _calibrate(s: SessionSnapshot) -> NextAction:
    if s.solution is None:
        poses = len(s.state.used_poses)
        hint = f"Enter calibrates from {poses} poses, estimator {s.estimator}"
        return NextAction("calibrate", "Solve", hint)
    return _next(Step.RESULTS, "calibrated")


def _results(s: SessionSnapshot) -> NextAction:
    if guards.missing_for(Step.EXPORT, s):
        hint = "not accepted: follow the warnings, or exclude bad poses, and calibrate again"
        return NextAction("step_4", "Capture more", hint)
    verdict = "" if s.solution is None else s.solution.verdict.words
    return _next(Step.EXPORT, f"the calibration is {verdict}")


def _export(s: SessionSnapshot) -> NextAction:
    if s.written is None:
        return NextAction("write", "Write file", "Enter writes parameters.yaml and poses.csv")
    if s.identity is not None and not s.identity.keeps_parameters:
        hint = "done: the files are written; this arm stores no parameters. Enter or q quits"
        return NextAction("quit", "Finish", hint)
    if s.receipt is None:
        hint = "the files are written. Enter uploads to the controller, after confirmation; q quits"
        return NextAction("upload", "Upload", hint)
    if s.verification is None:
        hint = "done: uploaded and read back. Enter or q quits; y verifies with new poses"
    elif s.verification.holds:
        hint = "done: uploaded, read back and verified with new poses. Enter or q quits"
    else:
        hint = "uploaded, but new poses are worse than expected: find the cause before use. Enter or q quits"
    return NextAction("quit", "Finish", hint)


_BY_STEP: Mapping[Step, Callable[[SessionSnapshot], NextAction]] = {
    Step.CONNECT: _connect,
    Step.FIXTURE: _fixture,
    Step.MODES: _modes,
    Step.CAPTURE: _capture,
    Step.CALIBRATE: _calibrate,
    Step.RESULTS: _results,
    Step.EXPORT: _export,
}
