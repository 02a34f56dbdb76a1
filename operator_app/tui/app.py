"""The app: polls a snapshot at 20 Hz, passes keys to actions, and sends STOP straight to the arm.

All decisions about a calibration are made in `session`. Slow imports run in a thread while the first screen is shown.
"""

from __future__ import annotations

import asyncio
import contextlib
import gc
import os
import select
import signal
import sys
import threading
from collections.abc import Callable, Iterator, Mapping, Sequence
from functools import partial
from importlib import import_module
from typing import TYPE_CHECKING, Any, ClassVar

from textual import events
from textual.app import App, ComposeResult
from textual.command import DiscoveryHit, Hit, Hits, Provider
from textual.content import Content
from textual.driver import Driver
from textual.screen import Screen
from textual.scrollbar import ScrollBar, ScrollBarRender
from textual.widgets import Input

from operator_app.exit_codes import ExitCode
from operator_app.manual.pages import Manual
from operator_app.report.spans import Line, line
from operator_app.session.ui.steps import QUIT_KEYS, STOP_KEYS, Step
from operator_app.signals import ENDING, ending_signals_ignored
from operator_app.tui.driver import Pressed, watched
from operator_app.tui.lines import Lines, app_of
from operator_app.tui.theme import DARK, LIGHT, NO_COLOUR, STOP_WIDTH, Look, look, themes

if TYPE_CHECKING:
    from operator_app.session.ui.runner import Runner
    from operator_app.session.ui.sessions import Sessions
    from operator_app.session.ui.snapshot import SessionSnapshot
    from operator_app.tui.main_screen import MainScreen
    from operator_app.tui.screen_interface import ScreenInterface


class _Fixed(Lines, can_focus=False):
    """A widget whose lines do not change."""


class _StartScreen(Screen[None]):
    AUTO_FOCUS = ""
    ROWS: ClassVar[Mapping[str, Sequence[Line]]] = {
        "strip": [line((" STOP ", "badge"), (" SPACE/F8", "key"), ("  no arm yet", "dim"))],
        "banner": [line((" sarcal ", "badge"), ("  calibrating redundant arms", "dim"))],
        "middle": [(), line(" Connect: loading ...")],
        "footer": [line((" q", "key"), " Quit")],
    }
    """Lines of each widget, by its name on the main screen."""

    def compose(self) -> ComposeResult:
        for name in self.ROWS:
            yield _Fixed(id=name)

    def on_mount(self) -> None:
        for name, rows in self.ROWS.items():
            self.query_one(f"#{name}", _Fixed).show_lines(rows)


class ActionProvider(Provider):
    """Provides all actions to the command palette, which searches their labels, keys and help texts."""

    def _all(self) -> Iterator[tuple[str, dict[str, Any]]]:
        from operator_app.session.ui import action_table

        for action in action_table.ACTIONS:
            where = f" (step {int(*action.steps)})" if len(action.steps) == 1 else ""
            text = f"{action.label}{where}  [{action.shown}]"
            command = partial(app_of(self).interface.do_anywhere, action)
            yield text, {"command": command, "text": text, "help": action.help}

    async def discover(self) -> Hits:
        """Yield all actions, before anything is typed."""
        for text, shown in self._all():
            yield DiscoveryHit(Content(text), **shown)

    async def search(self, query: str) -> Hits:
        """Yield the actions whose label, key or help matches `query`."""
        matcher = self.matcher(query)
        for text, shown in self._all():
            score = matcher.match(f"{text} {shown['help']}")
            if score > 0.0:
                yield Hit(score, Content(text), **shown)


POLL_S = 1.0 / 20.0
SCREEN_TIMEOUT_S = 5.0
"""Longest time, s, that the screen may take to close after a signal."""


class AsciiScrollBar(ScrollBarRender):
    """A scroll bar made of whole character cells only, without the Unicode characters for parts of a cell."""

    VERTICAL_BARS: ClassVar = [" "] * 8
    HORIZONTAL_BARS: ClassVar = [" "] * 8


class SarcalApp(App[str]):
    """The terminal app with its seven steps; it runs until `exit` and returns the reason for leaving."""

    CSS_PATH = "sarcal.tcss"
    TITLE = "sarcal"
    COMMANDS: ClassVar = {ActionProvider}

    def __init__(
        self,
        make_source: Callable[[], Sessions],
        *,
        theme: str = DARK,
        ascii_only: bool = False,
        resume: str | None = None,
        manual: Manual | None = None,
        poll_s: float = POLL_S,
    ) -> None:
        # With NO_COLOR, Textual would turn colours into greys; the theme without colours is used instead.
        colourless = os.environ.pop("NO_COLOR", "") != ""
        super().__init__()
        for made in themes():
            self.register_theme(made)
        self.theme = NO_COLOUR if colourless else theme
        self.look: Look = look(self.theme, ascii_only=ascii_only)
        ScrollBar.renderer = AsciiScrollBar if ascii_only else ScrollBarRender
        self.resume_first, self.poll_s = resume, poll_s
        self.manual = manual or Manual()
        self.runner: Runner | None = None
        self.step = Step.CONNECT
        self.picture: SessionSnapshot | None = None
        self.loaded = False
        self.problem: BaseException | None = None
        self.owns_process = False
        self._screen_over = threading.Event()
        self._source_lock = threading.Lock()
        self._stops_handled: list[events.Key] = []
        self._typed_early: list[events.Key] | None = []
        self._make_source = make_source
        self.source: Sessions
        self.main: MainScreen
        self.interface: ScreenInterface

    def get_default_screen(self) -> Screen[None]:
        """Return the screen that is shown while the program loads."""
        return _StartScreen()

    async def on_mount(self) -> None:
        """Install signal handlers; start loading the main screen."""
        loop = asyncio.get_running_loop()
        if threading.current_thread() is threading.main_thread():
            # Textual does not close its screen on a signal: leave in the ordinary way instead.
            for number in ENDING if self.owns_process else ENDING[1:]:
                signal.signal(number, lambda n, _: self._asked_to_end(signal.Signals(n).name, loop))
        if self.owns_process:
            threading.Thread(target=self._watch_terminal, args=(loop,), daemon=True).start()
        self.call_after_refresh(self.run_worker, self._load())

    async def _load(self) -> None:
        for name in ("main_screen", "screen_interface"):
            await asyncio.to_thread(import_module, f"operator_app.tui.{name}")
        from operator_app.tui.main_screen import MainScreen
        from operator_app.tui.screen_interface import ScreenInterface

        self.source = await asyncio.to_thread(self._make_source)
        self.main, self.interface = MainScreen(), ScreenInterface(self)
        self.loaded = True
        await self.push_screen(self.main)
        gc.enable()
        self.main.set_class(self.look.ascii_only, "-ascii")
        self.main.set_interval(self.poll_s, self.poll)
        await self.interface.begin()

    def _asked_to_end(self, reason: str, loop: asyncio.AbstractEventLoop) -> None:
        """Ask the event loop to end the program; if that fails, a thread ends it without restoring the terminal."""
        with contextlib.suppress(RuntimeError):  # the loop is closed: leaving already
            loop.call_soon_threadsafe(self.exit, reason)
        if self.owns_process:
            leave = self._leave_without_screen
            threading.Thread(target=leave, args=(reason,), daemon=True).start()

    def _watch_terminal(self, loop: asyncio.AbstractEventLoop) -> None:
        """Wait until the terminal is closed, then leave. Only a controlling terminal sends SIGHUP when closed."""
        terminal = select.poll()
        terminal.register(sys.__stdin__ or 0, 0)  # a hang-up is always reported
        terminal.poll()
        self._asked_to_end(signal.SIGHUP.name, loop)

    def _leave_without_screen(self, reason: str) -> None:
        """If the screen does not close in time, hold the arm, close the journal and exit, in this thread."""
        if not self._screen_over.wait(SCREEN_TIMEOUT_S):
            try:
                self.close_source(reason)
            finally:
                os._exit(ExitCode.INTERRUPTED)

    def close_source(self, reason: str) -> None:
        """Hold the arm and close the journal; a second caller waits until that is done."""
        self._screen_over.set()
        with self._source_lock:
            if self.loaded:
                self.source.close(reason)

    def poll(self) -> None:
        """Take one snapshot and show it."""
        runner = self.runner
        if runner is None or not self.main.is_running:
            return
        if runner.defect is not None:
            raise RuntimeError("the session's worker thread failed") from runner.defect
        self.picture = runner.snapshot()
        self.interface.follow(self.picture)
        self.main.show(self.picture)
        if self._typed_early is not None:
            self._replay_early_keys(self._typed_early)

    def get_driver_class(self) -> type[Driver]:
        """Return the platform's driver, extended to report STOP before the event loop sees it."""
        return watched(super().get_driver_class(), self.stop_on_input)

    def stop_on_input(self, event: Pressed) -> None:
        """If this event means STOP, stop the arm at once, in the thread that reads keys and mouse."""
        runner = self.runner
        if runner is None or not runner.connected:
            return
        if isinstance(event, events.MouseDown):
            # While a dialog is open, the strip is visible, but the dialog receives the mouse events.
            if event.button and event.y == 0 and event.x < STOP_WIDTH:
                runner.stop()
        elif self._is_stop(event):
            self._stops_handled.append(event)
            runner.stop()

    def _replay_early_keys(self, early: list[events.Key]) -> None:
        self._typed_early = None
        for event in early:
            # A terminal that is not set up yet sends a line feed for Enter.
            typed = ("enter", "\r") if event.key == "ctrl+j" else (event.key, event.character)
            self.post_message(events.Key(*typed))

    def _is_stop(self, event: events.Key) -> bool:
        """Whether a key means STOP: F8, or space unless text is being entered; modifiers such as Ctrl are ignored."""
        key = event.key.rpartition("+")[2]
        typing = key == "space" and isinstance(self.focused, Input)
        return key in STOP_KEYS and not typing

    async def on_event(self, event: events.Event) -> None:
        """Handle keys before any widget does: STOP first, then keys that end a motion."""
        if isinstance(event, events.Key) and not event.is_forwarded and self._take(event):
            event.stop()
            event.prevent_default()
            return
        await super().on_event(event)

    def _take(self, event: events.Key) -> bool:
        if self._typed_early is not None:
            if event.key in QUIT_KEYS:
                self.exit("left")
            self._typed_early.append(event)
            return True
        # The thread that reads keys may append at any time: search for this event instead of counting.
        if event in self._stops_handled:
            self._stops_handled.remove(event)
            self.main.refuse("")
            return True
        if self._is_stop(event):
            self.interface.stop()
            return True
        runner = self.runner
        task = None if self.picture is None else self.picture.task
        if runner is not None and task is not None and task.moves:
            runner.cancel()
            self.main.refuse("")
            return True
        if self.screen is not self.main:
            return False
        if self.main.is_small and event.key not in QUIT_KEYS:
            return True  # what the key would do cannot be seen
        if event.key in ("tab", "shift+tab"):
            return False
        self.main.refuse("")
        if self.interface.press(event.key, event.character):
            return True
        if event.is_printable:
            self.main.refuse(f"{event.character} is not a key of this step: ? lists the keys")
            self.poll()
        return False

    def action_click(self, name: str) -> None:
        """Perform the action of a clicked span (see `Look.style`), once a session is open."""
        if self.picture is not None:
            self.main.refuse("")
            self.interface.do_named(name)

    def next_theme(self) -> None:
        """Use the next theme."""
        order = (DARK, LIGHT, NO_COLOUR)
        self.theme = order[(order.index(self.theme) + 1) % len(order)]
        self.look = look(self.theme, ascii_only=self.look.ascii_only)
        self.main.repaint()

    def action_help_quit(self) -> None:
        """Leave the program, as the key q does; Textual calls this method for Ctrl+C."""
        self.interface.leave()

    async def action_quit(self) -> None:
        """Leave the program, as the key q does; Textual calls this method for Ctrl+Q."""
        self.interface.leave()


def run(app: SarcalApp) -> str:
    """Run the app and return the reason for leaving; however it ends, hold the arm and close the journal."""
    # While loading, garbage collection frees nothing and takes a third of a second.
    gc.disable()
    app.owns_process = True
    reason = "failed"
    try:
        reason = app.run() or "left"
        if app.return_code:
            reason = "failed"
    finally:
        # Signals must not interrupt the program while it holds the arm and closes the journal.
        with ending_signals_ignored():
            app.close_source(reason)
    if app.problem is not None:
        raise app.problem
    return reason
