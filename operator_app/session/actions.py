"""Every action there is, once: keys, words, steps, guard and work. Both faces read it.

Dispatch, footer, help and palette of the screen and the prompts of plain mode are made from this
table: an action is one entry. Knows no screen and no terminal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace
from functools import partial

from operator_app.session import guards
from operator_app.session.face import (
    EVERYWHERE,
    Action,
    Chosen,
    FullScreen,
    OneOf,
    OnScreen,
    Typed,
    YesNo,
)
from operator_app.session.guards import Missing
from operator_app.session.keys import QUIT_KEYS, STOP_KEYS
from operator_app.session.operations import Operations
from operator_app.session.runner import Runner
from operator_app.session.snapshot import Level, SessionSnapshot, TaskKind
from operator_app.session.state import SessionState
from operator_app.session.steps import Step
from operator_app.session.wording import summary
from solver.chain.sensors import Rvdt

VERIFY_POSES = 5
MOST_IN_FOOTER = 6
GIVE_WAY = ("quit", "back")
"""What the footer leaves out first."""


def _at(*steps: Step) -> frozenset[Step]:
    return frozenset(steps)


# -- what they do ----------------------------------------------------------------------------------

Work = Callable[[Chosen], None]


def _task(kind: TaskKind, text: str, work: Callable[[Operations], None]) -> Work:
    """Work that is handed over as it is."""
    return lambda chosen: chosen.hand(kind, text, work)


def _note_down(runner: Runner, item: str, text: str) -> None:
    runner.submit(TaskKind.NOTE, "noting", lambda: runner.operations.confirm(item, text))


def _stop_tested(chosen: Chosen) -> None:
    chosen.runner.publish(lambda s: replace(s, stop_tested=True))
    _note_down(chosen.runner, "hardware stop", "tested")


def _resume(chosen: Chosen) -> None:
    face = chosen.face
    here = chosen.runner.session.journal.path.parent.name
    options = tuple(
        (e.folder.name, f"{e.folder.name}  {len(e.state.used_poses)} poses, {_stage(e.state)}")
        for e in face.sessions.sessions()
        if e.state is not None and e.folder.name != here
    )
    if not options:
        face.refuse("there is no other session to resume")
        return
    text = "Resuming checks the arm, the fixture and the modes again before anything moves."
    question = OneOf(title="Open a session", text=text, options=options[:50])
    face.ask(question, lambda said: face.open(lambda: face.sessions.resumed(said)))


def _stage(state: SessionState) -> str:
    if state.exported:
        return "exported"
    return "solved" if state.solved else "captured"


def _procedure(chosen: Chosen) -> None:
    face = chosen.face
    options = tuple((p.name, summary(p)) for p in face.sessions.procedures())
    text = "A new session begins with it; this one is closed and kept, the arm is held."
    question = OneOf(title="Which procedure?", text=text, options=options)
    face.ask(question, lambda said: face.open(lambda: face.sessions.new(said)))


def _new_session(chosen: Chosen) -> None:
    face = chosen.face
    text = "This session is closed and kept; the arm is held. Another one begins at step 1."
    face.ask(
        YesNo(title="New session?", text=text, yes="Begin"), lambda _: face.open(face.sessions.new)
    )


def open_items(s: SessionSnapshot) -> dict[int, str]:
    """Return the items of the check list that are not ticked."""
    items = s.procedure.fixture.checklist
    return {k: f"Confirm: {text}" for k, text in enumerate(items) if k not in s.ticked}


def _tick(runner: Runner, s: SessionSnapshot, ticked: frozenset[int]) -> None:
    runner.publish(lambda now: replace(now, ticked=ticked))
    items = s.procedure.fixture.checklist
    for k in sorted(ticked - s.ticked):
        _note_down(runner, f"check list {k + 1}", items[k])


def _confirm(chosen: Chosen) -> None:
    item = chosen.face.item(chosen.s)
    if item is not None:
        _tick(chosen.runner, chosen.s, chosen.s.ticked | {item})


def _confirm_all(chosen: Chosen) -> None:
    _tick(chosen.runner, chosen.s, chosen.s.ticked | frozenset(open_items(chosen.s)))


def _toggle_item(face: FullScreen) -> None:
    s, runner = face.look(), face.runner
    if s is not None and runner is not None and s.procedure.fixture.checklist:
        _tick(runner, s, s.ticked ^ {face.marked_item()})


def _toggle_joint(face: FullScreen) -> None:
    s, runner = face.look(), face.runner
    if s is not None and runner is not None:
        _mark(runner, tuple(sorted({*s.wanted_joints} ^ {face.joint()})))


def _mark(runner: Runner, joints: tuple[int, ...]) -> None:
    runner.publish(lambda s: replace(s, wanted_joints=joints))


def _other_joints(chosen: Chosen) -> None:
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
            _mark(again.runner, joints)

    text = "Joints for position mode, e.g. 1 5; nothing happens until they are applied:"
    value = " ".join(map(str, chosen.s.wanted_joints))
    chosen.ask(Typed(title="Which joints drive?", text=text, value=value), take)


def _apply_modes(chosen: Chosen) -> None:
    joints = chosen.s.wanted_joints
    names = " and ".join(f"J{j}" for j in joints)
    text = (
        f"The drives are enabled; {names} in position mode, the others free: those give way when "
        "pushed. Nothing moves yet. Stand clear of the arm."
    )
    chosen.ask(
        YesNo(title="Apply the modes?", text=text, yes="Apply"),
        lambda again, _: again.hand(
            TaskKind.MODES,
            f"setting {names} to position mode, the others free",
            lambda o: o.set_modes(joints),
        ),
    )


def _go(chosen: Chosen, waypoint: int | None) -> None:
    text = "moving" if waypoint is None else f"moving to waypoint {waypoint + 1}"
    chosen.hand(TaskKind.MOVE, text, lambda o: o.go(waypoint or 0))


def _capture(chosen: Chosen) -> None:
    at = -1 if chosen.s.at_waypoint is None else chosen.s.at_waypoint
    chosen.hand(TaskKind.CAPTURE, "capturing", lambda o: o.capture(at))


def _exclude(chosen: Chosen) -> None:
    number = chosen.face.pose(chosen.s)
    if number is not None:
        chosen.hand(TaskKind.NOTE, "excluding a pose", lambda o: o.exclude(number))


def _note(chosen: Chosen) -> None:
    number = chosen.face.pose(chosen.s)
    pose = next((p for p in chosen.s.state.poses if p.number == number), None)
    if pose is None:
        return
    chosen.ask(
        Typed(
            title=f"Note to pose {pose.number}", text="What should be remembered?", value=pose.note
        ),
        lambda again, said: again.hand(
            TaskKind.NOTE, "noting", lambda o: o.note(pose.number, said)
        ),
    )


def _calibrate(chosen: Chosen) -> None:
    s = chosen.s
    chosen.hand(
        TaskKind.CALIBRATE, "calibrating", lambda o: o.calibrate(s.estimator, s.unsensed_joints)
    )


def _other_estimator(s: SessionSnapshot) -> str:
    return "paper" if s.estimator == "implicit" else "implicit"


def _estimator(chosen: Chosen) -> None:
    chosen.runner.publish(lambda s: replace(s, estimator=_other_estimator(s)))


def _next_unsensed(s: SessionSnapshot) -> tuple[int, ...]:
    """None, each RVDT joint, all of them, and round again."""
    bent = [k for k, j in enumerate(s.procedure.arm.joints, 1) if isinstance(j.sensor, Rvdt)]
    choices: list[tuple[int, ...]] = [(), *((k,) for k in bent)]
    if len(bent) > 1:
        choices.append(tuple(bent))
    at = choices.index(s.unsensed_joints) if s.unsensed_joints in choices else 0
    return choices[(at + 1) % len(choices)]


def _unsensed(chosen: Chosen) -> None:
    chosen.runner.publish(lambda s: replace(s, unsensed_joints=_next_unsensed(s)))


def _upload(chosen: Chosen, forced: str = "") -> None:
    serial = "" if chosen.s.identity is None else chosen.s.identity.serial_number
    text = (
        f"The arm is held, the files are written, and the controller of {serial} takes the new "
        f"parameters. Type the arm's serial number, {serial}, to confirm."
    )
    chosen.ask(
        Typed(title="Upload to the controller?", text=text, expected=serial),
        lambda again, _: again.hand(TaskKind.UPLOAD, "uploading", lambda o: o.upload(forced)),
    )


def _force(chosen: Chosen) -> None:
    why = "; ".join(chosen.s.solution.reasons) if chosen.s.solution is not None else ""
    text = (
        f"Not accepted: {why}. Why are these parameters to be used all the same? The reason is kept "
        "in the journal and in the file."
    )

    def because(again: Chosen, said: str) -> None:
        if said.strip():
            _upload(again, said.strip())
        else:
            again.face.refuse("nothing was sent: it takes a reason")

    chosen.ask(Typed(title="Upload all the same?", text=text), because)


def _verify(chosen: Chosen) -> None:
    text = f"The arm moves to {VERIFY_POSES} new poses by itself. Stand clear; any key stops it."
    chosen.ask(
        YesNo(title="Verify with new poses?", text=text, yes="Move"),
        lambda again, _: again.hand(
            TaskKind.VERIFY,
            f"moving to {VERIFY_POSES} new poses",
            lambda o: o.verify(VERIFY_POSES),
        ),
    )


def _report(chosen: Chosen) -> None:
    s, runner = chosen.s, chosen.runner

    def work(_: Operations) -> None:
        target = chosen.face.write_report(s, runner)
        runner.publish(lambda now: replace(now, report=target))
        runner.say(Level.INFO, f"report written: {target}")

    chosen.hand(TaskKind.EXPORT, "writing the report", work)


def _hold(chosen: Chosen) -> None:
    chosen.runner.cancel()
    chosen.hand(TaskKind.HOLD, "holding all joints", lambda o: o.hold())


def _go_to(step: Step, face: FullScreen) -> None:
    face.go(step)


def _apply_prompt(s: SessionSnapshot) -> str:
    names = " and ".join(map(str, s.wanted_joints))
    return f"Put joints {names} into position mode, the others free"


def _may_apply(s: SessionSnapshot) -> Missing:
    return guards.may_apply_modes(s, s.wanted_joints)


# -- the table -------------------------------------------------------------------------------------

ACTIONS: tuple[Action | OnScreen, ...] = (
    OnScreen(name="stop", keys=STOP_KEYS, shown="SPACE/F8", label="STOP",
             help="Software STOP: quick stop to all drives, latched. F8 works everywhere, SPACE "
             "outside of text. It is not an emergency stop: that is the hardware button.",
             footer=EVERYWHERE, work=lambda f: f.stop()),
    OnScreen(name="primary", keys=("enter",), shown="Enter", label="Next thing",
             help="Do the next thing of this step, as the line above the footer says; when there is "
             "none, go on to the next step.", footer=EVERYWHERE, work=lambda f: f.do_next_thing()),
    Action(name="connect", keys=("c",), shown="c", label="Connect", prompt="Connect",
           help="Find the arm on the bus and check its identity.", steps=_at(Step.CONNECT),
           guard=guards.may_connect,
           work=_task(TaskKind.CONNECT, "connecting", lambda o: o.connect())),
    Action(name="stop_tested", keys=("t",), shown="t", label="Stop tested",
           prompt="Confirm: the hardware stop was pressed and every drive dropped out",
           help="Confirm that the hardware stop was pressed and every drive dropped out.",
           steps=_at(Step.CONNECT), footer=_at(Step.CONNECT), offered=lambda s: not s.simulated,
           work=_stop_tested),
    Action(name="resume", keys=("o",), shown="o", label="Open session",
           prompt="Open an earlier session", help="Resume an earlier session.",
           steps=_at(Step.CONNECT, Step.EXPORT), footer=_at(Step.CONNECT), work=_resume),
    Action(name="procedure", keys=("p",), shown="p", label="Procedure",
           prompt="Begin another session with another procedure",
           help="Take another procedure: fixture, drive joints, how poses are chosen. It begins a "
           "new session.", steps=_at(Step.CONNECT, Step.FIXTURE), footer=_at(Step.FIXTURE),
           work=_procedure),
    Action(name="check_fixture", keys=("k",), shown="k", label="Check again",
           prompt="Check the fixture again",
           help="Judge the fixture's placement again where the arm stands now.",
           steps=_at(Step.FIXTURE), guard=guards.may_check_fixture,
           work=_task(TaskKind.CHECK, "checking the fixture", lambda o: o.check_fixture())),
    Action(name="confirm", keys=(), shown="Enter", label="Confirm",
           help="Tick the marked item of the check list, or the next one that is open.",
           steps=_at(Step.FIXTURE), rows=open_items, work=_confirm),
    Action(name="confirm_all", keys=(), shown="Enter", label="Tick all",
           prompt="Tick every item: nothing here is real",
           help="Tick the whole check list at once, on a simulated arm.", steps=_at(Step.FIXTURE),
           offered=lambda s: s.simulated and bool(open_items(s)), guard=guards.may_tick_all,
           work=_confirm_all),
    OnScreen(name="tick", keys=("x",), shown="x", label="Tick",
             help="Tick the marked item of the check list, or take its tick away.",
             steps=_at(Step.FIXTURE), work=_toggle_item),
    OnScreen(name="toggle_mode", keys=("f",), shown="f", label="Free/Pos",
             help="Ask for the other mode of the marked joint; nothing happens until it is applied.",
             steps=_at(Step.MODES), footer=_at(Step.MODES), work=_toggle_joint),
    Action(name="suggest", keys=("p",), shown="p", label="Best pair",
           prompt="Take the best ranked joints", help="Mark the best ranked drive joints instead.",
           steps=_at(Step.MODES), footer=_at(Step.MODES), guard=guards.may_suggest,
           work=lambda chosen: _mark(chosen.runner, chosen.s.ranked[0].drives)),
    Action(name="joints", keys=("j",), shown="j", label="Joints", prompt="Choose other joints",
           help="Type which joints drive; nothing happens until they are applied.",
           steps=_at(Step.MODES), work=_other_joints),
    Action(name="apply_modes", keys=("a",), shown="a", label="Apply", prompt=_apply_prompt,
           help="Take control and set the modes as marked, after a question; they are read back.",
           steps=_at(Step.MODES), guard=_may_apply, work=_apply_modes),
    Action(name="wiggle", keys=("w",), shown="w", label="Wiggle",
           prompt="Trial wiggle: 2 deg and back",
           help="Move each drive joint by 2 deg and back, to see what follows. Any key stops.",
           steps=_at(Step.MODES), footer=_at(Step.MODES), guard=guards.may_move,
           work=_task(TaskKind.WIGGLE, "trial wiggle", lambda o: o.wiggle())),
    Action(name="automatic", keys=("a",), shown="a", label="Automatic",
           prompt="Capture all poses that are left, automatically",
           help="Move, settle and capture, pose after pose, until there are enough. Any key stops.",
           steps=_at(Step.CAPTURE), guard=guards.may_run_automatically,
           work=_task(TaskKind.AUTOMATIC, "moving and capturing automatically",
                      lambda o: o.automatic())),
    Action(name="go", keys=("g",), shown="g", label="Go", prompt="Move to the next pose",
           help="Move to the next planned pose. Any key stops.", steps=_at(Step.CAPTURE),
           footer=_at(Step.CAPTURE), guard=guards.may_move,
           work=lambda chosen: _go(chosen, chosen.s.next_waypoint)),
    Action(name="go_best", keys=("b",), shown="b", label="Go to best",
           prompt="Go to the pose that would tell most",
           help="Move to the pose that would tell most. Any key stops.", steps=_at(Step.CAPTURE),
           guard=guards.may_go_best, work=lambda chosen: _go(chosen, chosen.s.best_waypoint)),
    Action(name="capture", keys=("c",), shown="c", label="Capture", prompt="Capture a pose here",
           help="Let the arm settle and capture a pose where it stands.", steps=_at(Step.CAPTURE),
           footer=_at(Step.CAPTURE), guard=guards.may_capture, work=_capture),
    Action(name="undo", keys=("u",), shown="u", label="Undo", prompt="Take back the last pose",
           help="Take back the last pose; the journal remembers it.", steps=_at(Step.CAPTURE),
           footer=_at(Step.CAPTURE), guard=guards.may_edit_pose,
           work=_task(TaskKind.NOTE, "taking back a pose", lambda o: o.undo())),
    Action(name="note", keys=("n",), shown="n", label="Note", prompt="Note to a pose",
           help="Write a note to the marked pose.", steps=_at(Step.CAPTURE),
           guard=guards.may_edit_pose, work=_note),
    Action(name="exclude", keys=("x",), shown="x", label="Exclude",
           prompt="Exclude a pose, or let it count again",
           help="Leave the marked pose out of the calibration, or let it count again.",
           steps=_at(Step.CAPTURE), guard=guards.may_edit_pose, work=_exclude),
    Action(name="calibrate", keys=("s",), shown="s", label="Solve",
           prompt=lambda s: f"Calibrate, estimator {s.estimator}",
           help="Calibrate from the poses that count.", steps=_at(Step.CALIBRATE),
           guard=guards.may_calibrate, work=_calibrate),
    Action(name="estimator", keys=("e",), shown="e", label="Estimator",
           prompt=lambda s: f"Use the {_other_estimator(s)} estimator",
           help="Change between the implicit and the paper's estimator.",
           steps=_at(Step.CALIBRATE), footer=_at(Step.CALIBRATE), guard=guards.idle,
           work=_estimator),
    Action(name="unsensed", keys=("j",), shown="j", label="Unsensed",
           help="Change which joints count as unsensed: none, each RVDT joint, all of them.",
           steps=_at(Step.CALIBRATE), footer=_at(Step.CALIBRATE), guard=guards.idle,
           work=_unsensed),
    OnScreen(name="cancel", keys=("z",), shown="z", label="Cancel",
             help="End the work in hand; a moving arm comes to rest and holds.",
             work=lambda f: None if f.runner is None else f.runner.cancel()),
    Action(name="write", keys=("w",), shown="w", label="Write file",
           prompt="Write parameters.yaml and poses.csv",
           help="Write parameters.yaml and poses.csv into the session folder.",
           steps=_at(Step.EXPORT), guard=guards.may_write,
           work=_task(TaskKind.EXPORT, "writing the files", lambda o: o.write())),
    Action(name="upload", keys=("u",), shown="u", label="Upload", prompt="Upload to the controller",
           help="Upload the parameters to the controller, after typing the arm's serial number; "
           "they are read back.", steps=_at(Step.EXPORT), guard=guards.may_upload, work=_upload),
    Action(name="force", keys=("U",), shown="U", label="Upload all the same",
           help="Upload a calibration that was not accepted, after typing why and the arm's serial "
           "number.", steps=_at(Step.RESULTS), guard=guards.may_force, work=_force),
    Action(name="verify", keys=("y",), shown="y", label="Verify",
           prompt=f"Verify with {VERIFY_POSES} new poses",
           help="Move to new poses and judge them by the parameters found. Any key stops.",
           steps=_at(Step.EXPORT), footer=_at(Step.EXPORT), guard=guards.may_verify, work=_verify),
    Action(name="report", keys=("r",), shown="r", label="Report",
           help="Write report.html, one page about this calibration, into the session folder.",
           steps=_at(Step.EXPORT), footer=_at(Step.EXPORT), guard=guards.may_report, work=_report),
    Action(name="new_session", keys=("N",), shown="N", label="New session",
           help="Close this session, leave the arm held, and begin another.",
           steps=_at(Step.EXPORT), footer=_at(Step.EXPORT), work=_new_session),
    OnScreen(name="view", keys=("v",), shown="v", label="View",
             help="Show the next panel or plot of this step.", footer=_at(Step.RESULTS),
             work=lambda f: f.turn_over()),
    OnScreen(name="next", keys=("right_square_bracket",), shown="]", label="Next",
             help="Go to the next step, if its conditions hold.", work=lambda f: f.go_by(1)),
    OnScreen(name="back", keys=("left_square_bracket",), shown="[", label="Back",
             help="Go back a step; nothing is lost.", footer=EVERYWHERE - {Step.CONNECT},
             work=lambda f: f.go_by(-1)),
    OnScreen(name="down", keys=("down",), shown="Down", label="Down",
             help="Mark the next row of the list.", work=lambda f: f.move(1)),
    OnScreen(name="up", keys=("up",), shown="Up", label="Up",
             help="Mark the row before.", work=lambda f: f.move(-1)),
    Action(name="reset", keys=("R",), shown="R", label="Reset STOP",
           prompt="Reset STOP; nothing moves",
           help="Clear a latched STOP or a drive fault. Nothing moves; the drives stay disabled.",
           offered=lambda s: not guards.may_reset(s), guard=guards.may_reset,
           work=_task(TaskKind.RESET, "resetting STOP", lambda o: o.reset())),
    Action(name="hold", keys=("H",), shown="H", label="Hold all",
           help="All joints to position mode where they are.", guard=guards.may_use_data,
           work=_hold),
    OnScreen(name="help", keys=("question_mark", "f1"), shown="?", label="Help",
             help="Explain the focused panel and list the keys.", footer=EVERYWHERE,
             work=lambda f: f.explain()),
    OnScreen(name="palette", keys=("ctrl+p", "colon"), shown="Ctrl+P", label="All actions",
             help="Find any action by name.", work=lambda f: f.find()),
    OnScreen(name="theme", keys=("T",), shown="T", label="Theme",
             help="Change between dark, light and no colour.", work=lambda f: f.change_look()),
    OnScreen(name="quit", keys=QUIT_KEYS, shown="q", label="Quit",
             help="Leave, after a question: the arm is held, the session is kept.",
             footer=EVERYWHERE, work=lambda f: f.leave()),
    *(
        OnScreen(name=f"step_{int(step)}", keys=(str(int(step)),), shown=str(int(step)),
                 label=step.title, help=f"Go to step {int(step)}, {step.title}, if it is open.",
                 work=partial(_go_to, step))
        for step in Step
    ),
)  # fmt: skip


def by_name(name: str) -> Action | OnScreen:
    """Return an action."""
    return next(a for a in ACTIONS if a.name == name)


def for_key(key: str, step: Step) -> Action | OnScreen | None:
    """Return what a key does at a step."""
    return next((a for a in ACTIONS if key in a.keys and step in a.steps), None)


def footer(step: Step) -> tuple[Action | OnScreen, ...]:
    """Return what the footer of a step shows, at most six; everything else is in palette and help."""
    shown = [a for a in ACTIONS if step in a.steps & a.footer]
    for name in GIVE_WAY:
        if len(shown) > MOST_IN_FOOTER:
            shown = [a for a in shown if a.name != name]
    return tuple(shown[:MOST_IN_FOOTER])


def prompts(step: Step) -> tuple[list[Action], list[Action]]:
    """Return what plain mode lists: the actions of a step, and those of every step."""
    here = [a for a in ACTIONS if isinstance(a, Action) and step in a.steps]
    common = [a for a in here if a.steps == EVERYWHERE]
    return [a for a in here if a not in common], common
