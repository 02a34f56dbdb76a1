"""The app on a live fake arm or on one snapshot, and a driver that waits on conditions, never on time."""

import asyncio
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager

import pytest
from textual import events
from textual.drivers.headless_driver import HeadlessDriver
from textual.keys import _character_to_key
from textual.widgets import Static

from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.tui.app import SarcalApp
from operator_app.tui.driver import watched
from tests.oracles.still_runner import StaticSource

PATIENCE_S = 300.0


def shown(widget) -> str:
    return "\n".join("".join(text for text, _ in row) for row in widget.shown)


class Driver:
    """Press keys and wait on conditions of the running app."""

    def __init__(self, app: SarcalApp, pilot) -> None:
        self.app, self.pilot = app, pilot
        self.pressed = 0

    @property
    def runner(self):
        """The open `Runner`, or a `StaticRunner` with the tasks submitted to it."""
        return self.app.runner

    @property
    def s(self) -> SessionSnapshot:
        assert self.app.picture is not None
        return self.app.picture

    @property
    def hint(self) -> str:
        """The hint line above the messages, without its line breaks."""
        return " ".join(shown(self.app.main.hint).split())

    def text(self, selector: str) -> str:
        return shown(self.app.main.query_one(selector))

    def words(self, selector: str) -> str:
        """The text of a panel, without its line breaks."""
        return " ".join(self.text(selector).split())

    @property
    def visible_dialog_text(self) -> str:
        """The text of the dialog on the screen; "" before it is composed."""
        return "".join(str(text.content) for text in self.app.screen.query("#text").results(Static))

    async def dialog_text(self) -> str:
        await self.until(lambda: self.visible_dialog_text != "", "dialog text")
        return self.visible_dialog_text

    async def show(self, picture: SessionSnapshot, step: Step) -> None:
        while self.app.screen is not self.app.main:
            self.app.pop_screen()
            await self.settle()
        runner = self.app.runner
        runner.picture, runner.asked, runner.stops, runner.cancels = picture, [], 0, 0
        self.app.main.refuse("")
        self.app.main.go_to(step)
        self.app.poll()
        await self.settle()

    async def press(self, *keys: str) -> None:
        """Press keys and let the app handle them.

        Textual's own `press` waits for an idle processor, which a live arm never leaves.
        """
        for key in keys:
            self.pressed += 1
            named = _character_to_key(key) if len(key) == 1 else key
            character = key if len(key) == 1 else {"space": " ", "enter": "\r"}.get(key)
            # As the thread that reads the terminal does it.
            self.app._driver.process_message(events.Key(named, character))
            await self.settle()

    async def settle(self) -> None:
        """Let every pending message arrive."""
        loop = asyncio.get_running_loop()
        end = loop.time() + PATIENCE_S
        # From the app to a widget, from there to its dialog, from there back to the app.
        for _ in range(3):
            while not self.app._message_queue.empty():
                assert loop.time() < end, "the app does not read its messages"
                await asyncio.sleep(0)
            await self.pilot.pause(0)

    async def until(self, holds: Callable[[], bool], what: str = "") -> None:
        loop = asyncio.get_running_loop()
        end = loop.time() + PATIENCE_S
        while not holds():
            if loop.time() > end:
                messages = [m.text for m in self.s.messages[-4:]] if self.app.picture else []
                raise AssertionError(f"timeout: {what}; task {self.s.task}, messages {messages}")
            # A pause of the pilot would query every widget.
            await asyncio.sleep(0.005)

    async def idle(self) -> None:
        """Wait until the worker is idle and the screen shows it."""
        runner = self.app.runner
        await self.until(
            lambda: not runner._waiting_jobs and runner.snapshot().task is None, "idle"
        )
        self.app.poll()
        await self.settle()

    async def run(self, *keys: str) -> None:
        """Press keys and wait until the tasks that they submit are done."""
        await self.press(*keys)
        await self.idle()

    async def to_step(self, number: int) -> None:
        """Go from the first step to another by keys only."""
        while self.app.step < number:
            before = self.app.step
            await self.press("enter")
            if self.app.screen is not self.app.main:
                await self.press("y")
            await self.idle()
            assert self.pressed < 40, f"stuck at {before}: {self.hint}"


@asynccontextmanager
async def running(app: SarcalApp, size: tuple[int, int] = (120, 36)) -> AsyncIterator[Driver]:
    """Run the app without a terminal, but with keys read as from one, as STOP is."""
    with pytest.MonkeyPatch.context() as patch:
        watching = watched(HeadlessDriver, app.stop_on_input)
        patch.setattr("textual.drivers.headless_driver.HeadlessDriver", watching)
        async with app.run_test(size=size) as pilot:
            driver = Driver(app, pilot)
            await driver.until(lambda: app.picture is not None, "first picture")
            yield driver


@pytest.fixture
def drive(source):
    """Run the app and return its driver, at a step: ``async with drive(step=Step.CAPTURE) as d``."""

    @asynccontextmanager
    async def run(size: tuple[int, int] = (120, 36), step: Step = Step.CONNECT):
        async with running(SarcalApp(lambda: source), size) as driver:
            await driver.to_step(step)
            yield driver

    return run


@pytest.fixture
def still():
    """Run the app on one snapshot: ``async with still(picture, step=Step.CAPTURE) as d``."""

    @asynccontextmanager
    async def run(picture, *, step=Step.CONNECT, size=(120, 36), entries=(), **options):
        app = SarcalApp(lambda: StaticSource(picture, entries), **options)
        async with running(app, size) as driver:
            app.main.go_to(step)
            await driver.settle()
            app.poll()
            await driver.settle()
            yield driver

    return run
