"""The next thing to do at each step, and the sentence that says so. Pure; both faces offer it first."""

from __future__ import annotations

from dataclasses import dataclass

from fixtures.base import Severity
from hardware.arm import DriveState
from operator_app.planning.mode_rule import and_the_others
from operator_app.session.ui.guards import missing_for, modes_problem, moves_metal
from operator_app.session.ui.message_log import asks_to_connect_again
from operator_app.session.ui.snapshot import DataState, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step
from operator_app.units.numbers import names


@dataclass(frozen=True, slots=True, kw_only=True)
class NextThing:
    """What Enter does: an action's name ("" for nothing), its label, and a sentence."""

    action: str
    label: str
    hint: str


def next_thing(step: Step, s: SessionSnapshot) -> NextThing:
    """Return what Enter does at `step`."""
    if s.data is DataState.LOST and s.task is None:
        return _lost(step)
    if s.task is not None and not s.task.moves:
        return NextThing(action="", label="", hint=f"{s.task.text} ...")
    if s.stopped:
        why = "the arm was stopped by itself: keep clear until you know why, then Enter (or R) resets it"
        return NextThing(
            action="reset",
            label="Reset STOP",
            hint=f"{why}; nothing moves by itself"
            if s.stopped_for
            else "STOP is latched: when it is safe, Enter (or R) resets it; nothing moves by itself",
        )
    if s.arm is not None and any(j.drive is DriveState.FAULT for j in s.arm.joints):
        return NextThing(
            action="reset",
            label="Reset fault",
            hint="a drive tripped: find out why, then Enter (or R) resets it; nothing moves",
        )
    if s.task is not None:
        return NextThing(action="", label="", hint=f"{s.task.text}: any key stops it")
    if not s.connected and Step.CONNECT < step < Step.CALIBRATE:
        return NextThing(
            action="step_1", label="To Connect", hint="no arm is connected: Enter goes to step 1"
        )
    match step:
        case Step.CONNECT:
            return _connect(s)
        case Step.FIXTURE:
            return _fixture(s)
        case Step.MODES:
            return _modes(s)
        case Step.CAPTURE:
            return _capture(s)
        case Step.CALIBRATE:
            return _calibrate(s)
        case Step.RESULTS:
            return _results(s)
        case Step.EXPORT:
            return _export(s)


def _lost(step: Step) -> NextThing:
    what = "no data from the arm; the drives hold by themselves. Look at bus and controller, then "
    if step is Step.CONNECT:
        return NextThing(
            action="connect", label="Connect again", hint=what + "Enter connects again"
        )
    return NextThing(action="step_1", label="To Connect", hint=what + "Enter goes to step 1")


_CONNECT_AGAIN = NextThing(
    action="step_1",
    label="To Connect",
    hint="mend what the alarm says; then Enter goes to step 1, to connect again",
)


def _next(step: Step, hint: str) -> NextThing:
    return NextThing(action="next", label=step.title, hint=f"{hint}: Enter goes on to {step.title}")


def _connect(s: SessionSnapshot) -> NextThing:
    if not s.connected:
        what = "the simulated arm" if s.simulated else "the arm"
        hint = f"Enter connects to {what} on {s.bus}"
        if s.state.unseen:
            hint = f"placement {s.state.placement}: when the fixture is mounted and all stand clear, {hint}"
        return NextThing(action="connect", label="Connect", hint=hint)
    if not s.simulated and not s.stop_tested:
        return NextThing(
            action="stop_tested",
            label="Stop tested",
            hint="press the hardware stop, see every drive drop out, release it; then Enter",
        )
    if asks_to_connect_again(s):
        return NextThing(
            action="connect",
            label="Connect again",
            hint="mend what the alarm says, then Enter connects again",
        )
    return _next(Step.FIXTURE, "the arm is connected and checked")


def _fixture(s: SessionSnapshot) -> NextThing:
    if not s.checks or any(c.severity is Severity.REFUSED for c in s.checks):
        return NextThing(
            action="check_fixture",
            label="Check",
            hint="remount the fixture as the red check says, then Enter checks it again",
        )
    left = len(s.procedure.fixture.checklist) - len(s.ticked)
    if left and s.simulated:
        return NextThing(
            action="confirm_all",
            label="Tick all",
            hint="on a real arm each item is looked at and ticked by itself; nothing here is real: "
            f"Enter ticks all {left}",
        )
    if left:
        return NextThing(
            action="confirm",
            label="Tick",
            hint=f"look at each item of the check list, then Enter ticks it: {left} left",
        )
    return _next(Step.MODES, "the fixture is checked")


def _modes(s: SessionSnapshot) -> NextThing:
    marked = s.wanted_joints
    problem = modes_problem(s, marked)
    if not problem and s.position_joints == marked and not missing_for(Step.CAPTURE, s):
        return _next(Step.CAPTURE, "the modes are set and read back")
    if problem:
        return NextThing(action="suggest", label="Best pair", hint=problem[0])
    if asks_to_connect_again(s):
        return _CONNECT_AGAIN
    if any(alarm.until == {TaskKind.MODES} for alarm in s.alarms):
        return NextThing(
            action="apply_modes",
            label="Apply modes",
            hint="do what the alarm says; then Enter applies the modes again, or N begins a new session",
        )
    driven = names(f"J{k}" for k in marked)
    others = and_the_others(len(marked), s.procedure.arm.joint_count)
    return NextThing(
        action="apply_modes",
        label="Apply modes",
        hint=f"Enter applies the modes: {driven} drive{others} (it asks first)",
    )


def _capture(s: SessionSnapshot) -> NextThing:
    if asks_to_connect_again(s):
        return _CONNECT_AGAIN
    missing = missing_for(Step.CAPTURE, s)
    used = len(s.state.used_poses)
    left = s.wanted_poses - used
    if left > 0 and missing:
        return NextThing(
            action="back", label="Back to Modes", hint=f"{missing[0]}; Enter goes back there"
        )
    if left > 0:
        poses = "the pose" if left == 1 else f"the {left} poses"
        hint = f"Enter captures {poses} left automatically; g and c do one by hand"
        if s.procedure.capture.strategy == "planned":
            planned = s.procedure.capture.poses
            hint = (
                f"Enter explores as far as it must, then takes the {planned} poses that tell most"
            )
        if s.state.resumed and s.state.poses_here:
            first = s.state.poses_here[0].number
            hint = f"Enter reads pose {first} again (what slipped meanwhile?), then captures {poses} left"
        if moves_metal(s):
            hint += " (it asks first)"
        return NextThing(action="automatic", label="Automatic", hint=hint)
    return _next(Step.CALIBRATE, f"all {used} poses are captured")


def _calibrate(s: SessionSnapshot) -> NextThing:
    if s.solution is None:
        return NextThing(
            action="calibrate",
            label="Solve",
            hint=f"Enter calibrates from {len(s.state.used_poses)} poses, estimator {s.estimator}",
        )
    return _next(Step.RESULTS, "calibrated")


def _results(s: SessionSnapshot) -> NextThing:
    missing = missing_for(Step.EXPORT, s)
    if missing:
        return NextThing(
            action="step_4",
            label="Capture more",
            hint="not accepted: take poses as the warnings say, or exclude bad ones, and solve again",
        )
    return _next(Step.EXPORT, "the calibration is accepted")


def _export(s: SessionSnapshot) -> NextThing:
    if s.written is None:
        return NextThing(
            action="write", label="Write file", hint="Enter writes parameters.yaml and poses.csv"
        )
    if s.identity is not None and not s.identity.keeps_parameters:
        return NextThing(
            action="quit",
            label="Finish",
            hint="done: the files are written; this arm keeps no parameters. Enter or q leaves",
        )
    if s.receipt is None:
        return NextThing(
            action="upload",
            label="Upload",
            hint="the files are written. Enter uploads to the controller, after a question; q leaves",
        )
    return NextThing(action="quit", label="Finish", hint=_uploaded(s))


def _uploaded(s: SessionSnapshot) -> str:
    """What is done, and how new poses judge it, or may."""
    if s.verification is not None:
        if s.verification.holds:
            return "done: uploaded, read back and verified with new poses. Enter or q leaves"
        return (
            "uploaded, but new poses are worse than expected: find out why before it is used. "
            "Enter or q leaves"
        )
    return "done: uploaded and read back. Enter or q leaves; y verifies with new poses"
