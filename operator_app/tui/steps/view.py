"""Base class of the steps' screens: panels, of which a small terminal shows some at a time, and a main list."""

from collections.abc import Callable, Iterator, Mapping
from typing import ClassVar

from textual.app import ComposeResult
from textual.containers import Container, Horizontal, Vertical

from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.tui.lines import Lines
from operator_app.tui.widgets.list_panel import ListPanel


class StepView(Container):
    """Panels of one step.

    `PANELS`: panels by name, in one column or in a left and a right column. `VIEWS`: groups of panels that a
    small terminal shows together; `v` shows the next group. `MAIN`: name of the panel whose rows the arrow keys mark.
    """

    PANELS: ClassVar[tuple[Mapping[str, Callable[..., Lines]], ...]]
    VIEWS: ClassVar[tuple[tuple[str, ...], ...]] = ()
    MAIN: ClassVar[str] = ""

    def __init__(self, step: Step) -> None:
        super().__init__(id=f"step-{int(step)}", classes="step")
        self.view = 0
        self.compact = False

    def compose(self) -> ComposeResult:
        """Lay out the panels."""
        if len(self.PANELS) == 1:
            yield from _made(self.PANELS[0])
            return
        with Horizontal():
            for side, column in zip(("left", "right"), self.PANELS, strict=True):
                with Vertical(classes=side):
                    yield from _made(column)

    def show(self, s: SessionSnapshot) -> None:
        """Show a snapshot in every panel that is visible."""
        for panel in self.walk_children(Lines):
            if panel.display:
                panel.show(s)

    def set_compact(self, compact: bool) -> None:  # noqa: FBT001 - one meaning only
        """Use the layout for a small or a large terminal."""
        self.compact = compact
        self._apply_view()

    def next_view(self) -> None:
        """On a small terminal, show the next group of `VIEWS`."""
        if self.compact and self.VIEWS:
            self.view = (self.view + 1) % len(self.VIEWS)
            self._apply_view()

    @property
    def place(self) -> tuple[int, int]:
        """Number (from 1) of the view that a small terminal shows, and number of views."""
        return self.view + 1, max(1, len(self.VIEWS))

    @property
    def main(self) -> ListPanel:
        """The list whose rows the arrow keys mark."""
        return self.query_one(f"#{self.MAIN}", ListPanel)

    def move(self, by: int) -> None:
        """Move the mark in the main list by `by` rows, or scroll the list."""
        if self.MAIN:
            self.main.move(by)

    def _apply_view(self) -> None:
        shown = {name for group in self.VIEWS for name in group}
        visible = set(self.VIEWS[self.view]) if self.compact and self.VIEWS else shown
        for panel in self.query(Lines):
            if panel.id in shown:
                panel.display = panel.id in visible
        for column in self.query(".left, .right"):
            column.display = any(panel.display for panel in column.query(Lines))


def _made(panels: Mapping[str, Callable[..., Lines]]) -> Iterator[Lines]:
    for name, make in panels.items():
        yield make(id=name).add_class("panel")
