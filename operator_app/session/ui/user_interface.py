"""What an action is, and what it may ask of the face it was chosen in: full screen or prompts. Knows neither.

A face answers questions and moves from step to step; it decides nothing. Guards are asked when an
action is chosen, and again when a question about it has been answered.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from pathlib import Path
from typing import Protocol

from operator_app.session.ui.guards import Missing
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.snapshot import DataState, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step

LOOKS = 4
"""A busy machine shows data for a moment as older than they may be: no reason to have a key pressed twice."""

# -- questions -------------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class YesNo:
    """Whether to go on; `yes` is the word for it."""

    title: str
    text: str
    yes: str


@dataclass(frozen=True, slots=True, kw_only=True)
class Typed:
    """A line of text, `value` to begin with; with `expected`, only that text is taken."""

    title: str
    text: str
    expected: str = ""
    value: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class OneOf:
    """One of several: names and how they read."""

    title: str
    text: str
    options: tuple[tuple[str, str], ...]


Question = YesNo | Typed | OneOf


@dataclass(frozen=True, slots=True, kw_only=True)
class ShownAlarm:
    """Number of an alarm that the operator has before him, and whether all its words are."""

    number: int
    whole: bool


# -- faces -----------------------------------------------------------------------------------------


class Face(Protocol):
    """Where an operator chooses actions."""

    @property
    def runner(self) -> Runner | None:
        """What runs the session; None before there is one."""
        ...

    @property
    def sessions(self) -> Sessions:
        """The sessions there are."""
        ...

    def look(self) -> SessionSnapshot | None:
        """Take a fresh picture: a decision is never made on an old one."""
        ...

    def soon(self, work: Callable[[], None]) -> None:
        """Do it when data that are late may have come: a SYNC or some later."""
        ...

    def refuse(self, why: str) -> None:
        """Say why something is not done."""
        ...

    def ask(self, question: Question, then: Callable[[str], None]) -> None:
        """Ask; `then` gets the answer, and is not called when there is none."""
        ...

    def pose(self, s: SessionSnapshot) -> int | None:
        """Number of the pose that is meant."""
        ...

    def item(self, s: SessionSnapshot) -> int | None:
        """Item of the check list that is meant, from 0."""
        ...

    def alarm(self, s: SessionSnapshot) -> ShownAlarm | None:
        """The alarm that is meant: one that the operator can see."""
        ...

    def open(self, make: Callable[[], Runner]) -> None:
        """Take another session; the one before is closed, the arm held."""
        ...

    def write_report(self, runner: Runner) -> Path:
        """Write the report page; on the worker's thread."""
        ...

    def topics(self) -> Mapping[str, str]:
        """Pages of the manual, and what each is in a line."""
        ...

    def show_page(self, topic: str) -> None:
        """Show a page of the manual."""
        ...

    def show_history(self, serial: str) -> None:
        """Show what is known of an arm over the years."""
        ...


class FullScreen(Face, Protocol):
    """A face with a screen: something is focused, something is marked."""

    def stop(self) -> None:
        """Software STOP, from the calling thread, at once."""
        ...

    def do_next_thing(self) -> None:
        """Do what the line above the footer says."""
        ...

    def go(self, step: Step) -> bool:
        """Show a step, if it is open."""
        ...

    def go_by(self, steps: int) -> None:
        """Show the step before or after."""
        ...

    def move(self, by: int) -> None:
        """Move the mark of the list."""
        ...

    def joint(self) -> int:
        """Number of the marked joint."""
        ...

    def marked_item(self) -> int:
        """Marked item of the check list, from 0, ticked or not."""
        ...

    def turn_over(self) -> None:
        """Show the next panel or plot."""
        ...

    def explain(self) -> None:
        """Explain the focused panel and list the keys."""
        ...

    def find(self) -> None:
        """Find an action by name."""
        ...

    def show_messages(self) -> None:
        """Show all that was said, each message whole."""
        ...

    def change_look(self) -> None:
        """Take the next theme."""
        ...

    def leave(self) -> None:
        """Leave, after a question if an arm is connected."""
        ...


# -- actions ---------------------------------------------------------------------------------------

EVERYWHERE = frozenset(Step)


def always(s: SessionSnapshot) -> Missing:
    """Nothing is missing, ever."""
    del s
    return ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Entry:
    """What every action has.

    Attributes
    ----------
    name
        What code calls it.
    keys, shown
        Key names as a terminal gives them, and how they are printed.
    label, help
        One or two words for the footer; a sentence for palette and help.
    steps, footer
        Where its keys work; where the footer shows them.
    offered
        Whether it means anything now: what is not offered is not shown, what is closed says why.
    """

    name: str
    keys: tuple[str, ...]
    shown: str
    label: str
    help: str
    steps: frozenset[Step] = EVERYWHERE
    footer: frozenset[Step] = frozenset()
    offered: Callable[[SessionSnapshot], bool] = lambda _: True


@dataclass(frozen=True, slots=True, kw_only=True)
class OnScreen(Entry):
    """Something that only a screen has: marks, views, themes, and going from step to step by keys."""

    work: Callable[[FullScreen], None]


@dataclass(frozen=True, slots=True, kw_only=True)
class Action(Entry):
    """Something the operator can do to the session, in both faces.

    Attributes
    ----------
    guard
        Sentences saying what is missing; asked again after every question.
    work
        Hands work to the worker, changes a setting, or takes another session.
    prompt
        What plain mode lists; by default label and help.
    rows
        Plain mode lists it once for each of these rows, which is then the one that is meant.
    """

    work: Callable[[Chosen], None]
    guard: Callable[[SessionSnapshot], Missing] = always
    prompt: str | Callable[[SessionSnapshot], str] = ""
    rows: Callable[[SessionSnapshot], Mapping[int, str]] | None = None

    def words(self, s: SessionSnapshot) -> str:
        """What plain mode lists."""
        if callable(self.prompt):
            return self.prompt(s)
        return self.prompt or f"{self.label}: {self.help.rstrip('.')}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Chosen:
    """An action that was chosen and whose guard holds: where, and on which picture."""

    action: Action
    face: Face
    runner: Runner
    s: SessionSnapshot

    def hand(self, kind: TaskKind, text: str, work: Callable[[Operations], None]) -> None:
        """Give work to the worker; returns at once."""
        self.runner.submit(kind, text, lambda: work(self.runner.operations))

    def ask(self, question: Question, then: Callable[[Chosen, str], None]) -> None:
        """Ask first; the guard must hold when the answer comes, too."""
        self.face.ask(
            question,
            lambda said: perform(self.action, self.face, lambda chosen: then(chosen, said)),
        )


def perform(
    action: Action,
    face: Face,
    work: Callable[[Chosen], None] | None = None,
    *,
    looks: int = LOOKS,
) -> None:
    """Do an action, or say what is missing; what only waits for fresh data is looked at `looks` times."""
    s, runner = face.look(), face.runner
    if s is None or runner is None:
        return
    missing = action.guard(s)
    late = s.data is DataState.STALE and not action.guard(replace(s, data=DataState.FRESH))
    if missing and late and looks > 1:
        face.soon(lambda: perform(action, face, work, looks=looks - 1))
        return
    if missing:
        face.refuse(missing[0])
    else:
        (work or action.work)(Chosen(action=action, face=face, runner=runner, s=s))
