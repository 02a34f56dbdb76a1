"""Step 2, Fixture: its placement, set-up checks, and the check list before moving."""

import math
from collections.abc import Sequence

from fixtures.base import Severity
from operator_app import units
from operator_app.messages.errors import REACHES_NOTHING
from operator_app.planning.live import Forecast
from operator_app.report.spans import Line, entry, line, wrapped, wrapped_entry
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.list_panel import ListPanel
from operator_app.tui.widgets.pictures import ArmView

CHECK_GLYPHS = {
    Severity.OK: ("✓", "text"),
    Severity.WARNING: ("▲", "warn"),
    Severity.REFUSED: ("■", "alarm"),
}

NEAR_END_RAD = math.radians(3.0)
"""A joint is marked if its predicted range comes closer than this to an end of the joint's allowed range."""

FRAME_ROWS = 2


class PlacementPanel(Lines):
    """The fixture's nominal placement, with tolerances."""

    TITLE = "Placement (nominal)"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        spec = s.procedure.fixture
        limits = spec.fixture.tolerance
        loop = spec.fixture.model(s.procedure.arm)
        rows = [entry("Fixture", (f"{spec.name}", "bold"), f"  kind {spec.kind}")]
        own = set(loop.ground_side) | set(loop.hand_side)
        placed = [p for p in loop.parameters if p.name in own and "theta" not in p.name]
        for name, angles, kind, tolerance in (
            ("Lengths", False, units.NOMINAL_LENGTH, units.LENGTH_TOLERANCE(limits.position_m)),
            ("Twists", True, units.NOMINAL_TWIST, units.ANGLE_TOLERANCE(limits.orientation_rad)),
        ):
            texts = [f"{p.name}\xa0{kind(p.nominal).shown}" for p in placed if p.is_angle is angles]
            if texts:
                values = f"{'  '.join(texts)} {kind.quantity.unit}  ±{tolerance.with_unit}"
                rows += wrapped_entry(name, values, width)
        count, equations = len(loop.parameters), loop.equations_per_pose
        unknowns = f"{count} parameters, {equations} equations per pose"
        return [*rows, entry("Unknowns", unknowns)]


class ChecksPanel(Lines):
    """Set-up checks at the current pose, and the condition number and joint ranges that the plan predicts."""

    TITLE = "Checks at the present pose"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        rows: list[Line] = []
        for check in s.checks:
            glyph, role = CHECK_GLYPHS[check.severity]
            text = f" {glyph} {check.text}" + (f": {check.remedy}" if check.remedy else "")
            rows += wrapped(text, width, role, "   ")
        if not rows:
            rows.append(line((" not checked yet", "dim")))
        if s.forecast is not None and s.forecast.reaches_nothing:
            rows += wrapped(f" ▲ {REACHES_NOTHING}", width, "warn", "   ")
        elif s.forecast is not None:
            condition = units.CONDITION(s.forecast.scaled_condition_number).shown
            limit = f"{s.procedure.acceptance.scaled_condition_number:g}"
            predicted = f" ◌ predicted condition number {condition} "
            rows.append(line(predicted, (f"(the result warns above {limit})", "dim")))
            rows += _ranges(s, s.forecast)
        return rows


def _ranges(s: SessionSnapshot, forecast: Forecast) -> list[Line]:
    cells = []
    for k, joint in enumerate(s.procedure.arm.joints, 1):
        low, high = forecast.span_rad(k, s.required_poses)
        near = min(low - joint.lower_rad, joint.upper_rad - high) < NEAR_END_RAD
        span = f"{units.REACH(low).shown:>6} to {units.REACH(high).shown:>6}"
        cells.append((f" {'▲' if near else ' '} J{k} {span}", "warn" if near else "dim"))
    return [
        line(f" ◌ predicted ranges of the joints [{units.REACH.quantity.unit}]"),
        *(tuple(cells[first : first + 3]) for first in range(0, len(cells), 3)),
    ]


class _ChecklistPanel(ListPanel):
    TITLE = "Check list (Enter ticks)"

    _ticked: frozenset[int] = frozenset()

    def _count(self, s: SessionSnapshot) -> int:
        return len(s.procedure.fixture.checklist)

    def _row(self, s: SessionSnapshot, k: int, width: int) -> Sequence[Line]:
        is_marked, mark = k == self.cursor, "x" if k in s.ticked else " "
        text = f"{'▌' if is_marked else ' '}[{mark}] {s.procedure.fixture.checklist[k]}"
        return wrapped(text, width, "cursor text" if is_marked else "text", "     ")

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        if s.ticked != self._ticked:
            self._ticked = s.ticked
            self.cursor = min(set(range(self._count(s))) - s.ticked, default=self.cursor)
        return super()._build(s, width, height)


class FixtureView(StepView):
    """View of step 2: placement, checks, check list, drawing."""

    PANELS = (
        {"placement": PlacementPanel, "checks": ChecksPanel, "checklist": _ChecklistPanel},
        {"fixture-arm": ArmView},
    )
    MAIN = "checklist"
    VIEWS = (("placement", "checklist"), ("checks",), ("fixture-arm",))

    def show(self, s: SessionSnapshot) -> None:
        """Show a snapshot; on a large terminal, the set-up checks get the rows that the other panels do not need."""
        for panel in (self.query_one(PlacementPanel), self.query_one(_ChecklistPanel)):
            panel.styles.height = None if self.compact else panel.rows_of_all(s) + FRAME_ROWS
        super().show(s)
