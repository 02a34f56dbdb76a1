"""What an operator ticks, marks and chooses before anything is asked of the arm. Knows no screen and no terminal."""

from __future__ import annotations

from dataclasses import replace

from operator_app.session.ui import guards
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import SessionSnapshot, TaskKind
from operator_app.session.ui.user_interface import Chosen, FullScreen, Typed
from solver.chain.sensors import Rvdt


def _note_down(runner: Runner, item: str, text: str) -> None:
    runner.submit(TaskKind.NOTE, "noting", lambda: runner.operations.confirm(item, text))


def stop_tested(chosen: Chosen) -> None:
    """Remember that the hardware stop works, and record it."""
    chosen.runner.publish(lambda s: replace(s, stop_tested=True))
    _note_down(chosen.runner, "hardware stop", "tested")


def open_items(s: SessionSnapshot) -> dict[int, str]:
    """Return the items of the check list that are not ticked."""
    items = s.procedure.fixture.checklist
    return {k: f"Confirm: {text}" for k, text in enumerate(items) if k not in s.ticked}


def _tick(runner: Runner, s: SessionSnapshot, ticked: frozenset[int]) -> None:
    runner.publish(lambda now: replace(now, ticked=ticked))
    items = s.procedure.fixture.checklist
    for k in sorted(ticked - s.ticked):
        _note_down(runner, f"check list {k + 1}", items[k])


def confirm(chosen: Chosen) -> None:
    """Tick the item that is meant."""
    item = chosen.face.item(chosen.s)
    if item is not None:
        _tick(chosen.runner, chosen.s, chosen.s.ticked | {item})


def confirm_all(chosen: Chosen) -> None:
    """Tick every item."""
    _tick(chosen.runner, chosen.s, chosen.s.ticked | frozenset(open_items(chosen.s)))


def toggle_item(face: FullScreen) -> None:
    """Tick the marked item, or take its tick away."""
    s, runner = face.look(), face.runner
    if s is not None and runner is not None and s.procedure.fixture.checklist:
        _tick(runner, s, s.ticked ^ {face.marked_item()})


def toggle_joint(face: FullScreen) -> None:
    """Ask for the other mode of the marked joint."""
    s, runner = face.look(), face.runner
    if s is not None and runner is not None:
        mark(runner, tuple(sorted({*s.wanted_joints} ^ {face.joint()})))


def mark(runner: Runner, joints: tuple[int, ...]) -> None:
    """Ask for these joints in position mode."""
    runner.publish(lambda s: replace(s, wanted_joints=joints))


def other_joints(chosen: Chosen) -> None:
    """Ask which joints should drive."""

    def take(again: Chosen, said: str) -> None:
        words = said.replace(",", " ").split()
        if not words or not all(word.isdecimal() for word in words):
            again.face.refuse("type joint numbers, e.g. 1 5")
            return
        joints = tuple(sorted({int(word) for word in words}))
        problem = guards.modes_problem(again.s, joints)
        if problem:
            again.face.refuse(problem[0])
        else:
            mark(again.runner, joints)

    text = "Joints for position mode, e.g. 1 5; nothing happens until they are applied:"
    value = " ".join(map(str, chosen.s.wanted_joints))
    chosen.ask(Typed(title="Which joints drive?", text=text, value=value), take)


def other_estimator(s: SessionSnapshot) -> str:
    """Return the estimator that is not chosen."""
    return "paper" if s.estimator == "implicit" else "implicit"


def estimator(chosen: Chosen) -> None:
    """Choose the other estimator."""
    chosen.runner.publish(lambda s: replace(s, estimator=other_estimator(s)))


def _next_unsensed(s: SessionSnapshot) -> tuple[int, ...]:
    """None, each RVDT joint, all of them, and round again."""
    bent = [k for k, j in enumerate(s.procedure.arm.joints, 1) if isinstance(j.sensor, Rvdt)]
    choices: list[tuple[int, ...]] = [(), *((k,) for k in bent)]
    if len(bent) > 1:
        choices.append(tuple(bent))
    at = choices.index(s.unsensed_joints) if s.unsensed_joints in choices else 0
    return choices[(at + 1) % len(choices)]


def unsensed(chosen: Chosen) -> None:
    """Choose the next set of unsensed joints."""
    chosen.runner.publish(lambda s: replace(s, unsensed_joints=_next_unsensed(s)))
