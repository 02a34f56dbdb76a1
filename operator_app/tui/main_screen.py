"""The main screen: safety strip, banner, list of steps, current step, next action, messages, keys."""

from collections.abc import Sequence

from textual import events
from textual.app import ComposeResult
from textual.containers import Horizontal
from textual.screen import Screen
from textual.widgets import ContentSwitcher

from operator_app.calibration.acceptance import Verdict
from operator_app.report.spans import Line, Span, cut, length, line, wrapped
from operator_app.session.ui import action_table
from operator_app.session.ui.guards import missing_for, stops_on_any_key
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.tui.lines import Lines, app_of
from operator_app.tui.steps.calibrate import CalibrateView
from operator_app.tui.steps.capture import CaptureView
from operator_app.tui.steps.connect import ConnectView
from operator_app.tui.steps.export import ExportView
from operator_app.tui.steps.fixture import FixtureView
from operator_app.tui.steps.modes import ModesView
from operator_app.tui.steps.results import ResultsView
from operator_app.tui.steps.view import StepView
from operator_app.tui.theme import SMALLEST_TERMINAL, is_compact
from operator_app.tui.widgets.status import Banner, Log, SafetyStrip


def done(step: Step, s: SessionSnapshot) -> bool:
    """Whether a step is done: Capture has enough poses, Export has a written file, others allow the step after them."""
    if step is Step.EXPORT:
        return s.written is not None
    if step is Step.RESULTS:
        return s.solution is not None and not missing_for(Step.EXPORT, s)
    if step is Step.CAPTURE:
        return len(s.state.used_poses) >= s.required_poses
    return not missing_for(Step(step + 1), s)


def detail(step: Step, s: SessionSnapshot) -> str:
    """Return a summary of a step, in a word or two."""
    match step:
        case Step.CONNECT:
            return s.identity.serial_number if s.identity else "not connected"
        case Step.FIXTURE:
            unticked = len(s.procedure.fixture.checklist) - len(s.ticked)
            return f"{unticked} to tick" if unticked else s.procedure.fixture.kind
        case Step.MODES:
            joints = s.state.position_joints
            if not joints:
                return "not set"
            if len(joints) == len(s.state.modes):
                return "all held"
            if not s.drives_ready:
                return "apply again"
            # With more than three joints, the verb does not fit.
            verb = {1: " drives", 2: " drive", 3: " drive"}.get(len(joints), "")
            return f"J{' J'.join(map(str, joints))}{verb}"
        case Step.CAPTURE:
            return f"{len(s.state.used_poses)}/{s.required_poses} poses"
        case Step.CALIBRATE:
            # From the journal, so that a resumed session shows it before the arm is connected.
            return str(s.state.solved.get("estimator", "not run"))
        case Step.RESULTS:
            if not s.state.solved:
                return "—"
            if s.solution is not None and s.solution.verdict is Verdict.WITH_WARNINGS:
                return "with warnings"
            return "accepted" if s.state.solved.get("accepted") else "NOT accepted"
        case Step.EXPORT:
            if s.receipt is not None:
                return "uploaded"
            return "written" if s.written else "—"


class _StepRail(Lines, can_focus=False):
    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        rows: list[Line] = []
        for step in Step:
            role = "dim" if missing_for(step, s) else "text"
            role = "accent" if step is app_of(self).step else role
            title = f" {self._glyph(step, s)} {int(step)} {step.title}"
            for text, own in ((title, role), (f"    {detail(step, s)}", "dim"), ("", "dim")):
                rows.append(line((f"{text[: width - 1]:<{width}}", f"{own} @step_{int(step)}")))
        return rows

    def _glyph(self, step: Step, s: SessionSnapshot) -> str:
        return "▶" if step is app_of(self).step else "✓" if done(step, s) else "·"


class _StepRow(_StepRail, can_focus=False):
    place = (1, 1)

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        row: list[Span] = []
        for step in Step:
            is_current = step is app_of(self).step
            title = f"{step.title} " if is_current else ""
            text = f" {self._glyph(step, s)}{int(step)} {title}"
            row.append((text, f"{'accent' if is_current else 'dim'} @step_{int(step)}"))
        row.append((f"  {detail(app_of(self).step, s)}", "dim"))
        view, count = self.place
        if count > 1:
            row += [("   v", "key @view"), (f" view {view}/{count}", "dim @view")]
        return [tuple(row)]


SELDOM = 4
"""Panels outside the step's view are updated with every fourth snapshot, or immediately after an important change."""
HINT_ROWS, MOST_HINT_ROWS = 2, 4
"""Usual number of rows for the next action, and largest number if a refusal is long; the log gets the unused rows."""
VIEWS = (ConnectView, FixtureView, ModesView, CaptureView, CalibrateView, ResultsView, ExportView)


class _Hint(Lines, can_focus=False):
    refusal = ""

    def rows_for(self, s: SessionSnapshot, width: int) -> int:
        return min(len(self._rows(s, width)), MOST_HINT_ROWS)

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        if self.app.screen is not self.screen:
            return []
        return cut(self._rows(s, width), width, height, " …")

    def _rows(self, s: SessionSnapshot, width: int) -> list[Line]:
        if self.refusal:
            return wrapped(f" ▲ {self.refusal}", width - 1, "warn", "   ")
        hint_text = f" Next {next_action(app_of(self).step, s).hint}"
        head, *rest = wrapped(hint_text, width - 1, "text", " " * 6)
        text = head[0][0]
        return [line((text[:6], "bold"), text[6:]), *rest]


class Footer(Lines, can_focus=False):
    """The keys of the step, at most six: STOP first, then the next action."""

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        row: list[Span] = [(" ", "text")]
        if self.app.screen is not self.screen:
            # In a dialog the keys of the step do not apply.
            return [line((" F8", "key"), " STOP  ", ("Esc", "key"), " cancels")]
        if stops_on_any_key(s.task):
            return [
                line((" SPACE/F8", "key"), " STOP  ", ("any other key", "key"), " ends the motion")
            ]
        if isinstance(self.screen, MainScreen) and self.screen.is_small:
            return [line((" SPACE/F8", "key"), " STOP  ", ("q", "key"), " Quit")]
        for action in action_table.footer(app_of(self).step):
            shown, label = action.shown, action.label
            if action.name == "primary":
                label = next_action(app_of(self).step, s).label
            if not label or not action.offered(s):
                continue
            if length(tuple(row)) + len(shown) + 1 + len(label) > width:
                break
            clicked = f"@{action.name}"
            row += [(shown, f"key {clicked}"), (f" {label}", f"text {clicked}"), ("  ", "text")]
        return [tuple(row)]


class _TooSmall(Lines, can_focus=False):
    def show_size(self, width: int, height: int) -> None:
        columns, rows = SMALLEST_TERMINAL
        text = (
            f"sarcal needs {columns} x {rows} characters; this window has {width} x {height}. Enlarge the window or "
            "reduce its font. Until then only STOP and q work, and any key ends a motion."
        )
        self.show_lines([(), *wrapped(text, width)])


class MainScreen(Screen[None]):
    """Everything on the screen except dialogs."""

    AUTO_FOCUS = ""

    def __init__(self) -> None:
        super().__init__()
        self.hint, self.footer = _Hint(id="hint"), Footer(id="footer")
        self.rails = (_StepRow(id="row"), _StepRail(id="rail"))
        self.strip, self.banner = SafetyStrip(id="strip"), Banner(id="banner")
        self.log_lines = Log(id="log")
        self.steps = tuple(view(step) for step, view in zip(Step, VIEWS, strict=True))
        self.too_small = _TooSmall(id="too-small")
        self.frame: tuple[Lines, ...] = (
            self.strip, self.banner, *self.rails, self.hint, self.log_lines, self.footer,
        )  # fmt: skip
        self._shows = 0
        self._shown_news: object = None
        self._rows = (0, 0)

    def compose(self) -> ComposeResult:
        """Compose the widgets from top to bottom."""
        yield self.strip
        yield self.banner
        yield self.rails[0]
        with Horizontal(id="middle"):
            yield self.rails[1]
            with ContentSwitcher(id="body", initial="step-1"):
                yield from self.steps
        yield self.too_small
        yield self.hint
        yield self.log_lines
        yield self.footer

    @property
    def is_small(self) -> bool:
        """Whether the window is too small to show the step."""
        return self.has_class("-small")

    @property
    def view(self) -> StepView:
        """View of the step on the screen."""
        return self.steps[app_of(self).step - 1]

    def go_to(self, step: Step) -> None:
        """Show a step, with no widget in focus."""
        self.query_one(ContentSwitcher).current = f"step-{int(step)}"
        self.set_focus(None)
        app_of(self).step = step

    def refuse(self, sentence: str) -> None:
        """Show why something was refused; an empty string removes the text."""
        self.hint.refusal = sentence

    def show(self, s: SessionSnapshot) -> None:
        """Show a snapshot."""
        self._shows += 1
        self._make_room(s)
        self.view.show(s)
        self.rails[0].place = self.view.place
        news = self._shown_at_once(s)
        if news != self._shown_news or self._shows % SELDOM == 0:
            self._shown_news = news
            for widget in self.frame:
                if widget.display:
                    widget.show(s)

    def _make_room(self, s: SessionSnapshot) -> None:
        """Set the heights of the next action and of the log, which shows the newest alarm.

        Rows that the next action does not need go to the log, so that nothing else moves. An alarm gets at most a third
        of the screen, so that the joints stay visible.
        """
        width, height = self.size
        hint = self.hint.rows_for(s, width)
        log = 1 if is_compact(width, height) else 2
        if s.alarms:
            log = self.log_lines.rows_for(s, width, height // 3 - 1)
        rows = hint, max(1, log + HINT_ROWS - hint)
        if rows != self._rows:
            self._rows = rows
            self.hint.styles.height, self.log_lines.styles.height = rows
            self.call_after_refresh(self.repaint)

    def _shown_at_once(self, s: SessionSnapshot) -> object:
        """Return the values whose changes are shown at once. Ages and rates, which always change, are left out."""
        joints = () if s.arm is None else tuple((j.mode, j.drive) for j in s.arm.joints)
        latest = s.messages[-1].number if s.messages else 0
        return (
            s.data, s.stale_joints, s.stopped, s.stop, s.connected, s.simulated, joints, s.task, latest,
            tuple(alarm.number for alarm in s.alarms),
            s.ticked, s.stop_tested, s.estimator, s.checks, id(s.state), id(s.solution), id(s.written),
            id(s.receipt), id(s.plan), self.hint.refusal, s.selected_joints, app_of(self).step, self.size,
            self.rails[0].place, self.app.screen is self,
        )  # fmt: skip

    def repaint(self) -> None:
        """Repaint all panels, after a change of theme or layout."""
        for panel in self.query(Lines):
            panel.refresh()

    def on_resize(self, event: events.Resize) -> None:
        """Use the layout for this size."""
        width, height = event.size
        compact = is_compact(width, height)
        self.set_class(compact, "-compact")
        self.set_class(width < SMALLEST_TERMINAL[0] or height < SMALLEST_TERMINAL[1], "-small")
        for view in self.steps:
            view.set_compact(compact)
        self.too_small.show_size(width, height)
        # A frame may have appeared or disappeared without a change of the panel's outer size.
        self.call_after_refresh(self.repaint)
