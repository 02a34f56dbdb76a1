"""What each step's actions do: ask the guards, then hand the work to the desk. Knows no bus, no solver."""

from __future__ import annotations

from dataclasses import replace

from hardware.arm import JointMode
from operator_app.session import guards
from operator_app.session.next_thing import next_thing
from operator_app.session.operations import Operations
from operator_app.session.snapshot import Level, SessionSnapshot, TaskKind
from operator_app.tui.dialogs import Ask, Confirm
from operator_app.tui.keys import by_name
from operator_app.tui.navigation import Navigation
from operator_app.tui.steps.capture import CaptureView
from operator_app.tui.steps.fixture import FixtureView
from operator_app.tui.steps.modes import ModesView
from solver.chain.sensors import Rvdt

VERIFY_POSES = 5


class Actions(Navigation):
    """The actions of the seven steps."""

    def do_primary(self) -> None:
        """Do the next thing."""
        s = self._look()
        if s is None:
            return
        thing = next_thing(self.app.step, s, self.wanted)
        if thing.action == "tick":
            self._tick(s)
        elif thing.action:
            self.app.perform(by_name(thing.action))

    def do_connect(self) -> None:
        """Find the arm on the bus and check its identity."""
        self._hand(guards.may_connect, TaskKind.CONNECT, "connecting", lambda o: o.connect())

    def do_stop_tested(self) -> None:
        """Confirm that the hardware stop was pressed and every drive dropped out."""
        if self.app.desk is not None:
            self.app.desk.publish(lambda s: replace(s, stop_tested=True))
            self._note_down("hardware stop", "tested")

    def do_check_fixture(self) -> None:
        """Judge the fixture's placement again where the arm stands now."""
        self._hand(
            guards.may_check_fixture,
            TaskKind.CHECK,
            "checking the fixture",
            lambda o: o.check_fixture(),
        )

    def do_tick(self) -> None:
        """Tick the marked item of the check list."""
        s = self._look()
        if s is not None:
            self._tick(s, here=True)

    def _tick(self, s: SessionSnapshot, *, here: bool = False) -> None:
        """Tick the marked item or the next open one; on a simulated arm, Enter ticks them all."""
        items = s.procedure.fixture.checklist
        view = self.app.main.query_one(FixtureView)
        left = [k for k in range(len(items)) if k not in s.ticked]
        if self.app.desk is None or not (left or here):
            return
        marked = view.cursor
        if here:
            ticked = s.ticked ^ {marked}
        elif s.simulated:
            ticked = frozenset(range(len(items)))
        else:
            ticked = s.ticked | {marked if marked in left else left[0]}
        self.app.desk.publish(lambda s: replace(s, ticked=ticked))
        for k in sorted(ticked - s.ticked):
            self._note_down(f"check list {k + 1}", items[k])
        still = [k for k in range(len(items)) if k not in ticked]
        if still:
            view.mark(still[0])

    def _note_down(self, item: str, text: str) -> None:
        desk = self.app.desk
        if desk is not None:
            desk.submit(TaskKind.NOTE, "noting", lambda: desk.operations.confirm(item, text))

    def do_toggle_mode(self) -> None:
        """Ask for the other mode of the marked joint."""
        k = self.app.main.query_one(ModesView).cursor
        other = JointMode.FREE if self.wanted[k] is JointMode.POSITION else JointMode.POSITION
        self.wanted = (*self.wanted[:k], other, *self.wanted[k + 1 :])
        self.app.main.set_wanted(self.wanted)

    def do_suggest(self) -> None:
        """Mark the best ranked drive joints instead."""
        s = self._look()
        if s is None or not s.ranked:
            self.app.main.refuse("no ranking yet: connect first (step 1)")
            return
        drives = s.ranked[0].drives
        self.wanted = tuple(
            JointMode.POSITION if k in drives else JointMode.FREE
            for k in range(1, len(self.wanted) + 1)
        )
        self.app.main.set_wanted(self.wanted)

    def do_apply_modes(self) -> None:
        """Take control and set the modes as marked."""
        joints = tuple(k for k, m in enumerate(self.wanted, 1) if m is JointMode.POSITION)
        s = self._look()
        if s is None or self._refused(guards.may_apply_modes(s, joints)):
            return
        names = " and ".join(f"J{j}" for j in joints)

        def answer(said: str | None) -> None:
            if said:
                self._hand(
                    lambda now: guards.may_apply_modes(now, joints),
                    TaskKind.MODES,
                    f"setting {names} to position mode, the others free",
                    lambda o: o.set_modes(joints),
                )

        text = (
            f"The drives are enabled; {names} in position mode, the others free: those give way when "
            "pushed. Nothing moves yet. Stand clear of the arm."
        )
        self.app.push_screen(Confirm("Apply the modes?", text, "Apply"), answer)

    def do_wiggle(self) -> None:
        """Move each drive joint by 2 deg and back, to see what follows."""
        self._hand(guards.may_move, TaskKind.WIGGLE, "trial wiggle", lambda o: o.wiggle())

    def do_go(self) -> None:
        """Move to the next planned pose."""
        self._go_to(None if self.app.picture is None else self.app.picture.next_waypoint)

    def do_go_best(self) -> None:
        """Move to the pose that would tell most."""
        s = self.app.picture
        best = None if s is None else s.best_waypoint
        if best is None:
            self.app.main.refuse("no best pose yet: it needs an estimate from a few poses")
            return
        self._go_to(best)

    def _go_to(self, waypoint: int | None) -> None:
        text = "moving" if waypoint is None else f"moving to waypoint {waypoint + 1}"
        self._hand(guards.may_move, TaskKind.MOVE, text, lambda o: o.go(waypoint or 0))

    def do_capture(self) -> None:
        """Let the arm settle and capture a pose where it stands."""
        s = self.app.picture
        at = -1 if s is None or s.at_waypoint is None else s.at_waypoint
        self._hand(guards.may_capture, TaskKind.CAPTURE, "capturing", lambda o: o.capture(at))

    def do_automatic(self) -> None:
        """Move, settle and capture, pose after pose, until there are enough."""
        self._hand(
            guards.may_run_automatically,
            TaskKind.AUTOMATIC,
            "moving and capturing automatically",
            lambda o: o.automatic(),
        )

    def do_undo(self) -> None:
        """Take back the last pose."""
        self._hand(guards.may_edit_pose, TaskKind.NOTE, "taking back a pose", lambda o: o.undo())

    def do_exclude(self) -> None:
        """Leave the marked pose out of the calibration, or let it count again."""
        number = self._marked_pose()
        if number is not None:
            self._hand(
                guards.may_edit_pose, TaskKind.NOTE, "excluding a pose", lambda o: o.exclude(number)
            )

    def do_note(self) -> None:
        """Write a note to the marked pose."""
        number, s = self._marked_pose(), self._look()
        if number is None or s is None:
            return
        pose = next(p for p in s.state.poses if p.number == number)

        def answer(said: str | None) -> None:
            if said is not None:
                self._hand(
                    guards.may_edit_pose, TaskKind.NOTE, "noting", lambda o: o.note(number, said)
                )

        self.app.push_screen(
            Ask(f"Note to pose {number}", "What should be remembered?", value=pose.note), answer
        )

    def _marked_pose(self) -> int | None:
        s = self._look()
        number = None if s is None else self.app.main.query_one(CaptureView).marked_pose(s)
        if number is None:
            self.app.main.refuse("there is no pose yet: capture one first")
        return number

    def do_calibrate(self) -> None:
        """Calibrate from the poses that count."""
        s = self._look()
        if s is not None:
            self._hand(
                guards.may_calibrate,
                TaskKind.CALIBRATE,
                "calibrating",
                lambda o: o.calibrate(s.estimator, s.unsensed_joints),
            )

    def do_estimator(self) -> None:
        """Change between the implicit and the paper's estimator."""
        s = self._look()
        if s is not None and self.app.desk is not None and not self._refused(guards.idle(s)):
            other = "paper" if s.estimator == "implicit" else "implicit"
            self.app.desk.publish(lambda s: replace(s, estimator=other))

    def do_unsensed(self) -> None:
        """Change which joints count as unsensed: none, each RVDT joint, all of them."""
        s = self._look()
        if s is None or self.app.desk is None or self._refused(guards.idle(s)):
            return
        bent = [k for k, j in enumerate(s.procedure.arm.joints, 1) if isinstance(j.sensor, Rvdt)]
        choices: list[tuple[int, ...]] = [(), *((k,) for k in bent)]
        if len(bent) > 1:
            choices.append(tuple(bent))
        at = choices.index(s.unsensed_joints) if s.unsensed_joints in choices else 0
        unsensed = choices[(at + 1) % len(choices)]
        self.app.desk.publish(lambda s: replace(s, unsensed_joints=unsensed))

    def do_write(self) -> None:
        """Write parameters.yaml and poses.csv into the session folder."""
        self._hand(guards.may_write, TaskKind.EXPORT, "writing the files", lambda o: o.write())

    def do_upload(self) -> None:
        """Upload the parameters to the controller."""
        s = self._look()
        if s is None or self._refused(guards.may_upload(s)) or s.identity is None:
            return
        serial = s.identity.serial_number

        def answer(said: str | None) -> None:
            if said:
                self._hand(guards.may_upload, TaskKind.UPLOAD, "uploading", lambda o: o.upload())

        text = (
            f"The arm is held, the files are written, and the controller of {serial} takes the new "
            f"parameters. Type the arm's serial number, {serial}, to confirm."
        )
        self.app.push_screen(Ask("Upload to the controller?", text, expected=serial), answer)

    def do_report(self) -> None:
        """Write report.html, one page about this calibration, into the session folder."""
        s, desk = self._look(), self.app.desk
        if s is None or desk is None:
            return

        def work(_: Operations) -> None:
            from operator_app.tui.reporting import write_report

            target = write_report(desk.session, s.estimator, s.unsensed_joints)
            desk.publish(lambda s: replace(s, report=target))
            desk.say(Level.INFO, f"report written: {target}")

        self._hand(guards.may_report, TaskKind.EXPORT, "writing the report", work)

    def do_verify(self) -> None:
        """Move to new poses and judge them by the parameters found."""
        s = self._look()
        if s is None or self._refused(guards.may_verify(s)):
            return

        def answer(said: str | None) -> None:
            if said:
                self._hand(
                    guards.may_verify,
                    TaskKind.VERIFY,
                    f"moving to {VERIFY_POSES} new poses",
                    lambda o: o.verify(VERIFY_POSES),
                )

        text = (
            f"The arm moves to {VERIFY_POSES} new poses by itself. Stand clear; any key stops it."
        )
        self.app.push_screen(Confirm("Verify with new poses?", text, "Move"), answer)
