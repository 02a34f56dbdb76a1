"""Actions that only change settings: ticks, selected joints, estimator."""

from __future__ import annotations

from dataclasses import replace

from operator_app.session.ui import guards
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import SessionSnapshot, TaskKind
from operator_app.session.ui.user_interface import ActionContext, FullScreenInterface, Typed
from solver.chain.sensors import Rvdt


def _record_confirmation(runner: Runner, item: str, text: str) -> None:
    runner.submit(TaskKind.NOTE, "noting", lambda: runner.operations.confirm(item, text))


def stop_tested(context: ActionContext) -> None:
    """Record that the hardware stop was tested."""
    context.runner.publish(lambda s: replace(s, stop_tested=True))
    _record_confirmation(context.runner, "hardware stop", "tested")


def open_items(s: SessionSnapshot) -> dict[int, str]:
    """Return the items of the check list that are not ticked."""
    items = s.procedure.fixture.checklist
    return {k: f"Confirm: {text}" for k, text in enumerate(items) if k not in s.ticked}


def _tick(runner: Runner, s: SessionSnapshot, ticked: frozenset[int]) -> None:
    runner.publish(lambda now: replace(now, ticked=ticked))
    items = s.procedure.fixture.checklist
    for k in sorted(ticked - s.ticked):
        _record_confirmation(runner, f"check list {k + 1}", items[k])


def confirm(context: ActionContext) -> None:
    """Tick the selected item."""
    item = context.interface.item(context.s)
    if item is not None:
        _tick(context.runner, context.s, context.s.ticked | {item})


def confirm_all(context: ActionContext) -> None:
    """Tick every item."""
    _tick(context.runner, context.s, context.s.ticked | frozenset(open_items(context.s)))


def toggle_item(interface: FullScreenInterface) -> None:
    """Tick or untick the selected item."""
    s, runner = interface.snapshot(), interface.runner
    if s is not None and runner is not None and s.procedure.fixture.checklist:
        _tick(runner, s, s.ticked ^ {interface.marked_item()})


def toggle_joint(interface: FullScreenInterface) -> None:
    """Select the other mode for the selected joint."""
    s, runner = interface.snapshot(), interface.runner
    if s is not None and runner is not None:
        mark(runner, tuple(sorted({*s.wanted_joints} ^ {interface.joint()})))


def mark(runner: Runner, joints: tuple[int, ...]) -> None:
    """Select these joints for position mode."""
    runner.publish(lambda s: replace(s, wanted_joints=joints))


def other_joints(context: ActionContext) -> None:
    """Ask for the drive joints."""

    def take(again: ActionContext, said: str) -> None:
        words = said.replace(",", " ").split()
        if not words or not all(word.isdecimal() for word in words):
            again.interface.refuse("type joint numbers, e.g. 1 5")
            return
        joints = tuple(sorted({int(word) for word in words}))
        problem = guards.modes_problem(again.s, joints)
        if problem:
            again.interface.refuse(problem[0])
        else:
            mark(again.runner, joints)

    text = "Joints for position mode, e.g. 1 5 (they take effect when applied):"
    value = " ".join(map(str, context.s.wanted_joints))
    context.ask(Typed(title="Which joints drive?", text=text, value=value), take)


def other_estimator(s: SessionSnapshot) -> str:
    """Return the estimator that is not chosen."""
    return "paper" if s.estimator == "implicit" else "implicit"


def estimator(context: ActionContext) -> None:
    """Choose the other estimator."""
    context.runner.publish(lambda s: replace(s, estimator=other_estimator(s)))


def _next_unsensed(s: SessionSnapshot) -> tuple[int, ...]:
    """Return the next of: no joint, each RVDT joint, all of them."""
    bent = [k for k, j in enumerate(s.procedure.arm.joints, 1) if isinstance(j.sensor, Rvdt)]
    choices: list[tuple[int, ...]] = [(), *((k,) for k in bent)]
    if len(bent) > 1:
        choices.append(tuple(bent))
    at = choices.index(s.unsensed_joints) if s.unsensed_joints in choices else 0
    return choices[(at + 1) % len(choices)]


def unsensed(context: ActionContext) -> None:
    """Choose the next set of unsensed joints."""
    context.runner.publish(lambda s: replace(s, unsensed_joints=_next_unsensed(s)))
