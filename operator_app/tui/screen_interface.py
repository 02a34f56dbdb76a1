"""Implements `UserInterface` for the terminal app: dialogs, actions on the marked row, opening of sessions."""

from __future__ import annotations

import asyncio
import re
import textwrap
from collections.abc import Callable, Mapping
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.documents import arm_history
from operator_app.manual.shown import as_text
from operator_app.messages.errors import EXPECTED, words
from operator_app.report.results.history import history_text
from operator_app.session.store.folders import documents_of
from operator_app.session.ui import action_table, guards, user_interface
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import SessionSnapshot
from operator_app.session.ui.steps import Step
from operator_app.tui.dialogs import DIALOGS, Read
from operator_app.tui.lines import Lines
from operator_app.tui.steps.capture import CaptureView
from operator_app.tui.steps.fixture import FixtureView
from operator_app.tui.steps.modes import ModesView
from operator_app.tui.widgets.status import messages_text
from operator_app.units import plural

if TYPE_CHECKING:
    from operator_app.tui.app import SarcalApp


def help_text(step: Step, panel: Lines | None, page: str, width: int) -> str:
    """Return the help for a step and for the panel in focus, if any.

    `page`: the manual's page ``panels`` with a heading per step and panel; the paragraph below it explains them.
    """
    about = dict(re.findall(r"^#+ (.+)\n\n((?:.+\n)+)", page, re.MULTILINE))
    blocks = [textwrap.fill(about[f"{int(step)} {step.title}"], width)]
    if panel is not None:
        text = f"This panel ({panel.TITLE}): {about[panel.TITLE]}"
        blocks.append(textwrap.fill(text, width))
    else:
        blocks.append("Tab focuses a panel; ? then explains that panel.")
    of_step = [
        a for a in action_table.ACTIONS if step in a.steps and a.steps != user_interface.EVERYWHERE
    ]
    everywhere = [a for a in action_table.ACTIONS if a.steps == user_interface.EVERYWHERE]
    for title, actions in (("Keys of this step", of_step), ("Keys everywhere", everywhere)):
        rows = [
            textwrap.fill(
                f"{a.shown:<9} {a.label}: {a.help}", width, initial_indent="  ",
                subsequent_indent=" " * 12,
            )
            for a in actions
        ]  # fmt: skip
        blocks.append("\n".join([title, *rows]))
    return "\n\n".join(blocks)


class ScreenInterface:
    """The `UserInterface` of the terminal app; an action applies to the row that is marked on the screen.

    `runner` is set only when a session is open; until then no action can be chosen.
    """

    def __init__(self, app: SarcalApp) -> None:
        self.app, self.sessions = app, app.source
        self.runner: Runner
        self._seen_solution: object = None
        self._proposed = (Step.CONNECT, "")
        self._opening = False

    def press(self, *keys: str | None) -> bool:
        """Do the action that a key has at this step; return False if none. `keys`: name and character of the key."""
        matching = (action_table.for_key(key, self.app.step) for key in keys if key is not None)
        action = next((a for a in matching if a is not None), None)
        if action is not None:
            self.do(action)
        return action is not None

    def do(self, action: user_interface.Action | user_interface.OnScreen) -> None:
        """Do an action at the current step and show its result immediately."""
        if isinstance(action, user_interface.OnScreen):
            ON_SCREEN[action.name](self)
        else:
            user_interface.perform_action(action, self)
        self.app.poll()

    def do_named(self, name: str) -> None:
        """Do the action with this name."""
        self.do(action_table.by_name(name))

    def do_anywhere(self, action: user_interface.Action | user_interface.OnScreen) -> None:
        """Do an action from the palette, after going to its step if necessary; if the step is not open, show why."""
        if self.app.step in action.steps or self.go(min(action.steps)):
            self.do(action)

    def do_next_action(self) -> None:
        """Do the action that the line above the footer recommends."""
        name = next_action(self.app.step, self.snapshot()).action
        if name:
            self.do_named(name)

    def snapshot(self) -> SessionSnapshot:
        """Take a snapshot, make it the current one of the app, and return it."""
        self.app.picture = self.runner.snapshot()
        return self.app.picture

    def retry_soon(self, work: Callable[[], None]) -> None:
        """Call `work` 0.1 s later, without blocking the screen."""
        self.app.set_timer(0.1, work)

    def refuse(self, reason: str) -> None:
        """Show above the footer why an action is refused."""
        self.app.main.refuse(reason)

    def ask(self, question: user_interface.Question, then: Callable[[str], None]) -> None:
        """Ask in a dialog; call `then` with the answer unless the dialog is cancelled."""

        def answered(answer: str | None) -> None:
            if answer is not None:
                then(answer)

        self.app.push_screen(DIALOGS[type(question)](question), answered)

    def pose(self, s: SessionSnapshot) -> int | None:
        """Number of the marked pose; None if there is no pose."""
        return self.app.main.query_one(CaptureView).marked_pose(s)

    def item(self, s: SessionSnapshot) -> int | None:
        """Index of the item to tick: the marked item if unticked, else the first unticked item, else None."""
        open_items = action_table.open_items(s)
        marked = self.marked_item()
        return marked if marked in open_items else next(iter(open_items), None)

    def marked_item(self) -> int:
        """Index of the marked item of the check list."""
        return self.app.main.query_one(FixtureView).main.cursor

    def alarm(self, s: SessionSnapshot) -> user_interface.ShownAlarm | None:
        """Return the alarm on the screen, which need not be the newest; None if this alarm has been cleared."""
        shown = self.app.main.log_lines.alarm
        standing = {alarm.number for alarm in s.alarms}
        return shown if shown is not None and shown.number in standing else None

    def toggle_item(self) -> None:
        """Tick or untick the marked item of the check list."""
        s = self.snapshot()
        if s.procedure.fixture.checklist:
            action_table.tick(self.runner, s, s.ticked ^ {self.marked_item()})

    def toggle_joint(self) -> None:
        """Switch the selected mode of the marked joint between position and free."""
        joint = self.app.main.query_one(ModesView).main.cursor + 1
        joints = {*self.snapshot().selected_joints} ^ {joint}
        action_table.mark(self.runner, tuple(sorted(joints)))

    def write_report(self, runner: Runner) -> Path:
        """Write the report page; return its path."""
        from operator_app.report.html.page import write_report

        return write_report(runner.session)

    def topics(self) -> Mapping[str, str]:
        """Summaries of the manual's pages, by topic."""
        return self.app.manual.topics

    def show_page(self, topic: str) -> None:
        """Show a page of the manual, which is read or generated in a thread."""
        self.app.run_worker(self._show_page(topic))

    async def _show_page(self, topic: str) -> None:
        page = await asyncio.to_thread(self.app.manual.page, topic)
        text = as_text(page, min(86, self.app.size.width - 8))
        self.app.push_screen(Read(f"Manual: {topic}", text))

    def show_history(self, serial: str) -> None:
        """Show an arm's history; the journals are read in a thread."""
        self.app.run_worker(self._show_history(serial))

    async def _show_history(self, serial: str) -> None:
        try:
            history = await asyncio.to_thread(arm_history, serial, self.sessions.root)
        except EXPECTED as error:
            self.refuse(words(error).happened)
            return
        self.app.push_screen(Read(f"History of {serial}", history_text(history, brief=True)))

    async def begin(self) -> None:
        """Resume the session named on the command line, or start a session and offer the newest unfinished one."""
        reference = self.app.resume_first
        if reference is not None:
            await self._open(lambda: self.sessions.resumed(reference))
            return
        await self._open(self.sessions.new)
        if self.app.problem is None:
            await self._offer_unfinished()

    async def _offer_unfinished(self) -> None:
        entry = await asyncio.to_thread(self.sessions.unfinished)
        if entry is None or entry.state is None:
            return
        name, state = entry.folder.name, entry.state
        procedure = ": ".join(filter(None, documents_of(state)))
        arm = state.serial_number or "an unknown arm"
        text = (
            f"Session {name} of {arm} (procedure {procedure}) has {plural(len(state.used_poses), 'pose')} "
            "and no export. Resuming checks the arm, the fixture and the modes again before anything moves."
        )
        question = user_interface.YesNo(title="Resume?", text=text, yes="Resume", no="New session")
        self.ask(question, lambda _: self.open(lambda: self.sessions.resumed(name)))

    def open(self, make: Callable[[], Runner]) -> None:
        """Switch to the session that `make` opens, in a thread, since closing the present session may take time."""
        if self._opening:
            self.refuse("wait: another session is being opened")
            return
        self._opening = True
        held = " and the arm is held" if self.runner.connected else ""
        self.refuse(f"closing this session: its work ends{held}")
        self.app.run_worker(self._open(make))

    async def _open(self, make: Callable[[], Runner]) -> None:
        try:
            self.runner = self.app.runner = await asyncio.to_thread(make)
        except EXPECTED as error:
            if self.app.runner is None or not self.sessions.is_open:
                self.app.problem = error  # `run` raises it
                self.app.exit("problem")
                return
            message = words(error)
            self.refuse(f"{message.happened}. {message.remedy}")
            return
        finally:
            self._opening = False
        self.refuse("")
        self.app.main.go_to(Step.CONNECT)
        self.app.poll()

    def leave(self) -> None:
        """Leave; ask first while an arm is connected."""
        s = self.app.picture
        if s is None or not s.connected:
            self.app.exit("left")
            return
        poses = len(s.state.poses)
        text = f"All joints are held and the session is kept with its {poses} poses; it can be resumed."
        question = user_interface.YesNo(title="Leave?", text=text, yes="Leave, hold all")
        self.ask(question, lambda _: self.app.exit("left"))

    def follow(self, s: SessionSnapshot) -> None:
        """Remove a refusal when the step's next action is another one; show the Results step after a calibration."""
        before = self._proposed
        self._proposed = self.app.step, next_action(self.app.step, s).label
        if before != self._proposed and before[0] is self.app.step and not self._opening:
            self.refuse("")
        if s.solution is not None and s.solution is not self._seen_solution:
            self._seen_solution = s.solution
            if self.app.step is Step.CALIBRATE:
                self.go(Step.RESULTS)

    def go(self, step: Step) -> bool:
        """Show a step and return True; if a later step is not open yet, show what is missing and return False."""
        s = self.snapshot()
        missing = guards.missing_for(step, s)
        # Going back is always allowed.
        if missing and step > self.app.step:
            self.refuse(f"{step.title} is closed: {missing}")
            return False
        self.app.main.go_to(step)
        self.app.main.show(s)
        return True

    def go_by(self, steps: int) -> None:
        """Show the step that is `steps` after the current step (-1: the previous step), if there is one."""
        if self.app.step + steps in list(Step):
            self.go(Step(self.app.step + steps))

    def move(self, by: int) -> None:
        """Move the mark in the main list of the step by `by` rows, or scroll the list."""
        self.app.main.view.move(by)
        self.app.main.view.show(self.snapshot())

    def stop(self) -> None:
        """Send the software STOP from this thread, without waiting."""
        if self.runner.connected:
            self.runner.stop()
            self.refuse("")
        else:
            self.refuse("STOP: no arm is connected, nothing was sent")

    def show_help(self) -> None:
        """Explain the panel in focus and list the keys."""
        panel = self.app.focused if isinstance(self.app.focused, Lines) else None
        page = self.app.manual.page("panels")
        text = help_text(self.app.step, panel, page, min(86, self.app.size.width - 8))
        self.app.push_screen(Read(f"Help: {self.app.step.title}", text))

    def show_messages(self) -> None:
        """Show all messages in full."""
        text = messages_text(self.snapshot(), min(86, self.app.size.width - 8))
        self.app.push_screen(Read("Messages, newest first", text))


ON_SCREEN: Mapping[str, Callable[[ScreenInterface], object]] = {
    "stop": ScreenInterface.stop,
    "primary": ScreenInterface.do_next_action,
    "tick": ScreenInterface.toggle_item,
    "toggle_mode": ScreenInterface.toggle_joint,
    "cancel": lambda screen: screen.runner.cancel(),
    "view": lambda screen: screen.app.main.view.next_view(),
    "next": lambda screen: screen.go_by(1),
    "back": lambda screen: screen.go_by(-1),
    "down": lambda screen: screen.move(1),
    "up": lambda screen: screen.move(-1),
    "messages": ScreenInterface.show_messages,
    "help": ScreenInterface.show_help,
    "palette": lambda screen: screen.app.action_command_palette(),
    "theme": lambda screen: screen.app.next_theme(),
    "quit": ScreenInterface.leave,
    **{f"step_{int(step)}": partial(ScreenInterface.go, step=step) for step in Step},
}
"""Functions of the actions that exist only in the terminal app, by name."""
