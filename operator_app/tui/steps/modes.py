"""Step 3, Modes: drive joints and free joints, as planned and as read from the drives."""

from collections.abc import Sequence
from functools import partial

from operator_app.report.spans import Line, line, short_entry, wrapped
from operator_app.session.ui.guards import modes_problem
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.list_panel import JointTable
from operator_app.tui.widgets.pictures import ArmView
from operator_app.units import others_free


class PlanPanel(Lines):
    """The pending change of modes, and the ranking of drive joints."""

    TITLE = "Plan"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        marked = s.selected_joints
        names = " ".join(f"J{k}" for k in marked) or "none"
        free = others_free(len(marked), s.procedure.arm.joint_count)
        rows = [short_entry("Marked", (names, "bold"), f" in position mode{free}")]
        if marked == s.procedure.position_joints and s.ranked and marked != s.ranked[0].drives:
            rows.append(line(("           as in the procedure; p marks the best ranked", "dim")))
        problem = modes_problem(s, marked)
        if problem:
            rows += wrapped(" ▲ " + problem, width, "warn", "   ")
        elif s.drives_ready and s.state.position_joints == marked:
            rows.append(line(" ✓ applied, and read back from every drive"))
        else:
            text = " ○ not applied: the drives will be enabled; keep clear of the arm"
            rows += wrapped(text, width, "text", "   ")
        if s.wiggle:
            rows += wrapped(f" Wiggle: {s.wiggle}", width, "text", "   ")
        if s.ranked:
            each = {1: "joint", 2: "pair"}.get(s.mobility, "set")
            text = f" Ranked    by how well each {each} drives the chain here, 0 to 1"
            rows.append(line((text, "dim")))
        pairs = []
        for k, ranked in enumerate(s.ranked, 1):
            pair = " ".join(f"J{j}" for j in ranked.drives)
            glyph = "▌" if ranked.drives == marked else " "
            reasons = "; ".join(ranked.reasons)
            text = f" {glyph}{k:>2} {pair:<6} {ranked.score:4.2f} {reasons}"
            pairs.append(wrapped(text, width, "text" if ranked.usable else "dim", " " * 17))
        return [*rows, *_whole(pairs, height - len(rows))]


def _whole(pairs: Sequence[Sequence[Line]], room: int) -> list[Line]:
    rows = [row for pair in pairs for row in pair]
    if len(rows) <= room:
        return rows
    rows, shown = [], 0
    for pair in pairs:
        if len(rows) + len(pair) > room - 1:
            break
        rows, shown = [*rows, *pair], shown + 1
    return [*rows, line((f"    {len(pairs) - shown} more below these", "dim"))]


class ModesView(StepView):
    """View of step 3: table, plan, drawing."""

    PANELS = (
        {"modes-joints": partial(JointTable, show_selected=True), "modes-plan": PlanPanel},
        {"modes-arm": ArmView},
    )
    MAIN = "modes-joints"
    VIEWS = (("modes-joints", "modes-plan"), ("modes-arm",))
