"""Actions, and the interface that the terminal app and plain mode implement for them.

The guard of an action is checked when the action is chosen, and again when its question is answered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from collections.abc import Set as AbstractSet
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from operator_app.session.ui.guards import Guard
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.snapshot import DataState, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step

SNAPSHOTS_TRIED = 4
"""Number of snapshots tried before an action is refused because of stale data, which are often fresh again soon."""

# -- questions -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class Titled:
    """Title and text of a dialog."""

    title: str
    text: str


@dataclass(frozen=True, slots=True, kw_only=True)
class YesNo(Titled):
    """A request for confirmation; `yes` and `no` are the labels of the buttons."""

    yes: str
    no: str = "Cancel"


@dataclass(frozen=True, slots=True, kw_only=True)
class Typed(Titled):
    """A request for a line of text, initially `value`; if `expected` is set, only that text is accepted."""

    expected: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class OneOf(Titled):
    """A request to choose one of the `options`, each a name and a label."""

    options: tuple[tuple[str, str], ...]


Question = YesNo | Typed | OneOf


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownAlarm:
    """Number of the alarm on the screen, and whether its whole text is visible."""

    number: int
    all_visible: bool


# -- user interfaces -------------------------------------------------------------------------------


class UserInterface(Protocol):
    """The methods of a user interface that actions call; implemented by the terminal app and by plain mode."""

    @property
    def runner(self) -> Runner:
        """The runner of the open session."""

    @property
    def sessions(self) -> Sessions:
        """The object that opens and closes sessions."""

    def snapshot(self) -> SessionSnapshot:
        """Return a new snapshot."""

    def retry_soon(self, work: Callable[[], None]) -> None:
        """Call `work` a few SYNC periods later."""

    def refuse(self, reason: str) -> None:
        """Show why an action is refused."""

    def ask(self, question: Question, then: Callable[[str], None]) -> None:
        """Ask a question and, unless it is cancelled, call `then` with the answer."""

    def pose(self, s: SessionSnapshot) -> int | None:
        """Return the number of the selected pose; None if no pose is selected."""

    def item(self, s: SessionSnapshot) -> int | None:
        """Return the index (from 0) of the item to tick: the selected item, else the first unticked item, else None."""

    def alarm(self, s: SessionSnapshot) -> ShownAlarm | None:
        """Return the alarm that is shown; None if no alarm is shown."""

    def open(self, make: Callable[[], Runner]) -> None:
        """Open another session by calling `make`, which returns its runner."""

    def write_report(self, runner: Runner) -> Path:
        """Write the report page and return its path; called in the worker thread."""

    def topics(self) -> Mapping[str, str]:
        """Return the topics of the manual, with their summaries."""

    def show_page(self, topic: str) -> None:
        """Show a page of the manual."""

    def show_history(self, serial: str) -> None:
        """Show the history of the arm with this serial number."""


# -- actions ---------------------------------------------------------------------------------------

EVERYWHERE = frozenset(Step)


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """Common fields of all actions.

    `keys`: names of the keys as the terminal reports them. `shown`: display text of the keys.
    `label`: one or two words for the footer. `help`: a sentence for palette and help.
    `steps`: steps at which the keys work. `footer`: steps at which the footer shows the keys.
    `offered`: returns whether the action is listed. An action that its guard refuses is listed with the reason.
    """

    name: str
    keys: tuple[str, ...]
    shown: str
    label: str
    help: str
    steps: AbstractSet[Step] = EVERYWHERE
    footer: AbstractSet[Step] = frozenset()
    offered: Callable[[SessionSnapshot], bool] = lambda _: True


@dataclass(frozen=True, slots=True, kw_only=True)
class OnScreen(Entry):
    """An action of the terminal app only: selection, views, themes, steps."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Action(Entry):
    """An action on the session, in all user interfaces.

    `guard`: returns why the action is refused, "" if it is allowed; also called when a question is answered.
    `work`: submits a task, changes a setting, or opens another session.
    `prompt`: text in plain mode; by default, label and help.
    `rows`: for an action on one of several items; returns the prompt of each item in plain mode, by item number.
    """

    work: Callable[[ActionContext], None]
    guard: Guard = lambda _: ""
    prompt: str | Callable[[SessionSnapshot], str] = ""
    rows: Callable[[SessionSnapshot], Mapping[int, str]] | None = None

    def words(self, s: SessionSnapshot) -> str:
        """Return the prompt of the action in plain mode."""
        if callable(self.prompt):
            return self.prompt(s)
        return self.prompt or f"{self.label}: {self.help.rstrip('.')}"


@dataclass(frozen=True, slots=True, kw_only=True)
class ActionContext:
    """A chosen action that its guard allows, with its user interface, runner and snapshot."""

    action: Action
    interface: UserInterface
    runner: Runner
    s: SessionSnapshot

    def submit(self, kind: TaskKind, work: Callable[[Operations], None], text: str = "") -> None:
        """Submit a task to the runner without waiting for it; `text` describes the task (by default, as its kind)."""
        self.runner.submit(kind, text or kind.value, lambda: work(self.runner.operations))

    def ask(self, question: Question, then: Callable[[ActionContext, str], None]) -> None:
        """Ask a question; `then` is called with the answer, if the guard still allows the action."""
        self.interface.ask(
            question,
            lambda answer: perform_action(
                self.action, self.interface, lambda chosen: then(chosen, answer)
            ),
        )

    def confirm(
        self, title: str, text: str, yes: str, then: Callable[[ActionContext], None]
    ) -> None:
        """Ask for confirmation, with button `yes`, then call `then` if the guard still allows the action."""
        self.ask(YesNo(title=title, text=text, yes=yes), lambda again, _: then(again))


def perform_action(
    action: Action,
    interface: UserInterface,
    work: Callable[[ActionContext], None] | None = None,
    *,
    tries: int = SNAPSHOTS_TRIED,
) -> None:
    """Do `work` (default: `action.work`) or show why not; if only stale data prevent it, try up to `tries` times."""
    s, runner = interface.snapshot(), interface.runner
    missing = action.guard(s)
    late = s.data is DataState.STALE and not action.guard(replace(s, data=DataState.FRESH))
    if missing and late and tries > 1:
        interface.retry_soon(lambda: perform_action(action, interface, work, tries=tries - 1))
        return
    if missing:
        interface.refuse(missing)
    else:
        (work or action.work)(ActionContext(action=action, interface=interface, runner=runner, s=s))
