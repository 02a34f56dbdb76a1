"""Plain mode: the workflow as numbered prompts in whole lines, for screen readers and simple terminals."""

import select
import sys
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from functools import partial
from pathlib import Path

from operator_app.documents import arm_history
from operator_app.headless.plain_messages import describe, results
from operator_app.manual.pages import Manual
from operator_app.manual.shown import as_text
from operator_app.messages.errors import EXPECTED, words
from operator_app.report.results.history import history_text
from operator_app.safe_output import lines, sanitized, say
from operator_app.session.ui import action_table, guards, user_interface
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.snapshot import DataState, SessionSnapshot
from operator_app.session.ui.steps import Step

WAIT_S = 0.1
PAGE_WIDTH = 80


class Terminal:
    """Reads lines from standard input and writes lines to standard output."""

    def say(self, text: str) -> None:
        """Write `text` to standard output and flush the stream."""
        say(text)
        sys.stdout.flush()

    def ask(self, prompt: str) -> str:
        """Write a prompt and return the typed line; raises EOFError at the end of the input."""
        return input(sanitized(prompt))

    def touched(self, timeout_s: float) -> bool:
        """Wait up to `timeout_s` for Enter, and return whether it was pressed; input from a pipe does not count."""
        inputs = [sys.stdin] if sys.stdin.isatty() else []
        ready, _, _ = select.select(inputs, [], [], timeout_s)
        return bool(ready) and bool(sys.stdin.readline())


@dataclass(frozen=True, slots=True, kw_only=True)
class _Item:
    label: str
    do: Callable[[], None]
    missing: str = ""


class Plain:
    """The seven steps as menus; implements `UserInterface`."""

    def __init__(
        self,
        sessions: Sessions,
        terminal: Terminal,
        *,
        resume: str | None = None,
        pause: Callable[[float], None] = time.sleep,
        manual: Manual | None = None,
    ) -> None:
        self.sessions = sessions
        self._terminal, self._pause = terminal, pause
        self._manual = manual or Manual()
        self._step = Step.CONNECT
        self._row: int | None = None
        self._heard = 0
        self._left = False
        self.runner: Runner = sessions.new() if resume is None else sessions.resumed(resume)

    def run(self) -> str:
        """Show menus until the operator quits or the input ends; return ``left`` or ``end of input``.

        Ctrl-C sends STOP. If no arm is connected, or joint data are lost, Ctrl-C raises KeyboardInterrupt instead.
        """
        self._terminal.say(
            "sarcal, plain mode. Type a number and Enter. While the arm moves, Enter stops it; "
            "Ctrl-C is the software STOP. It is not an emergency stop."
        )
        while not self._left:
            try:
                self._menu()
            except EOFError:
                return "end of input"
            except KeyboardInterrupt:
                if not self._stop():
                    raise
        return "left"

    def _menu(self) -> None:
        self._wait()  # a cancelled task may still run: no item could be chosen
        s = self.snapshot()
        self._terminal.say("\n" + lines(describe(self._step, s)))
        chosen = self._one_of(self._items(s), "Number: ")
        if chosen is not None:
            if chosen.missing:
                self.refuse(chosen.missing)
            else:
                chosen.do()

    def _one_of(self, items: list[_Item], prompt: str) -> _Item | None:
        numbered = {str(number): item for number, item in enumerate(items, 1)}
        for number, item in numbered.items():
            closed = f" (closed: {item.missing})" if item.missing else ""
            self._terminal.say(sanitized(f"  {number} {item.label}{closed}"))
        typed = self._terminal.ask(prompt).strip()
        if typed in numbered:
            return numbered[typed]
        self._terminal.say(f"There is no {typed[:40]!r}: type a number from 1 to {len(items)}.")
        return None

    def _items(self, s: SessionSnapshot) -> list[_Item]:
        own, common = action_table.prompts(self._step)
        items = [item for action in own for item in self._lines(action, s)]
        if self._step is Step.RESULTS:
            items.append(
                _Item(
                    label="Read the results",
                    do=lambda: self._terminal.say(lines(results(self.snapshot()))),
                    missing=guards.results_ready(s),
                )
            )
        if self._step is not Step.EXPORT:
            following = Step(self._step + 1)
            label = f"Go on to step {int(following)}, {following.title}"
            missing = guards.missing_for(following, s)
            items.append(_Item(label=label, do=partial(self._go, following), missing=missing))
        if self._step is not Step.CONNECT:
            before = Step(self._step - 1)
            items.append(_Item(label=f"Back to {before.title}", do=partial(self._go, before)))
        items += [item for action in common for item in self._lines(action, s)]
        held = "the arm is held, " if s.connected else ""
        items.append(_Item(label=f"Quit: {held}the session is kept", do=self._leave))
        return items

    def _lines(self, action: user_interface.Action, s: SessionSnapshot) -> list[_Item]:
        if not action.offered(s):
            return []
        rows = {None: action.words(s)} if action.rows is None else action.rows(s)
        missing = action.guard(s)
        return [
            _Item(label=label, do=partial(self._do, action, row), missing=missing)
            for row, label in rows.items()
        ]

    def _do(self, action: user_interface.Action, row: int | None) -> None:
        self._row = row
        user_interface.perform_action(action, self)

    def _go(self, step: Step) -> None:
        self._step = step

    def _leave(self) -> None:
        self._left = True

    # -- UserInterface -----------------------------------------------------------------------------

    def snapshot(self) -> SessionSnapshot:
        """Return a fresh snapshot; write the new messages."""
        s = self.runner.snapshot()
        if self.runner.defect is not None:
            raise RuntimeError("the session's worker thread failed") from self.runner.defect
        for message in s.messages:
            if message.number > self._heard:
                self._heard = message.number
                self._terminal.say(
                    sanitized(f"[{message.time} {message.level.value}] {message.text}")
                )
        return s

    def retry_soon(self, work: Callable[[], None]) -> None:
        """Wait 0.1 s, then call `work`."""
        self._pause(0.1)
        work()

    def refuse(self, reason: str) -> None:
        """Write why an action is refused."""
        self._terminal.say(sanitized(f"Not done: {reason}."))

    def ask(self, question: user_interface.Question, then: Callable[[str], None]) -> None:
        """Ask for yes (`YesNo`), text (`Typed`) or an option's number (`OneOf`); call `then` if the answer is valid."""
        match question:
            case user_interface.YesNo():
                *rows, last = question.text.splitlines()
                if rows:
                    self._terminal.say(lines(rows))
                typed = self._terminal.ask(f"{last} Type yes to go on: ").strip()
                if typed.lower() == "yes":
                    then("yes")
                else:
                    self.refuse("the answer was not yes")
            case user_interface.Typed():
                typed = self._terminal.ask(f"{question.text} ").strip()
                if question.expected and typed != question.expected:
                    self.refuse(f"the answer was not {question.expected}; nothing was uploaded")
                else:
                    then(typed)
            case _:
                self._terminal.say(f"{question.title} {question.text}")
                options = [
                    _Item(label=text, do=partial(then, name)) for name, text in question.options
                ]
                chosen = self._one_of([_Item(label="Cancel", do=lambda: None), *options], "Which: ")
                if chosen is not None:
                    chosen.do()

    def pose(self, s: SessionSnapshot) -> int | None:
        """Ask for the number of a pose and return it; None if there is no such pose."""
        typed = self._terminal.ask("Pose number: ").strip()
        known = {str(p.number): p.number for p in s.state.poses}
        if typed in known:
            return known[typed]
        self._terminal.say(f"There is no pose {typed[:40]!r}.")
        return None

    def item(self, s: SessionSnapshot) -> int | None:
        """Return the index of the check list item that was chosen in the menu."""
        return self._row

    def alarm(self, s: SessionSnapshot) -> user_interface.ShownAlarm | None:
        """Return the alarm that was chosen in the menu."""
        row = self._row
        return None if row is None else user_interface.ShownAlarm(number=row, all_visible=True)

    def open(self, make: Callable[[], Runner]) -> None:
        """Switch to the session that `make` opens. On failure show why, or raise the error if no session is open."""
        try:
            self.runner = make()
        except EXPECTED as error:
            if not self.sessions.is_open:
                raise
            message = words(error)
            self.refuse(f"{message.happened}. {message.remedy}")
            return
        self._step, self._heard = Step.CONNECT, 0

    def write_report(self, runner: Runner) -> Path:
        """Write the report page and return its path."""
        from operator_app.report.html.page import write_report

        return write_report(runner.session)

    def topics(self) -> Mapping[str, str]:
        """Return the summaries of the manual's pages, by topic."""
        return self._manual.topics

    def show_page(self, topic: str) -> None:
        """Write a page of the manual."""
        self._terminal.say(as_text(self._manual.page(topic), PAGE_WIDTH))

    def show_history(self, serial: str) -> None:
        """Write the history of the arm with this serial number."""
        try:
            history = arm_history(serial, self.sessions.root)
        except EXPECTED as error:
            self.refuse(words(error).happened)
        else:
            self._terminal.say(history_text(history))

    def _wait(self) -> None:
        """Wait until no task is running; Enter cancels a task that may move the arm."""
        s = self.snapshot()
        if s.task is not None and guards.stops_on_any_key(s.task) and not s.task.ending:
            self._terminal.say(f"{s.task.kind.value}: press Enter to stop it.")
        while s.task is not None:
            if not guards.stops_on_any_key(s.task):
                self._pause(WAIT_S)
            elif self._terminal.touched(WAIT_S):
                self.runner.cancel()
            s = self.snapshot()

    def _stop(self) -> bool:
        """Send STOP and return True; if no arm is connected, or joint data are lost, only return False."""
        s = self.runner.snapshot()
        if not s.connected or s.data is DataState.LOST:
            return False
        self.runner.stop()
        self.snapshot()
        self._terminal.say(
            "Ctrl-C sent STOP. When it is safe, choose Reset STOP; Quit ends the program."
        )
        return True
