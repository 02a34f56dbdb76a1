"""The sections of a report page: their tables, plots and notes, and their order."""

from operator_app import units
from operator_app.calibration.result import Solution
from operator_app.report.facts import Facts
from operator_app.report.html import markup
from operator_app.report.html.markup import Section, element
from operator_app.report.plots import before_after, calibration_plots
from operator_app.report.plots.svg import drawn
from operator_app.report.session_tables import joint_table, pose_table, rvdt_joints, rvdt_table
from operator_app.report.subject import Subject
from operator_app.report.table import FactTable
from operator_app.units import Figure, joints_named, names, others_free, plural, typeset
from solver.diagnostics.rvdt import RvdtVerdict, Soundness

CLOSURE_WORDS = (
    "Closure error at the measured joints, one scale for both estimators. "
    "The implicit estimator does not minimise this error: it corrects the least accurate sensors most, so that better "
    "parameters may leave a larger closure error."
)
NARROW = (
    "truth", "hand", "determined", "estimators", "jackknife", "noise", "halving", "tests",
)  # fmt: skip
"""Tables whose sections take half of the page's width."""


def sections_of(subject: Subject, facts: Facts | None) -> tuple[Section, ...]:
    """Return all sections that have content, most important first; `facts`: those of the subject."""
    brief: list[Section] = []
    detail: list[Section] = []
    for table in () if facts is None else facts.tables:
        (detail if table.detail else brief).append(_of_table(subject, table))
    notes = facts is not None and facts.notices_are_notes
    first = [_warnings(subject, notes=notes), _provenance(subject), *brief]
    sections = [
        *first,
        _joints(subject),
        _rvdt(subject),
        *detail,
        _poses(subject),
        _method(subject),
    ]
    return tuple(section for section in sections if section is not None)


def _of_table(subject: Subject, table: FactTable) -> Section:
    content: list[str] = [markup.table_html(table)] if table.rows else []
    if table.note:
        content.append(markup.remark(table.note))
    match table.ident:
        case "parameters" if subject.solution is not None:
            content.append(markup.remark(_about_sigmas(subject.solution)))
        case "accuracy" if (pair := before_after.arm_pair(subject)) is not None:
            content += [markup.plots(map(drawn, pair.pictures)), markup.remark(pair.note)]
        case "trend" if subject.solution is not None:
            limit = subject.procedure.acceptance.scaled_condition_number
            trend = calibration_plots.condition_trend(subject.solution.identifiability.trend, limit)
            content = [markup.plots([markup.table_html(table), drawn(trend)])]
        case "closure" if subject.solution is not None:
            shown = calibration_plots.residuals(subject, subject.solution.identified)
            content += [markup.remark(CLOSURE_WORDS), markup.plots(map(drawn, shown))]
    narrow = table.ident in NARROW
    return Section(ident=table.ident, title=table.title, content=tuple(content), narrow=narrow)


def _about_sigmas(solution: Solution) -> str:
    text = (
        "The 95 % interval includes the same sources of error as sigma."
        if solution.estimate.chi2 is not None
        else "Sigma and the 95 % interval (Student's) follow from the size of the residuals."
    )
    if solution.paper is None:
        text += " The paper's estimator, which needs every joint sensed, is not shown."
    elif solution.estimate.estimator == "paper" and solution.implicit is None:
        text += " The implicit estimator found no solution."
    return text


def _warnings(subject: Subject, *, notes: bool) -> Section | None:
    glyph = element("span", "· " if notes else "▲ ", class_="glyph", aria_hidden="true")
    items = [element("li", glyph, typeset(markup.sentence(n.sentence))) for n in subject.notices]
    if not items:
        return None
    return Section(
        ident="warnings",
        title=plural(len(items), "note" if notes else "warning"),
        content=(element("ul", *items, class_="warnings notes" if notes else "warnings"),),
    )


def _joints(subject: Subject) -> Section:
    table = joint_table(subject)
    content = (markup.table_html(table), markup.remark(table.note))
    return Section(ident="joints", title=table.title, content=content)


def _rvdt(subject: Subject) -> Section | None:
    joints = rvdt_joints(subject)
    if not joints:
        return None
    verdicts = () if subject.solution is None else subject.solution.rvdt
    content = [markup.remark("These poses allow no verdict on the RVDTs.")]
    if verdicts:
        content = [markup.bullets(map(_rvdt_verdict, verdicts))]
    if table := rvdt_table(subject):
        measured = [(v.joint, v.figures) for v in verdicts if v.figures is not None]
        shown = (calibration_plots.rvdt_deviations(subject, joint, f) for joint, f in measured)
        content += [markup.table_html(table), markup.plots(map(drawn, shown))]
    if unused := [j for j in joints if j in subject.unsensed_joints]:
        content.append(markup.remark(f"The readings of {joints_named(unused)} were not used."))
    return Section(ident="rvdt", title="RVDT joints", content=tuple(content))


def _rvdt_verdict(verdict: RvdtVerdict) -> str:
    text = typeset(f"{verdict.text}.")
    if verdict.verdict in (Soundness.SOUND, Soundness.CANNOT_DECIDE):
        return text
    return markup.join((element("span", "▲ ", class_="warn", aria_hidden="true"), text))


def _poses(subject: Subject) -> Section:
    out = [p.number for p in subject.poses if p.excluded]
    points = [f"{plural(len(subject.poses), 'pose')} captured, {len(subject.used)} used."]
    if out:
        reasons = "the reasons are in the last column"
        points.append(f"Excluded by the operator: {names(out)}; {reasons}.")
    if subject.flipped:
        points.append(f"Left out on the flipped branch of the hinge: {names(subject.flipped)}.")
    table = markup.table_html(pose_table(subject))
    return Section(ident="poses", title="Poses", content=(markup.bullets(points), table))


def _provenance(subject: Subject) -> Section:
    procedure = subject.procedure
    fixture = procedure.fixture
    position = subject.state.position_joints
    driven = names(position) + others_free(len(position), procedure.arm.joint_count)
    settings = ((k, v) for k, v in subject.state.settings.items() if v is not None)
    chosen = ", ".join(
        f"{key.replace('_', ' ')} {names(v) if isinstance(v, list | tuple) else v}"
        for key, v in settings
    )
    times = subject.state.opened_utc, subject.last_utc
    opened, last = (utc[:19].replace("T", " ") for utc in times)
    rows: list[tuple[str, str]] = [
        ("Arm", f"{procedure.arm.name}, {plural(procedure.arm.joint_count, 'joint')}"),
        ("Serial number", subject.state.serial_number or "not known"),
        ("Fixture", f"{fixture.name} ({fixture.kind})"),
        ("Procedure", procedure.name),
        *([("Other settings", chosen)] if chosen else []),
        ("Joints in position mode", driven if position else "not recorded"),
        *([("Poses read from", subject.state.imported)] if subject.state.imported else []),
        ("Session", subject.name),
        ("First, last event (UTC)", f"{opened}, {last}"),
        ("Software", f"sarcal {subject.software_version}"),
        ("Pose set, SHA-256", element("span", subject.state.pose_set().sha256(), class_="mono")),
    ]
    return Section(ident="what", title="What was calibrated", content=(markup.definitions(rows),))


def _method(subject: Subject) -> Section:
    samples = sorted({p.samples for p in subject.poses})
    file = subject.state.imported
    origin = (
        f"Every pose is the mean of {names(samples)} samples of all joints, taken when the arm stood still; sd is the "
        "spread of those samples."
    )
    if file:
        origin = f"The poses were read from {file}; this program did not capture them."
    points = [origin]
    if subject.solution is not None:
        tolerance = subject.procedure.fixture.fixture.tolerance
        equations = plural(subject.solution.model.equations_per_pose, "equation")
        shift = Figure(tolerance.position_m, units.CLOSURE_LENGTH, digits=2).with_unit
        turn = Figure(tolerance.orientation_rad, units.CLOSURE_ANGLE, digits=2).with_unit
        points.append(
            f"The tool closes a loop through the fixture. Each pose gives {equations} after the angles without "
            "a sensor are eliminated."
        )
        points.append(
            "Of the equivalent parameter vectors of a loop, the page gives the nearest to the fixture's nominal "
            f"placement, which was measured to {shift} and {turn}."
        )
    how = "" if subject.solution is None else "; its solution was read, not made again"
    if subject.recalculated_because:
        how = f"; the poses were solved again: {subject.recalculated_because}"
    events = plural(subject.events, "event")
    points.append(f"The page was made from the {events} of the session's journal alone{how}.")
    return Section(
        ident="method", title="How the numbers were made", content=(markup.bullets(points),)
    )
