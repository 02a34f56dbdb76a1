"""The seven steps: those that are done, decisions, and what is missing."""

from __future__ import annotations

from collections.abc import Sequence

from textual import events

from hardware.arm import JointMode
from operator_app.report.spans import Line, Span, length, line
from operator_app.session.ui.guards import missing_for
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.tui.lines import Clicked, Lines


def done(step: Step, s: SessionSnapshot) -> bool:
    """Whether a step is done, so that the next one is open."""
    if step is Step.EXPORT:
        return s.written is not None
    if step is Step.RESULTS:
        return s.solution is not None and not missing_for(Step.EXPORT, s)
    if step is Step.CAPTURE:
        return len(s.state.used_poses) >= s.wanted_poses
    return not missing_for(Step(step + 1), s)


def detail(step: Step, s: SessionSnapshot) -> str:
    """Return the decision of a step in a word or two."""
    match step:
        case Step.CONNECT:
            return s.identity.serial_number if s.identity else "not connected"
        case Step.FIXTURE:
            left = len(s.procedure.fixture.checklist) - len(s.ticked)
            return f"{left} to tick" if left else s.procedure.fixture.kind
        case Step.MODES:
            names = [str(k) for k, m in enumerate(s.modes, 1) if m is JointMode.POSITION]
            if not names:
                return "not set"
            return "all held" if len(names) == len(s.modes) else f"J{' J'.join(names)} drive"
        case Step.CAPTURE:
            return f"{len(s.state.used_poses)}/{s.wanted_poses} poses"
        case Step.CALIBRATE:
            return s.solution.estimate.estimator if s.solution else "not run"
        case Step.RESULTS:
            if s.solution is None:
                return "—"
            return "accepted" if s.solution.accepted else "NOT accepted"
        case Step.EXPORT:
            if s.receipt is not None:
                return "uploaded"
            return "written" if s.written else "—"


class StepRail(Lines, can_focus=False):
    """Three rows a step."""

    current = Step.CONNECT

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """Glyph, number, title; below it the detail."""
        rows: list[Line] = []
        for step in Step:
            here = step is self.current
            open_ = not missing_for(step, s)
            glyph = "▶" if here else "✓" if done(step, s) else "·"
            role = "accent" if here else "text" if open_ else "dim"
            rows += [line((f" {glyph} {int(step)} {step.title}", role))]
            rows += [line((f"    {detail(step, s)}"[: width - 1], "dim")), ()]
        return rows

    def on_click(self, event: events.Click) -> None:
        """Go to the step that was clicked."""
        action = self._action_at(event.x, event.y)
        if action:
            self.post_message(Clicked(action))

    def _action_at(self, x: int, y: int) -> str:
        """Return the action of a click; a handler in a subclass would be called as well as this one."""
        number = y // 3 + 1
        return f"step_{number}" if number <= len(Step) else ""


class StepRow(StepRail, can_focus=False):
    """All steps in one row, for small terminals. `place`: number of the view, and of how many."""

    place = (1, 1)
    _view_at: int | None = None

    def build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        """Return one row; only the present step has its name."""
        row: list[Span] = []
        for step in Step:
            here = step is self.current
            glyph = "▶" if here else "✓" if done(step, s) else "·"
            text = f" {glyph}{int(step)} {step.title} " if here else f" {glyph}{int(step)} "
            row.append((text, "accent" if here else "dim"))
        row.append((f"  {detail(self.current, s)}", "dim"))
        view, count = self.place
        self._view_at = length(tuple(row)) if count > 1 else None
        if count > 1:
            row += [("   v", "key"), (f" view {view}/{count}", "dim")]
        return [tuple(row)]

    def _action_at(self, x: int, y: int) -> str:
        """A click on a number goes to its step, elsewhere to the next view; it ends no motion."""
        if self._view_at is not None and x >= self._view_at:
            return "view"
        end = 0
        for step in Step:
            end += 4 + (len(step.title) + 1 if step is self.current else 0)
            if x < end:
                return f"step_{int(step)}"
        return ""
