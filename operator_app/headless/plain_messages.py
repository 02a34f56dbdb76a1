"""Formats a snapshot as text for plain mode: one fact per line."""

from operator_app.messages.errors import REACHES_NOTHING
from operator_app.report.quality_tables import truth_in_words
from operator_app.report.results.verification import verified_words
from operator_app.report.subject import facts_on, no_facts
from operator_app.report.text import facts_text
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.snapshot import DataState, SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.units import (
    CONDITION,
    DATA_AGE,
    POSITION,
    READING_SD,
    SILENCE,
    joints_named,
    plural,
)


def describe(step: Step, s: SessionSnapshot) -> list[str]:
    """Return lines of text with the step, the safety state, details, and the recommended action."""
    kind = "SIMULATED" if s.simulated else "REAL ARM"
    lines = [f"Step {int(step)} of {len(Step)}, {step.title}. {kind}. {_safety(s)}"]
    lines += [f"Alarm: {alarm.text}." for alarm in s.alarms]
    lines += _DETAILS[step](s)
    label = next_action(step, s).label
    return [*lines, f"Recommended now: {label}."] if label else lines


def results(s: SessionSnapshot) -> list[str]:
    """Return the results of the calibration as lines of text."""
    facts = facts_on(s)
    return [no_facts(s)] if facts is None else facts_text(facts).splitlines()


def _safety(s: SessionSnapshot) -> str:
    if not s.connected:
        return "No arm is connected."
    if s.data is DataState.LOST:
        return f"Alarm: no data for {SILENCE(s.oldest_s).with_unit}."
    if s.stopped:
        return "The arm stopped by itself." if s.stopped_for else "STOP is latched."
    data = (
        "Data ok"
        if s.data is DataState.FRESH
        else f"Warning: data {DATA_AGE(s.oldest_s).with_unit} old"
    )
    drives = "drives enabled in their modes" if s.drives_ready else "drives not ready"
    return f"{data}, {drives}."


def _connect(s: SessionSnapshot) -> list[str]:
    lines = [f"Bus: {s.bus}. Session: {s.folder}."]
    if s.identity is not None:
        lines.append(
            f"Arm {s.identity.model}, serial {s.identity.serial_number}, "
            f"{len(s.identity.nodes)} nodes."
        )
    return lines


def _fixture(s: SessionSnapshot) -> list[str]:
    lines = [
        f"Check {c.severity.value}: {c.text}" + (f": {c.remedy}" if c.remedy else "")
        for c in s.checks
    ]
    if s.forecast is not None and s.forecast.reaches_nothing:
        lines.append(f"Warning: {REACHES_NOTHING}.")
    elif s.forecast is not None:
        predicted = CONDITION(s.forecast.scaled_condition_number).shown
        lines.append(f"Predicted condition number {predicted}.")
    unticked = len(s.procedure.fixture.checklist) - len(s.ticked)
    return [*lines, f"Check list: {plural(unticked, 'item')} left."]


def _modes(s: SessionSnapshot) -> list[str]:
    lines = []
    if s.arm is not None:
        for joint, state in zip(s.procedure.arm.joints, s.arm.joints, strict=True):
            mode = "no mode" if state.mode is None else state.mode.value
            position = POSITION(state.position_rad).with_unit
            lines.append(f"Joint {state.joint} {joint.name}: {mode}, {position}.")
    for ranked in s.ranked[:3]:
        drives, reasons = joints_named(ranked.drives), "; ".join(ranked.reasons)
        lines.append(f"Ranked {drives}: score {ranked.score:.2f}, {reasons}.")
    return lines


def _capture(s: SessionSnapshot) -> list[str]:
    again = f" Placement {s.state.placement}." if s.state.placement > 1 else ""
    lines = [f"{len(s.state.used_poses)} of {s.required_poses} poses.{again}"]
    if s.live is not None and s.live.history:
        limit = s.procedure.acceptance.scaled_condition_number
        lines.append(
            f"Condition number {CONDITION(s.live.scaled_condition_number).shown} (the result warns above {limit:g}); "
            f"weakest: {', '.join(s.live.weakest[:3])}."
        )
    for pose in s.state.poses[-3:]:
        noise = READING_SD(float(pose.sd_rad.max())).with_unit
        text = f"Pose {pose.number}: noise up to {noise}"
        text += f", excluded {pose.excluded}" if pose.excluded else ""
        text += f", note: {pose.note}" if pose.note else ""
        lines.append(text + ".")
    return lines


def _calibrate(s: SessionSnapshot) -> list[str]:
    unsensed = ", ".join(str(j) for j in s.unsensed_joints) or "none"
    return [f"Estimator {s.estimator}; unsensed joints: {unsensed}."]


def _results(s: SessionSnapshot) -> list[str]:
    facts = facts_on(s)
    if facts is None:
        return []
    solution, kind = facts.solution, "Note" if facts.notices_are_notes else "Warning"
    truth = truth_in_words(solution)
    return [
        f"{facts.verdict.capitalize()}.",
        *(f"{h.text.capitalize()}." for h in facts.headlines),
        *([f"The truth: {truth}"] if truth else []),
        *(f"Reason: {reason}." for reason in solution.reasons),
        *(f"{kind}: {n.text}." for n in solution.warnings),
    ]


def _export(s: SessionSnapshot) -> list[str]:
    lines = ["Not written yet." if s.written is None else f"Written: {s.written.parameters}."]
    if s.receipt is not None:
        lines.append(
            f"Uploaded to slot {s.receipt.slot} and read back: SHA-256 {s.receipt.sha256}."
        )
    if s.verification is not None:
        lines.append(f"Verified with {verified_words(s.verification)}.")
    return lines


_DETAILS = {
    Step.CONNECT: _connect,
    Step.FIXTURE: _fixture,
    Step.MODES: _modes,
    Step.CAPTURE: _capture,
    Step.CALIBRATE: _calibrate,
    Step.RESULTS: _results,
    Step.EXPORT: _export,
}
