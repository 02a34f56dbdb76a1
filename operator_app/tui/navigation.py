"""Beginning, leaving, going from step to step, STOP: the actions that every step has. Knows no bus."""

from __future__ import annotations

import asyncio
from collections.abc import Awaitable, Callable
from typing import TYPE_CHECKING

from hardware.arm import JointMode
from operator_app.session import guards
from operator_app.session.desk import Desk
from operator_app.session.operations import Operations
from operator_app.session.snapshot import SessionSnapshot, TaskKind
from operator_app.session.state import SessionState
from operator_app.session.steps import Step
from operator_app.session.wording import EXPECTED, summary, words
from operator_app.tui.dialogs import Choose, Confirm, Read
from operator_app.tui.help import help_text
from operator_app.tui.lines import Lines

if TYPE_CHECKING:
    from operator_app.tui.app import SarcalApp


class Navigation:
    """Actions of the frame around the steps."""

    def __init__(self, app: SarcalApp) -> None:
        self.app = app
        self.wanted: tuple[JointMode, ...] = ()
        self._seen_solution: object = None
        self._opening = False

    # -- session -----------------------------------------------------------------------------------

    def begin(self) -> None:
        """Begin a session; if an earlier one was left in the middle, offer it."""
        if self.app.resume_first is not None:
            reference = self.app.resume_first
            self.open(lambda: self.app.source.resumed(reference))
            return
        self.open(self.app.source.new, self._offer_unfinished)

    async def _offer_unfinished(self) -> None:
        """Offer the newest session that was left in the middle; reading journals takes time."""
        unfinished = [
            e
            for e in await asyncio.to_thread(self.app.source.sessions)
            if e.state and e.state.poses and not e.state.exported
        ]
        if unfinished:
            self._offer(
                unfinished[0].folder.name,
                len(unfinished[0].state.poses) if unfinished[0].state else 0,
            )

    def _offer(self, name: str, poses: int) -> None:
        def answer(said: str | None) -> None:
            if said:
                self.open(lambda: self.app.source.resumed(name))

        text = (
            f"Session {name} was left with {poses} poses and no export. Resuming checks the arm, the "
            "fixture and the modes again before anything moves."
        )
        self.app.push_screen(Confirm("Resume?", text, "Resume"), answer)

    def open(
        self, make: Callable[[], Desk], then: Callable[[], Awaitable[None]] | None = None
    ) -> None:
        """Take another desk, in a thread: the one before may have to end work and hold the arm."""
        if self._opening:
            self.app.main.refuse("wait: another session is being opened")
            return
        self._opening = True
        if self.app.desk is not None:
            self.app.main.refuse("closing this session: its work is ended and the arm held")
        self.app.run_worker(self._open(make, then))

    async def _open(
        self, make: Callable[[], Desk], then: Callable[[], Awaitable[None]] | None
    ) -> None:
        try:
            self.app.desk = await asyncio.to_thread(make)
        except EXPECTED as error:
            if self.app.desk is None:
                self.app.give_up(error)
                return
            said = words(error)
            self.app.main.refuse(f"{said.happened}. {said.remedy}")
            return
        finally:
            self._opening = False
        self.app.main.refuse("")
        self.app.step = Step.CONNECT
        self.app.main.go_to(Step.CONNECT)
        self._mark(self.app.desk.snapshot())
        self.app.poll()
        if then is not None:
            await then()

    def _mark(self, s: SessionSnapshot) -> None:
        """Mark the modes the session has, the procedure names, or the ranking recommends."""
        joints = s.procedure.position_joints
        if joints is None and s.ranked:
            joints = s.ranked[0].drives
        n = s.procedure.arm.joint_count
        self.wanted = tuple(
            JointMode.POSITION if k in (joints or ()) else JointMode.FREE for k in range(1, n + 1)
        )
        self.app.main.set_wanted(self.wanted)

    def follow(self, s: SessionSnapshot) -> None:
        """Go where the work has led: a finished calibration shows its results."""
        if s.solution is not None and s.solution is not self._seen_solution:
            self._seen_solution = s.solution
            if self.app.step is Step.CALIBRATE:
                self.go(Step.RESULTS)
        if s.ranked and JointMode.POSITION not in self.wanted:
            self._mark(s)

    # -- moving about ------------------------------------------------------------------------------

    def go(self, step: Step) -> bool:
        """Show a step if its guard holds; otherwise say what is missing."""
        s = self._look()
        if s is None:
            return False
        missing = guards.missing_for(step, s)
        # Going back never needs anything.
        if missing and step > self.app.step:
            self.app.main.refuse(f"{step.title} is closed: {missing[0]}")
            return False
        self.app.step = step
        self.app.main.go_to(step)
        self.app.main.show(s)
        return True

    def do_step(self, number: int) -> None:
        """Go to a step, if it is open."""
        self.go(Step(number))

    def do_next(self) -> None:
        """Go to the next step, if its conditions hold."""
        if self.app.step is not Step.EXPORT:
            self.go(Step(self.app.step + 1))

    def do_back(self) -> None:
        """Go back a step."""
        if self.app.step is not Step.CONNECT:
            self.go(Step(self.app.step - 1))

    def do_up(self) -> None:
        """Mark the row before."""
        self._move(-1)

    def do_down(self) -> None:
        """Mark the next row of the list."""
        self._move(1)

    def _move(self, by: int) -> None:
        s = self._look()
        if s is not None:
            self.app.main.view.move(by, s)
            self.app.main.view.show(s)

    def do_view(self) -> None:
        """Show the next panel or plot of this step."""
        self.app.main.view.turn_over()

    # -- safety ------------------------------------------------------------------------------------

    def stop_now(self) -> None:
        """Software STOP, from this thread, at once."""
        desk = self.app.desk
        if desk is not None and desk.connected:
            desk.stop()
            self.app.main.refuse("")
        else:
            self.app.main.refuse("STOP: no arm is connected, nothing was sent")

    def do_stop(self) -> None:
        """Software STOP: quick stop to all drives, latched."""
        self.stop_now()

    def do_reset(self) -> None:
        """Clear a latched STOP or a drive fault."""
        self._hand(guards.may_reset, TaskKind.RESET, "resetting STOP", lambda o: o.reset())

    def do_hold(self) -> None:
        """All joints to position mode where they are; whatever is under way ends first."""
        if self.app.desk is not None:
            self.app.desk.cancel()
        self._hand(guards.may_use_data, TaskKind.HOLD, "holding all joints", lambda o: o.hold())

    def do_cancel(self) -> None:
        """End the work in hand."""
        if self.app.desk is not None:
            self.app.desk.cancel()

    def do_new_session(self) -> None:
        """Close this session, leave the arm held, and begin another."""

        def answer(said: str | None) -> None:
            if said:
                self.open(self.app.source.new)

        text = "This session is closed and kept; the arm is held. Another one begins at step 1."
        self.app.push_screen(Confirm("New session?", text, "Begin"), answer)

    def do_procedure(self) -> None:
        """Take another procedure; a session with poses is closed and kept."""
        options = [(p.name, summary(p)) for p in self.app.source.procedures()]

        def answer(said: str | None) -> None:
            if said:
                self.open(lambda: self.app.source.new(said))

        text = "A new session begins with it; this one is closed and kept, the arm is held."
        self.app.push_screen(Choose("Which procedure?", text, options), answer)

    def do_resume(self) -> None:
        """Resume an earlier session."""
        here = None if self.app.desk is None else self.app.desk.session.journal.path.parent.name
        options = [
            (e.folder.name, f"{e.folder.name}  {len(e.state.used_poses)} poses, {_stage(e.state)}")
            for e in self.app.source.sessions()
            if e.state is not None and e.folder.name != here
        ]
        if not options:
            self.app.main.refuse("there is no other session to resume")
            return

        def answer(said: str | None) -> None:
            if said:
                self.open(lambda: self.app.source.resumed(said))

        text = "Resuming checks the arm, the fixture and the modes again before anything moves."
        self.app.push_screen(Choose("Open a session", text, options[:50]), answer)

    # -- everything else ---------------------------------------------------------------------------

    def do_help(self) -> None:
        """Explain the focused panel and list the keys."""
        panel = self.app.focused if isinstance(self.app.focused, Lines) else None
        self.app.push_screen(
            Read(
                f"Help: {self.app.step.title}",
                help_text(self.app.step, panel, min(86, self.app.size.width - 8)),
            )
        )

    def do_palette(self) -> None:
        """Find any action by name."""
        self.app.action_command_palette()

    def do_theme(self) -> None:
        """Change between dark, light and no colour."""
        self.app.change_look()

    def do_quit(self) -> None:
        """Leave."""
        s = self.app.picture
        if s is None or not s.connected:
            self.app.leave("left")
            return

        def answer(said: str | None) -> None:
            if said:
                self.app.leave("left")

        poses = len(s.state.poses)
        text = f"All joints are held and the session is kept with its {poses} poses; resume it any time."
        self.app.push_screen(Confirm("Leave?", text, "Leave, hold all"), answer)

    # -- inside ------------------------------------------------------------------------------------

    def _look(self) -> SessionSnapshot | None:
        """Take a fresh picture: a decision is never made on an old one."""
        if self.app.desk is None:
            return None
        self.app.picture = self.app.desk.snapshot()
        return self.app.picture

    def _refused(self, missing: guards.Missing) -> bool:
        if missing:
            self.app.main.refuse(missing[0])
        return bool(missing)

    def _hand(
        self,
        guard: Callable[[SessionSnapshot], guards.Missing],
        kind: TaskKind,
        text: str,
        work: Callable[[Operations], None],
    ) -> None:
        """Ask the guard, then give the work to the desk."""
        s = self._look()
        desk = self.app.desk
        if s is None or desk is None or self._refused(guard(s)):
            return
        desk.submit(kind, text, lambda: work(desk.operations))


def _stage(state: SessionState) -> str:
    if state.exported:
        return "exported"
    return "solved" if state.solved else "captured"
