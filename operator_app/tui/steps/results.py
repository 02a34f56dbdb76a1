"""Step 6, Results: the verdict first, then every parameter, what it is worth, and plots."""

from __future__ import annotations

import math
from collections.abc import Sequence

from textual.app import ComposeResult
from textual.containers import Horizontal, Vertical

from operator_app.calibration.solve import Solution
from operator_app.report.spans import Line, clip, line, wrapped
from operator_app.report.text import dh_table
from operator_app.session.snapshot import SessionSnapshot
from operator_app.session.steps import Step
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.list_panel import ListPanel
from operator_app.tui.widgets.residuals import (
    by_joint,
    by_pose,
    rvdt_curve,
    rvdt_joints,
)
from solver.estimators.goodness import TwoReadings

MM, MRAD = 1e3, 1e3


class VerdictPanel(Lines):
    """Accepted or not, and why."""

    TITLE = "Verdict"
    HELP = (
        "Accepted means the limits of the procedure are met. sigma_pos and sigma_ori say how well the "
        "loops close at the measured joints, before (nominal) and after; rms is the usual reading, "
        "as printed is the paper's formula to the letter."
    )

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """Verdict, condition, sigmas, warnings."""
        found = s.solution
        if found is None:
            return [line((" no calibration of these poses yet", "dim"))]
        count = len(found.warnings)
        tail = f" with {count} warning{'s' if count != 1 else ''}" if count else ""
        if found.accepted:
            head = line((f" {'▲' if count else '✓'} ACCEPTED{tail}", "bold"))
        else:
            head = line((" ■ NOT ACCEPTED", "alarm"))
        seen, chi = found.seen, found.estimate.chi2_per_dof
        ratio = "" if chi is None else f"   chi2/dof {chi:.2f}"
        limit = s.procedure.acceptance.scaled_condition_number
        figures = (
            f"   condition {seen.scaled_condition_number:.1f} (limit {limit:.0f}, paper 28)   "
            f"{found.poses} poses{ratio}"
        )
        after = found.estimate.sigmas
        rows = [
            (*head, (figures, "text")),
            _sigma("sigma_pos", "mm", MM, found.before.position_m, after.position_m),
            _sigma("sigma_ori", "mrad", MRAD, found.before.orientation_rad, after.orientation_rad),
        ]
        for reason in found.reasons:
            rows += wrapped(f" ■ {reason}", width, "alarm", "   ")
        rows += _second_opinion(s)
        short = [f" ▲ {_in_short(notice.text)}" for notice in found.warnings]
        whole = [row for text in short for row in wrapped(text, width, "warn", "   ")]
        if len(rows) + len(whole) > height:
            whole = [line((text, "warn")) for text in short]
        return [clip(row, width) for row in (*rows, *whole)]


def _in_short(notice: str) -> str:
    """What is wrong and what to do: the first and the last clause."""
    what, *rest = notice.split("; ")
    return f"{what}; {rest[-1]}" if rest else what


def _second_opinion(s: SessionSnapshot) -> list[Line]:
    """Hold-out, and poses that do not fit."""
    if s.solution is None or s.checks_of_it is None:
        return []
    rows = []
    held = s.checks_of_it.held_out
    if held is not None:
        rows.append(
            line(
                (" hold-out  ", "dim"),
                f"{MM * held.sigmas.position_m.rms:8.4f} mm, "
                f"{MRAD * held.sigmas.orientation_rad.rms:.4f} mrad rms",
                (f"   inside {MM * held.inside_sigmas.position_m.rms:.4f} mm", "dim"),
            )
        )
    for label in s.solution.outliers:
        rows.append(
            line(
                (
                    f" ▲ pose {label} does not fit the others: x excludes it in Capture",
                    "warn",
                )
            )
        )
    return rows


def _sigma(name: str, unit: str, scale: float, before: TwoReadings, after: TwoReadings) -> Line:
    return line(
        (f" {name} ", "dim"),
        f"{scale * before.rms:8.3f} → ",
        (f"{scale * after.rms:7.4f} {unit} rms", "bold"),
        (
            f"   as printed {scale * before.as_printed:8.4f} → {scale * after.as_printed:7.5f} {unit}",
            "dim",
        ),
    )


class ParametersPanel(ListPanel):
    """Nominal, identified, change, sigma, and what the paper's estimator found."""

    TITLE = "Parameters"
    HELP = (
        "Every parameter: nominal, identified, change, standard deviation; at the right what the "
        "paper's estimator gives on the same poses. Angles in deg, lengths in mm."
    )
    MARKS = False

    def count(self, s: SessionSnapshot) -> int:
        """Parameters."""
        return len(s.solution.identified.parameters) if s.solution else 0

    def head(self, s: SessionSnapshot, width: int) -> Sequence[Line]:
        """Titles."""
        if s.solution is None:
            return []
        return [
            line((" PARAMETER    NOMINAL IDENTIFIED    CHANGE    SIGMA UNIT    PAPER", "header"))
        ]

    def row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        """One parameter."""
        return [] if s.solution is None else [_parameter(s.solution, k)]


def _parameter(solution: Solution, k: int) -> Line:
    estimate, paper = solution.identified, solution.paper
    p = estimate.parameters[k]
    unit, scale = ("deg", 180.0 / math.pi) if p.is_angle else ("mm ", 1e3)
    value = float(estimate.x[k])
    change = value - p.nominal
    if p.is_angle:
        change = math.remainder(change, 2.0 * math.pi)
    sigma = float(estimate.standard_deviation[k])
    beside = f"{paper.value(p.name) * scale:8.2f}" if paper else "       —"
    return line(
        f" {p.name:<11}{p.nominal * scale:9.3f} {value * scale:10.4f} ",
        (f"{change * scale:+9.3f}", "bold"),
        f" {sigma * scale:8.4f} {unit} ",
        (beside, "dim"),
    )


class ResultsPlot(Lines):
    """Residuals by pose, by joint, RVDT curves, D-H table; `v` turns over."""

    TITLE = "Residuals (v: next)"
    HELP = (
        "v turns over: residual of each pose, corrections by joint, the curve of each RVDT as the "
        "loops see it, the whole D-H table. A curve inside the dashed lines is within the sensor's "
        "specification."
    )
    page = 0
    count = 4

    def pages(self, s: SessionSnapshot) -> int:
        """How many there are."""
        return 4 + len(rvdt_joints(s))

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """The present page."""
        ascii_only: bool = self.app.look.ascii_only  # type: ignore[attr-defined]
        if s.solution is None:
            return []
        joints = rvdt_joints(s)
        self.count = self.pages(s)
        page = self.page % self.count
        if page == 0:
            self.retitle("Residuals (v: next)")
            return by_pose(s, width, height, ascii_only=ascii_only)
        if page <= len(joints):
            joint = joints[page - 1]
            self.retitle(f"RVDT of J{joint} (v: next)")
            return rvdt_curve(s, joint, width, height, ascii_only=ascii_only)
        if page == len(joints) + 1:
            self.retitle("By joint (v: next)")
            return by_joint(s, width)
        if page == len(joints) + 2:
            self.retitle("Warnings in full (v: next)")
            return _in_full(s.solution, width)
        self.retitle("D-H table, nominal and found (v: next)")
        if s.solution.model.dh_table(s.solution.estimate.x) is None:
            return [line((" no D-H table for this fixture", "dim"))]
        return [line(row) for row in dh_table(s.solution).splitlines()]


def _in_full(found: Solution, width: int) -> list[Line]:
    rows: list[Line] = []
    for notice in found.warnings:
        rows += [*wrapped(f" ▲ {notice.text}", width, "warn", "   "), ()]
    return rows or [line((" none", "dim"))]


class ResultsView(StepView):
    """Verdict on top, parameters and plots below."""

    STEP = Step.RESULTS
    MAIN = "parameters"
    VIEWS = (("verdict", "parameters"), ("results-plot",))

    def compose(self) -> ComposeResult:
        """Verdict over the whole width."""
        yield VerdictPanel(id="verdict", classes="panel")
        with Horizontal():
            with Vertical(classes="left"):
                yield ParametersPanel(id="parameters")
            with Vertical(classes="right"):
                yield ResultsPlot(id="results-plot", classes="panel")

    def turn_over(self) -> None:
        """On a large terminal the plot turns; on a small one the plot comes after the table."""
        plots = self.query_one("#results-plot", ResultsPlot)
        if self.compact and self.view == 0:
            plots.page = 0
            super().turn_over()
            return
        plots.page = (plots.page + 1) % plots.count
        if self.compact and plots.page == 0:
            super().turn_over()
        # Words and tables need the whole width.
        self.query_one(".left").display = not (plots.page >= plots.count - 2 or self.compact) or (
            self.compact and self.view == 0
        )

    @property
    def place(self) -> tuple[int, int]:
        """Table, then the plots."""
        plots = self.query_one("#results-plot", ResultsPlot)
        return (1 if self.view == 0 else 2 + plots.page), 1 + plots.count
