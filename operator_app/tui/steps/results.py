"""Step 6, Results: the verdict, every parameter with its uncertainty, and plots."""

from collections.abc import Sequence
from itertools import chain

from textual.app import ComposeResult

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.result import Solution
from operator_app.report.facts import Facts
from operator_app.report.plots.calibration_plots import misses, rvdt_deviations
from operator_app.report.quality_tables import truth_in_words
from operator_app.report.session_tables import joint_table
from operator_app.report.spans import Line, clip, length, line, window, wrapped
from operator_app.report.subject import Subject, facts_on, no_facts, subject_on
from operator_app.report.table import FactTable
from operator_app.report.text import headline_spans, table_spans
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.list_panel import ListPanel, TablePanel
from operator_app.tui.widgets.pictures import plot
from operator_app.units import CLOSURE_LENGTH, Figure, names, plural

TABLES = ("causes", "dh", "hand", "accuracy", "budget", "halving", "closure")
"""Names of the tables shown in the panel after the plots, if the calibration has them."""


VERDICT_GLYPHS = {
    Verdict.ACCEPTED: ("✓", "bold"),
    Verdict.WITH_WARNINGS: ("▲", "bold"),
    Verdict.NOT_ACCEPTED: ("■", "alarm"),
}


class VerdictPanel(Lines):
    """The verdict with its reasons."""

    TITLE = "Verdict"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        facts = facts_on(s)
        if facts is None:
            return wrapped(f" {no_facts(s)}", width, "dim", " ")
        rows, noted = _verdict(facts, width), facts.notices_are_notes
        short = [f" {'·' if noted else '▲'} {notice.brief}" for notice in facts.solution.warnings]
        # An accepted result needs no action: grey, like everything normal.
        role = "text" if noted else "warn"
        briefs = [row for text in short for row in wrapped(text, width, role, "   ")]
        if len(rows) + len(briefs) > height:
            briefs = [line((text, role)) for text in short]
        rows += briefs
        if (hidden := len(rows) - height) > 0:
            rows[height - 1 :] = [line((f"   {hidden + 1} more (v)", "dim"))]
        return [clip(row, width) for row in rows]


def _verdict(facts: Facts, width: int) -> list[Line]:
    """Return the verdict with its reasons, followed by the accuracy of the tool and the headline figures."""
    solution, count = facts.solution, len(facts.solution.warnings)
    glyph, role = VERDICT_GLYPHS[solution.verdict]
    # Notices are called notes here, because ACCEPTED, WITH WARNINGS is another verdict.
    tail = f" · {plural(count, 'note')}" if facts.notices_are_notes and count else ""
    reasons = [wrapped(f" ■ {reason}", width, "alarm", "   ") for reason in solution.reasons]
    truth = truth_in_words(solution)
    return [
        line((f" {glyph} {facts.verdict.upper()}{tail}", role)),
        *chain.from_iterable(reasons),
        *_hand(solution, width),
        *(wrapped(f"   truth: {truth}", width, "text", "   ") if truth else ()),
        headline_spans([h for h in facts.headlines if h.closure], width),
        headline_spans([h for h in facts.headlines if not h.closure and h.name != "rank"], width),
    ]


def _hand(solution: Solution, width: int) -> list[Line]:
    if solution.accuracy is None:
        return []
    before, after = (
        Figure(spread.rms, CLOSURE_LENGTH).with_unit
        for spread in (solution.accuracy.before, solution.accuracy.after)
    )
    text = f"   tool off by {before} before, {after} after (1 sigma)"
    if (without_files := solution.accuracy.after_by_poses) is not None:
        by_poses = Figure(without_files.rms, CLOSURE_LENGTH).with_unit
        text += f", {by_poses} without the uncertainty of {names(solution.accuracy.stated)}"
    if held := solution.accuracy.holds_for:
        text += f", only if {', '.join(h.name for h in held)} {'are' if len(held) > 1 else 'is'} as fixed"
    whole = line((text, "bold"), ", rms over the ranges of all joints")
    return [whole] if length(whole) <= width else wrapped(text, width, "bold", "   ")


class _ParametersPanel(TablePanel):
    TITLE = "Parameters"

    def _table(self, s: SessionSnapshot) -> FactTable | None:
        facts = facts_on(s)
        return None if facts is None else facts.tables[0]


class ResultsPlot(ListPanel):
    """Residuals by pose, RVDT deviations, warnings and tables, a page at a time; `v` shows the next page.

    A page whose text or table is longer than the panel can be scrolled: `cursor` is its first visible row.
    """

    TITLE = "Residuals (v: next)"
    page = 0
    count = 1
    framed = True
    """Whether the frame shows the title; without a frame the title is the first line."""

    def count_pages(self, s: SessionSnapshot) -> None:
        """Count the pages: one of residuals, one per RVDT, one of warnings, one of joints, one per further table."""
        facts = facts_on(s)
        if facts is not None:
            tables = sum(facts.table(ident) is not None for ident in TABLES)
            self.count = 3 + len(facts.solution.rvdt) + tables

    def turn_to(self, page: int) -> None:
        """Show a page from its beginning; the first page follows the last."""
        self.page, self.cursor = page % self.count, 0

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        subject, facts = subject_on(s), facts_on(s)
        if subject is None or facts is None:
            return []
        room = height if self.framed else height - 1
        title, head, body = self._page(subject, facts, width, room)
        self.set_title(f"{title} (v: next)")
        rows, shown, self.cursor = window(body, self.cursor, max(1, room - len(head)))
        self._last = len(body) - shown
        return [*([] if self.framed else [line((f" {title}", "header"))]), *head, *rows]

    def _page(
        self, subject: Subject, facts: Facts, width: int, height: int
    ) -> tuple[str, Sequence[Line], Sequence[Line]]:
        """Return the title of the page, the rows that stay at the top, and the rows that scroll."""
        ascii_only, page = self.look.ascii_only, self.page % self.count
        solution = facts.solution
        if page == 0:
            picture = misses(subject, solution.identified)
            return "Residuals", plot(picture, width, height, ascii_only=ascii_only), ()
        page -= 1
        if page < len(solution.rvdt):
            verdict, head = solution.rvdt[page], list[Line]()
            role = "warn" if verdict.treat_as_unsensed else "text"
            body = wrapped(f" {verdict.text}", width, role, " ")
            if verdict.figures is not None:
                picture = rvdt_deviations(subject, verdict.joint, verdict.figures)
                head = plot(picture, width, max(8, height - len(body)), ascii_only=ascii_only)
            if len(head) + 2 > height:  # no room for text below the plot: all scrolls
                head, body = [], [*head, *body]
            return f"RVDT of J{verdict.joint}", head, body
        page -= len(solution.rvdt)
        if page == 0:
            mark, role = ("·", "text") if facts.notices_are_notes else ("▲", "warn")
            texts = [wrapped(f" {mark} {n.text}", width, role, "   ") for n in solution.warnings]
            notices = [row for lines in texts for row in ((), *lines)]
            return "Verdict in full", (), [*_verdict(facts, width), *notices]
        shown = [table for ident in TABLES if (table := facts.table(ident)) is not None]
        table = [joint_table(subject), *shown][page - 1]
        head, body = table_spans(table)
        note = [(), *wrapped(f" {table.note}", width, "dim", " ")] if table.note else []
        return table.title, head, [*body, *note]


class ResultsView(StepView):
    """View of step 6: verdict on top, parameters and plots below."""

    PANELS = ({"parameters": _ParametersPanel}, {"results-plot": ResultsPlot})
    MAIN = "parameters"
    VIEWS = (("verdict", "parameters"), ("results-plot",))

    def compose(self) -> ComposeResult:
        """Lay out the verdict over the whole width, parameters and plots below."""
        yield VerdictPanel(id="verdict").add_class("panel")
        yield from super().compose()

    def set_compact(self, compact: bool) -> None:  # noqa: FBT001 - one meaning only
        """Use the layout of a small or a large terminal."""
        self.plots.framed = not compact
        super().set_compact(compact)

    @property
    def plots(self) -> ResultsPlot:
        """Panel of plots, texts and tables."""
        return self.query_one("#results-plot", ResultsPlot)

    @property
    def main(self) -> ListPanel:
        """The parameters; while they are hidden, the panel beside them, whose text or table then scrolls."""
        return super().main if self.query_one(".left").display else self.plots

    def show(self, s: SessionSnapshot) -> None:
        """Update the number of plot pages, then show a snapshot."""
        self.plots.count_pages(s)
        super().show(s)

    def next_view(self) -> None:
        """Show the next page of plots; a small terminal shows the parameter table before the first page."""
        plots = self.plots
        if self.compact and self.view == 0:
            plots.turn_to(0)
            super().next_view()
            return
        plots.turn_to(plots.page + 1)
        if self.compact and plots.page == 0:
            super().next_view()
        self._apply_view()

    def _apply_view(self) -> None:
        super()._apply_view()
        if not self.compact:
            # Text and tables need the whole width.
            self.query_one(".left").display = self.plots.page == 0

    @property
    def place(self) -> tuple[int, int]:
        """Number of the current view (the table first, then the plots), and number of views."""
        return (1 if self.view == 0 else 2 + self.plots.page), 1 + self.plots.count
