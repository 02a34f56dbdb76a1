"""Sections on the evidence: residuals by pose and joint, coverage, RVDTs, correlations, the poses."""

from __future__ import annotations

from operator_app.report import figures, joint_tables, tables
from operator_app.report.markup import Html, element, join
from operator_app.report.numbers import fixed, names, plural
from operator_app.report.section import Section, bullets, figure, plots, prose, remark
from operator_app.report.subject import Subject
from solver.estimators.estimate import Estimate
from solver.judging.rvdt import RvdtVerdict, Verdict
from solver.judging.rvdt_figures import RvdtFigures

CURVE_WORDS = (
    "With the readings of {joints} used, these corrections close the loops. A bow or an S is the "
    "sensor's curve, not noise: no number of poses averages it out, and it pulls at the parameters."
)
TABLE_WORDS = (
    "Corrections to add to the readings over the range the poses cover, straight lines in between (sarcal "
    "solve --json lists twice as many); they belong to the offsets "
    "that are found without these readings, not to those above."
)
CLOSURE_WORDS = (
    "How far the loops fail to close at the joints as measured, so that both estimators are judged on "
    "one scale. The implicit estimator does not minimise this figure: it puts the error where the "
    "sensors are poor, and may leave a larger one here with better parameters."
)


def closure(subject: Subject, estimate: Estimate) -> Section:
    """Return the closure error before and after, and pose by pose."""
    drawn = figures.closure_by_pose(subject, estimate)
    titles = ("Closure error by pose, position", "Closure error by pose, orientation")
    return Section(
        ident="closure",
        title="Residuals by pose",
        content=(
            tables.sigma_table(subject, estimate),
            remark(CLOSURE_WORDS),
            plots(figure(title, made) for title, made in zip(titles, drawn, strict=False)),
        ),
    )


def joints(subject: Subject) -> Section:
    """Return what the loops say of each joint's readings, and how far each joint was moved."""
    estimate = subject.implicit
    drawn = [figure("Joint ranges and what the poses cover of them", figures.coverage(subject))]
    if estimate is not None and (made := figures.corrections_by_joint(subject, estimate)):
        drawn.insert(0, figure("Corrections that close the loops, joint by joint", made))
    return Section(
        ident="joints",
        title="Residuals and coverage by joint",
        content=(
            joint_tables.joint_table(subject, estimate),
            remark(
                f"▲ marks joints whose corrections exceed {figures.CORRECTION_ODD:g} times their "
                "sensor's stated noise (of one reading). Shaded in the plot: one such noise."
            ),
            plots(drawn),
        ),
    )


def rvdt(subject: Subject) -> Section | None:
    """Return how the RVDTs read against what the loops say; None without an RVDT."""
    joints = figures.rvdt_joints(subject)
    if not joints:
        return None
    content: list[str] = []
    verdicts = subject.rvdt
    if verdicts:
        content.append(bullets(_judged(verdict) for verdict in verdicts))
        measured = [(v.joint, v.figures) for v in verdicts if v.figures is not None]
        if measured:
            content.append(joint_tables.rvdt_table(subject))
            content.append(plots(_deviations(subject, joint, f) for joint, f in measured))
    else:
        content.append(remark("These poses allow no verdict on the RVDTs."))
    estimate = subject.implicit
    used = [j for j in joints if j not in subject.unsensed_joints]
    if len(used) < len(joints):
        unused = _joints([j for j in joints if j not in used])
        content.append(remark(f"The readings of {unused} were not used."))
    if used and estimate is not None and estimate.corrections is not None:
        content.append(remark(CURVE_WORDS.format(joints=_joints(used))))
        content.append(plots(_corrections(subject, estimate, j) for j in used))
    tables_of = [
        joint_tables.correction_table(v.joint, v.figures)
        for v in verdicts
        if v.figures is not None and v.verdict is not Verdict.SOUND
    ]
    if tables_of:
        content.append(remark(prose(TABLE_WORDS)))
        content.append(plots(tables_of))
    return Section(ident="rvdt", title="RVDT joints", content=tuple(content))


def _joints(numbers: list[int]) -> str:
    return f"joint{'s' if len(numbers) > 1 else ''} {names(numbers)}"


def _judged(verdict: RvdtVerdict) -> Html:
    words = prose(verdict.text + ".")
    if verdict.verdict in (Verdict.SOUND, Verdict.CANNOT_DECIDE):
        return words
    return join((element("span", "▲ ", class_="warn", aria_hidden="true"), words))


def _deviations(subject: Subject, joint: int, found: RvdtFigures) -> Html:
    return figure(
        f"Joint {joint}: reading less the angle the loop measures",
        figures.rvdt_deviations(subject, joint, found),
    )


def _corrections(subject: Subject, estimate: Estimate, joint: int) -> Html:
    return figure(
        f"Joint {joint}: correction against reading",
        figures.rvdt_corrections(subject, estimate, joint),
    )


def correlations(estimate: Estimate) -> Section:
    """Return which parameters cannot be told apart well."""
    pairs = tables.strongest_correlations(estimate)
    told = "; ".join(f"{a} and {b} {fixed(r, 3, signed=True)}" for a, b, r in pairs)
    return Section(
        ident="correlations",
        title="Correlations",
        content=(remark(f"Hardest to tell apart: {told}."), tables.correlation_table(estimate)),
    )


def poses(subject: Subject, estimate: Estimate | None) -> Section:
    """Return every captured pose, used or not."""
    out = [p.number for p in subject.poses if p.excluded]
    points = [f"{plural(len(subject.poses), 'pose')} captured, {len(subject.used)} used."]
    if out:
        points.append(
            f"Excluded by the operator: {names(out)}; the reasons are in the last column."
        )
    if subject.flipped:
        points.append(f"Left out on the flipped branch of the hinge: {names(subject.flipped)}.")
    said = remark(points[0]) if len(points) == 1 else bullets(points)
    return Section(
        ident="poses",
        title="Poses",
        content=(said, joint_tables.pose_table(subject, estimate)),
    )
