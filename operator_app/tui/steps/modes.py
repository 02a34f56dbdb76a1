"""Step 3, Modes: drive joints and free joints, as planned and as read from the drives."""

from collections.abc import Sequence
from functools import partial
from itertools import accumulate, chain

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
            text = f" Ranked    how well each {each} drives, at the last check, 0 to 1"
            rows.append(line((text, "dim")))
        pairs, own = list[list[Line]](), -1
        for k, ranked in enumerate(s.ranked, 1):
            pair = " ".join(f"J{j}" for j in ranked.drives)
            glyph, own = ("▌", k - 1) if ranked.drives == marked else (" ", own)
            text = f" {glyph}{k:>2} {pair:<6} {ranked.score:4.2f} {'; '.join(ranked.reasons)}"
            pairs.append(wrapped(text, width, "text" if ranked.usable else "dim", " " * 17))
        return [*rows, *_whole(pairs, own, height - len(rows))]


def _whole(pairs: Sequence[list[Line]], own: int, room: int) -> list[Line]:
    """Return the rows of the best pairs, and of the marked pair `own` (from 0; -1: not ranked) even if it is worse."""
    ends = list(accumulate(map(len, pairs)))
    if not ends or ends[-1] <= room:
        return list(chain.from_iterable(pairs))
    shown = sum(end < room for end in ends)
    marked = pairs[own] if own >= shown and len(pairs[own]) < room else []
    shown = sum(end < room - len(marked) for end in ends)
    more = f"    {len(pairs) - shown} more below these{', among them' if marked else ''}"
    return [*chain.from_iterable(pairs[:shown]), line((more, "dim")), *marked]


class ModesView(StepView):
    """View of step 3: table, plan, drawing."""

    PANELS = (
        {"modes-joints": partial(JointTable, show_selected=True), "modes-plan": PlanPanel},
        {"modes-arm": ArmView},
    )
    MAIN = "modes-joints"
    VIEWS = (("modes-joints", "modes-plan"), ("modes-arm",))
