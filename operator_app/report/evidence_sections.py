"""Sections on the evidence: residuals by pose and joint, coverage, RVDTs, correlations, the poses."""

from __future__ import annotations

from operator_app.report import figures, joint_tables, tables
from operator_app.report.markup import element
from operator_app.report.numbers import fixed, names, plural
from operator_app.report.section import Section, bullets, figure, plots, remark
from operator_app.report.subject import Subject
from solver.estimate import Estimate

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
    """Return how the RVDTs' readings compare with what the loops say; None without an RVDT."""
    joints = figures.rvdt_joints(subject)
    if not joints:
        return None
    estimate = subject.implicit
    compared = [j for j in joints if j not in subject.unsensed_joints]
    content: list[str] = []
    unused = [j for j in joints if j not in compared]
    if unused:
        content.append(remark(f"The readings of joint {names(unused)} were not used."))
    if compared and (estimate is None or estimate.corrections is None):
        content.append(remark("Without an implicit solution there are no corrections to compare."))
    elif compared and estimate is not None:
        content.append(joint_tables.rvdt_table(subject, estimate, compared))
        content.append(
            plots(
                figure(
                    f"Joint {j}: correction against reading",
                    figures.rvdt_corrections(subject, estimate, j),
                )
                for j in compared
            )
        )
        option = element("code", f"--unsensed {','.join(str(j) for j in compared)}")
        content.append(
            remark(
                "A bow or an S is the sensor's curve, not noise: no number of poses averages it out. "
                f"Solving without the readings of joint {names(compared)} (",
                option,
                ") keeps it out of the other parameters.",
            )
        )
    return Section(ident="rvdt", title="RVDT joints", content=tuple(content))


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
