"""The table of actions, for the terminal app and for plain mode: keys, texts, steps, guard and handler.

Handlers that only change settings are in this module, others in `action_handlers`.
Key dispatch, footer, help, palette and prompts are made from this table.
"""

from dataclasses import replace

from operator_app.session.ui import action_handlers, guards
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import SessionSnapshot, TaskKind
from operator_app.session.ui.steps import QUIT_KEYS, STOP_KEYS, Step
from operator_app.session.ui.user_interface import (
    EVERYWHERE,
    Action,
    ActionContext,
    OnScreen,
    Typed,
)
from solver.chain.sensors import Rvdt


def _record_confirmation(runner: Runner, item: str, text: str) -> None:
    data = {"item": item, "text": text}
    runner.submit(TaskKind.NOTE, "noting", lambda: runner.session.record("confirmed", data))


def stop_tested(context: ActionContext) -> None:
    """Record that the hardware stop was tested."""
    context.runner.publish(lambda s: replace(s, stop_tested=True))
    _record_confirmation(context.runner, "hardware stop", "tested")


def open_items(s: SessionSnapshot) -> dict[int, str]:
    """Return the prompt for each unticked item of the check list, by index of the item (from 0)."""
    items = s.procedure.fixture.checklist
    return {k: f"Confirm: {text}" for k, text in enumerate(items) if k not in s.ticked}


def tick(runner: Runner, s: SessionSnapshot, ticked: frozenset[int]) -> None:
    """Set the ticked items of the check list; record the newly ticked ones."""
    runner.publish(lambda now: replace(now, ticked=ticked))
    items = s.procedure.fixture.checklist
    for k in sorted(ticked - s.ticked):
        _record_confirmation(runner, f"check list {k + 1}", items[k])


def confirm(context: ActionContext) -> None:
    """Tick the selected item."""
    item = context.interface.item(context.s)
    if item is not None:
        tick(context.runner, context.s, context.s.ticked | {item})


def confirm_all(context: ActionContext) -> None:
    """Tick every item."""
    tick(context.runner, context.s, context.s.ticked | frozenset(open_items(context.s)))


def mark(runner: Runner, joints: tuple[int, ...]) -> None:
    """Select these joints for position mode."""
    runner.publish(lambda s: replace(s, selected_joints=joints))


def other_joints(context: ActionContext) -> None:
    """Ask for the drive joints, and select them if they are a valid set."""

    def take(again: ActionContext, answer: str) -> None:
        numbers = answer.replace(",", " ").split()
        # Python refuses to convert thousands of digits.
        if not numbers or not all(word.isdecimal() and len(word) < 10 for word in numbers):
            again.interface.refuse("type joint numbers, e.g. 1 5")
            return
        joints = tuple(sorted({int(word) for word in numbers}))
        problem = guards.modes_problem(again.s, joints)
        if problem:
            again.interface.refuse(problem)
        else:
            mark(again.runner, joints)

    text = "Joints for position mode, e.g. 1 5 (they take effect when applied):"
    value = " ".join(map(str, context.s.selected_joints))
    context.ask(Typed(title="Which joints drive?", text=text, value=value), take)


def other_estimator(s: SessionSnapshot) -> str:
    """Return the estimator that is not selected."""
    return "paper" if s.estimator == "implicit" else "implicit"


def estimator(context: ActionContext) -> None:
    """Select the other estimator."""
    context.runner.publish(lambda s: replace(s, estimator=other_estimator(s)))


def _next_unsensed(s: SessionSnapshot) -> tuple[int, ...]:
    """Return the next set of unsensed joints in the cycle: no joint, each RVDT joint alone, all RVDT joints."""
    bent = [k for k, j in enumerate(s.procedure.arm.joints, 1) if isinstance(j.sensor, Rvdt)]
    choices: list[tuple[int, ...]] = [(), *((k,) for k in bent)]
    if len(bent) > 1:
        choices.append(tuple(bent))
    at = choices.index(s.unsensed_joints) if s.unsensed_joints in choices else 0
    return choices[(at + 1) % len(choices)]


def unsensed(context: ActionContext) -> None:
    """Select the next set of unsensed joints."""
    context.runner.publish(lambda s: replace(s, unsensed_joints=_next_unsensed(s)))


MAX_IN_FOOTER = 6
LEAST_IMPORTANT = ("quit", "back")
"""Actions that the footer leaves out first."""


ACTIONS: tuple[Action | OnScreen, ...] = (
    OnScreen(name="stop", keys=STOP_KEYS, shown="SPACE/F8", label="STOP",
             help="Software STOP: quick stop to all drives, latched. F8 works everywhere, SPACE "
             "outside of text. It is not an emergency stop: that is the hardware button.",
             footer=EVERYWHERE),
    OnScreen(name="primary", keys=("enter",), shown="Enter", label="Next action",
             help="Do what the line above the footer proposes; if there is nothing to do, go on to the next "
             "step.", footer=EVERYWHERE),
    Action(name="connect", keys=("c",), shown="c", label="Connect", prompt="Connect",
           help="Find the arm on the bus and check its identity.", steps={Step.CONNECT},
           guard=guards.may_connect, work=action_handlers.connect),
    Action(name="stop_tested", keys=("t",), shown="t", label="Stop tested",
           prompt="Confirm: the hardware stop was pressed and every drive switched off",
           help="Confirm that the hardware stop was pressed and every drive switched off.",
           steps={Step.CONNECT}, footer={Step.CONNECT}, offered=lambda s: not s.simulated,
           work=stop_tested),
    Action(name="resume", keys=("o",), shown="o", label="Open session",
           prompt="Open an earlier session", help="Resume an earlier session.",
           steps={Step.CONNECT, Step.EXPORT}, footer={Step.CONNECT}, work=action_handlers.resume),
    Action(name="procedure", keys=("p",), shown="p", label="Procedure",
           prompt="Start another session with another procedure",
           help="Choose another procedure: fixture, drive joints, capture plan. It starts a new "
           "session.", steps={Step.CONNECT, Step.FIXTURE}, footer={Step.FIXTURE},
           work=action_handlers.procedure),
    Action(name="check_fixture", keys=("k",), shown="k", label="Check again",
           prompt="Check the fixture again",
           help="Check the placement of the fixture again at the present pose.",
           steps={Step.FIXTURE}, guard=guards.may_check_fixture,
           work=action_handlers.task(TaskKind.CHECK, lambda o: o.check_fixture())),
    Action(name="confirm", keys=(), shown="Enter", label="Confirm",
           help="Tick the selected item of the check list, or the next open one.",
           steps={Step.FIXTURE}, rows=open_items, work=confirm),
    Action(name="confirm_all", keys=(), shown="Enter", label="Tick all",
           prompt="Tick every item (simulated arm)",
           help="Tick the whole check list at once, on a simulated arm.", steps={Step.FIXTURE},
           offered=lambda s: s.simulated and bool(open_items(s)), guard=guards.may_tick_all,
           work=confirm_all),
    OnScreen(name="tick", keys=("x",), shown="x", label="Tick",
             help="Tick or untick the selected item of the check list.",
             steps={Step.FIXTURE}),
    OnScreen(name="toggle_mode", keys=("f",), shown="f", label="Free/Pos",
             help="Select the other mode for the selected joint; it takes effect when applied.",
             steps={Step.MODES}, footer={Step.MODES}),
    Action(name="suggest", keys=("p",), shown="p", label="Best set",
           prompt="Select the best ranked joints", help="Select the best ranked drive joints.",
           steps={Step.MODES}, footer={Step.MODES}, guard=guards.may_suggest,
           work=lambda context: mark(context.runner, context.s.ranked[0].drives)),
    Action(name="joints", keys=("j",), shown="j", label="Joints", prompt="Choose other joints",
           help="Type the drive joints; they take effect when applied.",
           steps={Step.MODES}, work=other_joints),
    Action(name="apply_modes", keys=("a",), shown="a", label="Apply", prompt=action_handlers.apply_prompt,
           help="Enable the drives and set the selected modes, after confirmation; the modes are read back.",
           steps={Step.MODES}, guard=guards.may_apply_modes, work=action_handlers.apply_modes),
    Action(name="wiggle", keys=("w",), shown="w", label="Wiggle",
           prompt="Trial wiggle: 2 deg and back",
           help="Move each drive joint by 2 deg and back, and show how the others follow. Any key stops.",
           steps={Step.MODES}, footer={Step.MODES}, guard=guards.may_move,
           work=action_handlers.task(TaskKind.WIGGLE, lambda o: o.wiggle())),
    Action(name="automatic", keys=("a",), shown="a", label="Automatic",
           prompt="Capture the remaining poses automatically",
           help="Move, settle and capture until there are enough poses; on a real arm it asks first. "
           "Any key stops.", steps={Step.CAPTURE},
           guard=guards.may_run_automatically, work=action_handlers.automatic),
    Action(name="go", keys=("g",), shown="g", label="Go", prompt="Move to the next pose",
           help="Move to the next planned pose. Any key stops.", steps={Step.CAPTURE},
           footer={Step.CAPTURE}, guard=guards.may_move,
           work=lambda context: action_handlers.go(context, context.s.next_waypoint)),
    Action(name="go_best", keys=("b",), shown="b", label="Go to best",
           prompt="Go to the most informative pose",
           help="Move to the waypoint that adds most information. Any key stops.", steps={Step.CAPTURE},
           guard=guards.may_go_best, work=lambda context: action_handlers.go(context, context.s.best_waypoint)),
    Action(name="go_home", keys=("h",), shown="h", label="Go home", prompt="Go home at 5 deg/s",
           help="Move the drive joints straight home at 5 deg/s, after confirmation: for an arm outside the "
           "box of its procedure. Any key stops.",
           steps={Step.MODES, Step.CAPTURE, Step.EXPORT}, guard=guards.may_go_home,
           work=action_handlers.home),
    Action(name="capture", keys=("c",), shown="c", label="Capture", prompt="Capture a pose here",
           help="Wait for standstill and capture a pose at the present position.", steps={Step.CAPTURE},
           footer={Step.CAPTURE}, guard=guards.may_capture, work=action_handlers.capture),
    Action(name="undo", keys=("u",), shown="u", label="Undo", prompt="Undo the last exclusion, note or pose",
           help="Undo the last exclusion, note or pose; it stays in the journal.",
           steps={Step.CAPTURE}, footer={Step.CAPTURE}, guard=guards.may_edit_pose,
           work=action_handlers.task(TaskKind.NOTE, lambda o: o.undo(), "undoing the last change")),
    Action(name="redo", keys=("U",), shown="U", label="Redo", prompt="Redo the last undone change",
           help="Redo the last undone change, unless there was another change since.",
           steps={Step.CAPTURE}, guard=guards.idle,
           work=action_handlers.task(TaskKind.NOTE, lambda o: o.redo(), "redoing a change")),
    Action(name="note", keys=("n",), shown="n", label="Note", prompt="Note to a pose",
           help="Write a note to the selected pose.", steps={Step.CAPTURE},
           guard=guards.may_edit_pose, work=action_handlers.note),
    Action(name="exclude", keys=("x",), shown="x", label="Exclude",
           prompt="Exclude a pose, or include it again",
           help="Exclude the selected pose from the calibration, or include it again.",
           steps={Step.CAPTURE}, guard=guards.may_edit_pose, work=action_handlers.exclude),
    Action(name="remount", keys=("M",), shown="M", label="Remount",
           prompt="Remount the fixture, for poses in another placement",
           help="Release the arm, after confirmation of the steps, and continue this session in another "
           "placement of its fixture; the arm's offsets are shared.",
           steps={Step.CAPTURE}, guard=guards.may_remount, work=action_handlers.remount),
    Action(name="calibrate", keys=("s",), shown="s", label="Solve",
           prompt=lambda s: f"Calibrate, estimator {s.estimator}",
           help="Calibrate from the poses that are not excluded.", steps={Step.CALIBRATE},
           guard=guards.may_calibrate, work=action_handlers.calibrate),
    Action(name="estimator", keys=("e",), shown="e", label="Estimator",
           prompt=lambda s: f"Use the {other_estimator(s)} estimator",
           help="Change between the implicit and the paper's estimator.",
           steps={Step.CALIBRATE}, footer={Step.CALIBRATE}, guard=guards.idle,
           work=estimator),
    Action(name="unsensed", keys=("j",), shown="j", label="Unsensed",
           help="Change the unsensed joints: none, each RVDT joint alone, all RVDT joints.",
           steps={Step.CALIBRATE}, footer={Step.CALIBRATE}, guard=guards.idle,
           work=unsensed),
    OnScreen(name="cancel", keys=("z",), shown="z", label="Cancel",
             help="Cancel the running task; a moving arm comes to rest and holds."),
    Action(name="write", keys=("w",), shown="w", label="Write file",
           prompt="Write parameters.yaml and poses.csv",
           help="Write parameters.yaml and poses.csv into the session folder.",
           steps={Step.EXPORT}, guard=guards.may_write,
           work=action_handlers.task(TaskKind.EXPORT, lambda o: o.write(), "writing the files")),
    Action(name="upload", keys=("u",), shown="u", label="Upload", prompt="Upload to the controller",
           help="Upload the parameters to the controller, after typing the arm's serial number; "
           "they are read back.", steps={Step.EXPORT}, guard=guards.may_upload, work=action_handlers.upload),
    Action(name="force", keys=("U",), shown="U", label="Force upload",
           help="Upload a calibration that was not accepted, after typing a reason and the arm's serial "
           "number.", steps={Step.RESULTS}, guard=guards.may_force, work=action_handlers.force),
    Action(name="verify", keys=("y",), shown="y", label="Verify",
           prompt=f"Verify with {action_handlers.VERIFY_POSES} new poses",
           help="Capture new poses and compare them with the identified parameters. Any key stops.",
           steps={Step.EXPORT}, footer={Step.EXPORT}, guard=guards.may_verify, work=action_handlers.verify),
    Action(name="report", keys=("r",), shown="r", label="Report",
           help="Write report.html, one page about this calibration, into the session folder.",
           steps={Step.EXPORT}, footer={Step.EXPORT}, guard=guards.may_report, work=action_handlers.report),
    Action(name="new_session", keys=("N",), shown="N", label="New session",
           help="Close this session, leave the arm held, and start another.",
           footer={Step.EXPORT}, work=action_handlers.new_session),
    OnScreen(name="view", keys=("v",), shown="v", label="View",
             help="Show the next panel or plot of this step.", footer={Step.RESULTS}),
    OnScreen(name="next", keys=("right_square_bracket",), shown="]", label="Next",
             help="Go to the next step, if it is open."),
    OnScreen(name="back", keys=("left_square_bracket",), shown="[", label="Back",
             help="Go back a step; nothing is lost.", footer=EVERYWHERE - {Step.CONNECT}),
    OnScreen(name="down", keys=("down",), shown="Down", label="Down",
             help="Select the next row of the list."),
    OnScreen(name="up", keys=("up",), shown="Up", label="Up",
             help="Select the previous row of the list."),
    Action(name="reset", keys=("R",), shown="R", label="Reset STOP",
           prompt="Reset STOP; nothing moves",
           help="Clear a latched STOP or a drive fault. Nothing moves; the drives stay disabled.",
           offered=guards.needs_reset, guard=guards.may_reset,
           work=action_handlers.task(TaskKind.RESET, lambda o: o.reset())),
    Action(name="acknowledge", keys=("A",), shown="A", label="Acknowledge",
           help="Hide the alarm that is shown; its cause remains. The alarm before it is shown then.",
           rows=action_handlers.standing_alarms, offered=lambda s: bool(s.alarms), work=action_handlers.acknowledge),
    OnScreen(name="messages", keys=("l",), shown="l", label="Messages",
             help="Show all messages of this session in full, the newest first."),
    Action(name="hold", keys=("H",), shown="H", label="Hold all",
           help="Hold all joints in position mode where they are.", guard=guards.may_hold,
           work=action_handlers.hold),
    OnScreen(name="help", keys=("question_mark", "f1"), shown="?", label="Help",
             help="Explain the focused panel and list the keys.", footer=EVERYWHERE),
    Action(name="history", keys=("i",), shown="i", label="History",
           prompt="History: all calibrations of this arm",
           help="Show all accepted calibrations and verifications of this arm, what has shifted, and when the next "
           "calibration is due.", guard=guards.may_show_history, work=action_handlers.history),
    Action(name="manual", keys=("m",), shown="m", label="Manual", prompt="Read the manual",
           help="Read a page of the manual. It needs no network.", work=action_handlers.manual),
    OnScreen(name="palette", keys=("ctrl+p", "colon"), shown="Ctrl+P", label="All actions",
             help="Find an action by name."),
    OnScreen(name="theme", keys=("T",), shown="T", label="Theme",
             help="Change between dark, light and no colour."),
    OnScreen(name="quit", keys=QUIT_KEYS, shown="q", label="Quit",
             help="Quit, after confirmation: the arm is held, the session is kept.",
             footer=EVERYWHERE),
    *(
        OnScreen(name=f"step_{int(step)}", keys=(str(int(step)),), shown=str(int(step)),
                 label=step.title, help=f"Go to step {int(step)}, {step.title}, if it is open.")
        for step in Step
    ),
)  # fmt: skip


def by_name(name: str) -> Action | OnScreen:
    """Return the action with this name."""
    return next(a for a in ACTIONS if a.name == name)


def for_key(key: str, step: Step) -> Action | OnScreen | None:
    """Return the action of a key at a step; None if the key has none."""
    return next((a for a in ACTIONS if key in a.keys and step in a.steps), None)


def footer(step: Step) -> tuple[Action | OnScreen, ...]:
    """Return the actions in the footer of a step, at most six."""
    shown = [a for a in ACTIONS if step in a.steps & a.footer]
    for name in LEAST_IMPORTANT:
        if len(shown) > MAX_IN_FOOTER:
            shown = [a for a in shown if a.name != name]
    return tuple(shown[:MAX_IN_FOOTER])


def prompts(step: Step) -> tuple[list[Action], list[Action]]:
    """Return the actions that plain mode lists at `step`: those not available at every step, and those that are."""
    of_step = [a for a in ACTIONS if isinstance(a, Action) and step in a.steps]
    common = [a for a in of_step if a.steps == EVERYWHERE]
    return [a for a in of_step if a not in common], common
