"""Step 5, Calibrate: estimator, joints in use, progress of the iterations."""

from collections.abc import Sequence

from operator_app.report.plots.calibration_plots import costs, misses
from operator_app.report.spans import Line, entry, line, wrapped
from operator_app.report.subject import facts_on, subject_on
from operator_app.session.ui.guards import may_calibrate
from operator_app.session.ui.snapshot import SessionSnapshot, TaskKind
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.pictures import plot
from operator_app.units import COST

ESTIMATOR_NOTES = {
    "implicit": "sensors weighted by noise; loops close exactly (default)",
    "paper": "unweighted least squares on the closure (eqs. 5 and 6)",
}


class _SettingsPanel(Lines):
    TITLE = "Calibration"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        used, captured = len(s.state.used_poses), len(s.state.poses)
        joints = ", ".join(f"J{j}" for j in s.unsensed_joints) or "none"
        excluded = f", {captured - used} excluded" if captured > used else ""
        return [
            entry("Estimator", (s.estimator, "bold"), ("  " + ESTIMATOR_NOTES[s.estimator], "dim")),
            entry("Unsensed", joints, ("   (j changes)", "dim")),
            entry("Poses", f"{used} count", (excluded, "dim")),
            *_progress(s, width),
        ]


def _progress(s: SessionSnapshot, width: int) -> list[Line]:
    running = s.task is not None and s.task.kind is TaskKind.CALIBRATE
    if running or (s.iterations and s.solution is None):
        text = "starting"
        if s.iterations:
            number, cost = s.iterations[-1]
            text = f"iteration {number}   cost {COST(cost).shown}"
        return [entry("Running", ("◌ ", "accent"), text, ("   z cancels", "dim"))]
    if (facts := facts_on(s)) is not None:
        glyph, role = ("✓", "bold") if facts.solution.accepted else ("▲", "warn")
        figures = [h.figure_text for h in facts.headlines if not h.closure]
        return [
            entry("Result", (f"{glyph} {facts.verdict}", role)),
            line(("            ", "dim"), "   ".join(figures)),
        ]
    if missing := may_calibrate(s):
        return wrapped(" ▲ " + missing, width, "warn", "   ")
    return [entry("Ready", "Enter or s starts")]


class _CalibratePlot(Lines):
    TITLE = "Residual of each pose"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        if (subject := subject_on(s)) is not None and s.solution is not None:
            self.set_title("Residual of each pose")
            picture = misses(subject, s.solution.identified)
        elif len(s.iterations) >= 2:
            self.set_title("Cost by iteration")
            picture = costs(s.iterations)
        else:
            return [(), line((" nothing solved yet", "dim"))]
        return plot(picture, width, height, ascii_only=self.look.ascii_only)


class CalibrateView(StepView):
    """View of step 5: settings and a plot."""

    PANELS = ({"settings": _SettingsPanel, "calibrate-plot": _CalibratePlot},)
