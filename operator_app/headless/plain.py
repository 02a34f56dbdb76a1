"""The workflow as numbered prompts, for screen readers and dumb terminals: the same desk, the same guards.

Says everything in whole lines, moves no cursor. Knows no bus.
"""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import Protocol

from operator_app.headless.plain_words import describe, results
from operator_app.session import guards
from operator_app.session.desk import Desk
from operator_app.session.operations import Operations
from operator_app.session.snapshot import DataState, SessionSnapshot, TaskKind
from operator_app.session.steps import Step

WAIT_S = 0.1
VERIFY_POSES = 5


class Terminal(Protocol):
    """Where lines go and come from."""

    def say(self, text: str) -> None:
        """Write lines."""
        ...

    def ask(self, prompt: str) -> str:
        """Return what was typed; raises EOFError at the end of the input."""
        ...

    def touched(self, timeout_s: float) -> bool:
        """Wait that long at most; return whether a line was typed meanwhile, and take it."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class _Item:
    """One numbered line of a menu."""

    label: str
    do: Callable[[], None]
    missing: guards.Missing = ()


class Plain:
    """The seven steps as menus."""

    def __init__(
        self, desk: Desk, terminal: Terminal, pause: Callable[[float], None] = time.sleep
    ) -> None:
        self._desk, self._terminal, self._pause = desk, terminal, pause
        self._step = Step.CONNECT
        self._heard = 0
        self._left = False

    def run(self) -> str:
        """Ask until the operator leaves; Ctrl-C is STOP, and leaves when nothing is under way."""
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

    # -- menus -------------------------------------------------------------------------------------

    def _menu(self) -> None:
        s = self._look()
        self._terminal.say("\n" + "\n".join(describe(self._step, s)))
        items = [*self._items(s), *self._everywhere(s)]
        for number, item in enumerate(items, 1):
            closed = f" (closed: {item.missing[0]})" if item.missing else ""
            self._terminal.say(f"  {number} {item.label}{closed}")
        typed = self._terminal.ask("Number: ").strip()
        if not typed.isdecimal() or not 1 <= int(typed) <= len(items):
            self._terminal.say(f"There is no {typed!r}: type a number from 1 to {len(items)}.")
            return
        chosen = items[int(typed) - 1]
        if chosen.missing:
            self._terminal.say(f"Not done: {chosen.missing[0]}.")
            return
        chosen.do()

    def _items(self, s: SessionSnapshot) -> list[_Item]:
        match self._step:
            case Step.CONNECT:
                return self._connect(s)
            case Step.FIXTURE:
                return self._fixture(s)
            case Step.MODES:
                return self._modes(s)
            case Step.CAPTURE:
                return self._capture(s)
            case Step.CALIBRATE:
                return self._calibrate(s)
            case Step.RESULTS:
                return [
                    _Item(label="Read the results", do=self._read, missing=guards.results_ready(s))
                ]
            case Step.EXPORT:
                return self._export(s)

    def _everywhere(self, s: SessionSnapshot) -> list[_Item]:
        items = []
        if self._step is not Step.EXPORT:
            onward = Step(self._step + 1)
            items.append(
                _Item(
                    label=f"Go on to step {int(onward)}, {onward.title}",
                    do=lambda: self._go(onward),
                    missing=guards.missing_for(onward, s),
                )
            )
        if self._step is not Step.CONNECT:
            before = Step(self._step - 1)
            items.append(_Item(label=f"Back to {before.title}", do=lambda: self._go(before)))
        if not guards.may_reset(s):
            items.append(
                self._work("Reset STOP; nothing moves", TaskKind.RESET, guards.may_reset, _reset)
            )
        items.append(_Item(label="Leave: the arm is held, the session is kept", do=self._leave))
        return items

    def _connect(self, s: SessionSnapshot) -> list[_Item]:
        items = [self._work("Connect", TaskKind.CONNECT, guards.may_connect, lambda o: o.connect())]
        if not s.simulated:
            items.append(
                _Item(
                    label="Confirm: the hardware stop was pressed and every drive dropped out",
                    do=self._confirm_stop_test,
                )
            )
        return items

    def _confirm_stop_test(self) -> None:
        self._desk.publish(lambda s: replace(s, stop_tested=True))
        self._submit(TaskKind.NOTE, lambda o: o.confirm("hardware stop", "tested"))

    def _fixture(self, s: SessionSnapshot) -> list[_Item]:
        items = [
            self._work(
                "Check the fixture again",
                TaskKind.CHECK,
                guards.may_check_fixture,
                lambda o: o.check_fixture(),
            )
        ]
        for k, text in enumerate(s.procedure.fixture.checklist):
            if k not in s.ticked:
                items.append(_Item(label=f"Confirm: {text}", do=partial(self._tick, k)))
        return items

    def _tick(self, k: int) -> None:
        s = self._look()
        self._desk.publish(lambda s: replace(s, ticked=s.ticked | {k}))
        text = s.procedure.fixture.checklist[k]
        self._submit(TaskKind.NOTE, lambda o: o.confirm(f"check list {k + 1}", text))

    def _modes(self, s: SessionSnapshot) -> list[_Item]:
        joints = s.procedure.position_joints or (s.ranked[0].drives if s.ranked else ())
        names = " and ".join(str(j) for j in joints)
        return [
            _Item(
                label=f"Put joints {names} into position mode, the others free",
                do=lambda: self._apply(joints),
                missing=guards.may_apply_modes(s, joints),
            ),
            _Item(label="Choose other joints", do=self._other_joints),
            self._work(
                "Trial wiggle: 2 deg and back",
                TaskKind.WIGGLE,
                guards.may_move,
                lambda o: o.wiggle(),
            ),
        ]

    def _other_joints(self) -> None:
        typed = self._terminal.ask("Joints for position mode, e.g. 1 5: ").replace(",", " ").split()
        if not all(word.isdecimal() for word in typed):
            self._terminal.say("Not done: type joint numbers.")
            return
        joints = tuple(sorted({int(word) for word in typed}))
        missing = guards.may_apply_modes(self._look(), joints)
        if missing:
            self._terminal.say(f"Not done: {missing[0]}.")
            return
        self._apply(joints)

    def _apply(self, joints: tuple[int, ...]) -> None:
        if self._sure("The drives are enabled, free joints give way when pushed."):
            self._submit(TaskKind.MODES, lambda o: o.set_modes(joints))

    def _capture(self, s: SessionSnapshot) -> list[_Item]:
        at, onward = s.at_waypoint, s.next_waypoint
        return [
            self._work(
                "Capture all poses that are left, automatically",
                TaskKind.AUTOMATIC,
                guards.may_run_automatically,
                lambda o: o.automatic(),
            ),
            self._work(
                "Move to the next pose", TaskKind.MOVE, guards.may_move, lambda o: o.go(onward or 0)
            ),
            self._work(
                "Capture a pose here",
                TaskKind.CAPTURE,
                guards.may_capture,
                lambda o: o.capture(-1 if at is None else at),
            ),
            self._work(
                "Take back the last pose", TaskKind.NOTE, guards.may_edit_pose, lambda o: o.undo()
            ),
            _Item(label="Note to a pose", do=self._note, missing=guards.may_edit_pose(s)),
            _Item(
                label="Exclude a pose, or let it count again",
                do=self._exclude,
                missing=guards.may_edit_pose(s),
            ),
        ]

    def _pose_number(self) -> int | None:
        typed = self._terminal.ask("Pose number: ").strip()
        known = {p.number for p in self._look().state.poses}
        if not typed.isdecimal() or int(typed) not in known:
            self._terminal.say(f"There is no pose {typed!r}.")
            return None
        return int(typed)

    def _note(self) -> None:
        number = self._pose_number()
        if number is not None:
            text = self._terminal.ask("Note: ").strip()
            self._submit(TaskKind.NOTE, lambda o: o.note(number, text))

    def _exclude(self) -> None:
        number = self._pose_number()
        if number is not None:
            self._submit(TaskKind.NOTE, lambda o: o.exclude(number))

    def _calibrate(self, s: SessionSnapshot) -> list[_Item]:
        other = "paper" if s.estimator == "implicit" else "implicit"
        return [
            self._work(
                f"Calibrate, estimator {s.estimator}",
                TaskKind.CALIBRATE,
                guards.may_calibrate,
                lambda o: o.calibrate(s.estimator, s.unsensed_joints),
            ),
            _Item(
                label=f"Use the {other} estimator",
                do=lambda: self._desk.publish(lambda s: replace(s, estimator=other)),
            ),
        ]

    def _read(self) -> None:
        self._terminal.say("\n".join(results(self._look())))

    def _export(self, s: SessionSnapshot) -> list[_Item]:
        return [
            self._work(
                "Write parameters.yaml and poses.csv",
                TaskKind.EXPORT,
                guards.may_write,
                lambda o: o.write(),
            ),
            _Item(label="Upload to the controller", do=self._upload, missing=guards.may_upload(s)),
            self._work(
                f"Verify with {VERIFY_POSES} new poses",
                TaskKind.VERIFY,
                guards.may_verify,
                lambda o: o.verify(VERIFY_POSES),
            ),
        ]

    def _upload(self) -> None:
        s = self._look()
        serial = "" if s.identity is None else s.identity.serial_number
        typed = self._terminal.ask(f"Type the arm's serial number, {serial}, to confirm: ").strip()
        if typed != serial:
            self._terminal.say(f"Not done: that is not {serial}. Nothing was sent.")
            return
        self._submit(TaskKind.UPLOAD, lambda o: o.upload())

    # -- inside ------------------------------------------------------------------------------------

    def _go(self, step: Step) -> None:
        self._step = step

    def _leave(self) -> None:
        self._left = True

    def _sure(self, what: str) -> bool:
        return self._terminal.ask(f"{what} Type yes to go on: ").strip().lower() == "yes"

    def _look(self) -> SessionSnapshot:
        s = self._desk.snapshot()
        if self._desk.defect is not None:
            raise RuntimeError("the session's worker met a defect") from self._desk.defect
        for message in s.messages:
            if message.number > self._heard:
                self._heard = message.number
                self._terminal.say(f"[{message.time} {message.level.value}] {message.text}")
        return s

    def _work(
        self,
        label: str,
        kind: TaskKind,
        guard: Callable[[SessionSnapshot], guards.Missing],
        work: Callable[[Operations], None],
    ) -> _Item:
        missing = guard(self._desk.snapshot())
        return _Item(label=label, do=lambda: self._submit(kind, work), missing=missing)

    def _submit(self, kind: TaskKind, work: Callable[[Operations], None]) -> None:
        """Hand it to the desk and wait; Enter ends a motion."""
        operations = self._desk.operations
        self._desk.submit(kind, kind.value, lambda: work(operations))
        s = self._look()
        if guards.ends_with_any_key(s.task):
            self._terminal.say(f"{kind.value}: press Enter to stop it.")
        while s.task is not None:
            if guards.ends_with_any_key(s.task):
                if self._terminal.touched(WAIT_S):
                    self._desk.cancel()
            else:
                self._pause(WAIT_S)
            s = self._look()

    def _stop(self) -> bool:
        """Ctrl-C: STOP while an arm is connected and not stopped yet; False leaves the program."""
        s = self._desk.snapshot()
        if not s.connected or s.stopped or s.data is DataState.LOST:
            return False
        self._desk.stop()
        self._look()
        return True


def _reset(operations: Operations) -> None:
    operations.reset()
