"""Handlers of the actions: they submit tasks to the runner, after confirmation where one is needed."""

from collections.abc import Callable
from dataclasses import replace

from hardware.arm import JointMode
from operator_app.config.procedure_file import load_procedure
from operator_app.config.resources import builtin_names
from operator_app.messages.errors import summary
from operator_app.session.store.folders import SessionEntry
from operator_app.session.ui import guards
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level, SessionSnapshot, TaskKind
from operator_app.session.ui.user_interface import ActionContext, OneOf, Typed
from operator_app.session.workflow.remounting import remounting_steps
from operator_app.units import MOVED, joints_named, names, others_free

VERIFY_POSES = 5


def task(
    kind: TaskKind, work: Callable[[Operations], None], text: str = ""
) -> Callable[[ActionContext], None]:
    """Return a handler that submits `work` as a task, without asking for confirmation."""
    return lambda context: context.submit(kind, work, text)


def connect(context: ActionContext) -> None:
    """Connect; before the first pose of a later placement, ask first whether the fixture is mounted."""
    state = context.s.state
    work = task(TaskKind.CONNECT, lambda o: o.connect())
    if context.s.simulated or not state.unconfirmed_placement:
        work(context)
    else:
        confirmation = (
            f"Placement {state.placement} has no pose yet. Is the {context.s.procedure.fixture.name} mounted, the "
            "loop closed, and nobody within reach of the arm?"
        )
        context.confirm("Is the fixture mounted?", confirmation, "Mounted", work)


def manual(context: ActionContext) -> None:
    """Ask which page of the manual to show, and show it."""
    interface = context.interface
    options = tuple((topic, f"{topic}: {title}") for topic, title in interface.topics().items())
    interface.ask(OneOf(title="Manual", text="Which page?", options=options), interface.show_page)


def history(context: ActionContext) -> None:
    """Show all calibrations of the connected arm or, if none is connected, of the session's arm."""
    context.interface.show_history(guards.serial_number(context.s))


def apply_modes(context: ActionContext) -> None:
    """Set the selected modes, after confirmation."""
    joints = context.s.selected_joints
    text = f"The drives are enabled; {_modes_text(context.s)}. Nothing moves yet. Stand clear of the arm."
    doing = f"setting {_selected_text(context.s, 'to')}"
    work = task(TaskKind.MODES, lambda o: o.set_modes(joints), doing)
    context.confirm("Apply the modes?", text, "Apply", work)


def _modes_text(s: SessionSnapshot) -> str:
    free = len(s.selected_joints) < s.procedure.arm.joint_count
    return _selected_text(s, "in") + (" (they yield when pushed)" if free else "")


def _selected_text(s: SessionSnapshot, word: str) -> str:
    others = others_free(len(s.selected_joints), s.procedure.arm.joint_count)
    return f"{names(f'J{j}' for j in s.selected_joints)} {word} position mode{others}"


def standing_alarms(s: SessionSnapshot) -> dict[int, str]:
    """Return the prompt to acknowledge each alarm, by alarm number, the newest first."""
    return {a.number: f"Acknowledge the alarm of {a.time}" for a in s.alarms[::-1]}


def acknowledge(context: ActionContext) -> None:
    """Acknowledge the shown alarm; if its text is only partly visible, show the whole text first."""
    shown = context.interface.alarm(context.s)
    alarm = next((a for a in context.s.alarms if shown and a.number == shown.number), None)
    if shown is None or alarm is None:
        return
    if shown.all_visible:
        context.runner.acknowledge(alarm.number)
    else:
        title = f"Alarm of {alarm.time}"
        context.confirm(
            title, alarm.text, "Acknowledge", lambda again: again.runner.acknowledge(alarm.number)
        )


def automatic(context: ActionContext) -> None:
    """Capture the missing poses; ask for confirmation first if a real arm moves."""
    doing = "moving and capturing automatically"
    begin = task(TaskKind.AUTOMATIC, lambda o: o.automatic(), doing)
    if not guards.moves_real_arm(context.s):
        begin(context)
        return
    text = (
        "The arm moves by itself from pose to pose until all are captured. Nobody may be within its reach; "
        "a person keeps a hand on the hardware stop. Any key stops the arm."
    )
    context.confirm("Capture automatically?", text, "Move", begin)


def go(context: ActionContext, waypoint: int | None) -> None:
    """Move to a waypoint (index from 0); if None, show that all waypoints are visited."""
    if waypoint is None:
        context.interface.refuse(guards.ALL_VISITED)
        return
    context.submit(TaskKind.MOVE, lambda o: o.go(waypoint), f"moving to waypoint {waypoint + 1}")


def home(context: ActionContext) -> None:
    """Go home, after confirmation: the path may leave the explored box, and nobody has checked that it is clear."""
    s = context.s
    ways = [
        (j, s.procedure.arm.home_rad[j - 1] - s.arm.joints[j - 1].position_rad)
        for j, mode in enumerate(s.state.modes, 1)
        if mode is JointMode.POSITION and s.arm is not None
    ]
    text = (
        "The drive joints go straight home at 5 deg/s, and the free joints follow: "
        + ", ".join(f"J{j} by {MOVED(float(way)).with_unit}" for j, way in ways)
        + ". Check that the path is clear, and stand clear of the arm. Any key stops it."
    )
    context.confirm("Go home?", text, "Move", task(TaskKind.HOME, lambda o: o.go_home()))


def capture(context: ActionContext) -> None:
    """Capture a pose at the arm's current position."""
    at = -1 if context.s.at_waypoint is None else context.s.at_waypoint
    context.submit(TaskKind.CAPTURE, lambda o: o.capture(at))


def exclude(context: ActionContext) -> None:
    """Exclude the selected pose, or include it again."""
    number = context.interface.pose(context.s)
    if number is not None:
        context.submit(TaskKind.NOTE, lambda o: o.exclude(number), "excluding a pose")


def note(context: ActionContext) -> None:
    """Ask for a note and attach it to the selected pose."""
    number = context.interface.pose(context.s)
    pose = None if number is None else context.s.state.pose(number)
    if pose is None:
        return
    context.ask(
        Typed(title=f"Note to pose {pose.number}", text="Text of the note:", value=pose.note),
        lambda again, answer: again.submit(TaskKind.NOTE, lambda o: o.note(pose.number, answer)),
    )


def calibrate(context: ActionContext) -> None:
    """Calibrate with the selected estimator and unsensed joints."""
    s = context.s
    context.submit(TaskKind.CALIBRATE, lambda o: o.calibrate(s.estimator, s.unsensed_joints))


def upload(context: ActionContext, forced: str = "") -> None:
    """Upload after the operator has typed the serial number; `forced`: reason if the calibration was not accepted."""
    serial = "" if context.s.identity is None else context.s.identity.serial_number
    first = "The arm is held" if guards.powered(context.s) else "The drives stay off"
    text = (
        f"{first}, the files are written, and the controller of {serial} takes the new "
        f"parameters. Type the arm's serial number, {serial}, to confirm."
    )
    question = Typed(title="Upload to the controller?", text=text, expected=serial)
    work = task(TaskKind.UPLOAD, lambda o: o.write(upload=True, forced=forced))
    context.ask(question, lambda again, _: work(again))


def force(context: ActionContext) -> None:
    """Upload a calibration that was not accepted, after the operator has typed a reason."""
    reasons = "; ".join(context.s.solution.reasons) if context.s.solution is not None else ""
    text = (
        f"Not accepted: {reasons}. Why should these parameters be used? The reason is kept in the journal and in "
        "the file."
    )

    def because(again: ActionContext, answer: str) -> None:
        if answer.strip():
            upload(again, answer.strip())
        else:
            again.interface.refuse("nothing was uploaded: a reason is required")

    context.ask(Typed(title="Upload without acceptance?", text=text), because)


def verify(context: ActionContext) -> None:
    """Verify with new poses, after confirmation, since the arm moves by itself."""
    joints = () if guards.in_modes(context.s) else context.s.selected_joints
    text = f"The arm moves to {VERIFY_POSES} new poses by itself. Stand clear. Any key stops it."
    if joints:
        text = f"The drives are enabled again, {_modes_text(context.s)}. {text}"
    doing = f"moving to {VERIFY_POSES} new poses"
    work = task(TaskKind.VERIFY, lambda o: o.verify(VERIFY_POSES, joints), doing)
    context.confirm("Verify with new poses?", text, "Move", work)


def report(context: ActionContext) -> None:
    """Write the report page, in the worker thread."""
    runner = context.runner

    def work(_: Operations) -> None:
        target = context.interface.write_report(runner)
        runner.publish(lambda now: replace(now, report=target))
        runner.say(Level.INFO, f"report written: {target}")

    context.submit(TaskKind.EXPORT, work, "writing the report")


def hold(context: ActionContext) -> None:
    """Cancel the running task, then hold all joints."""
    context.runner.cancel()
    context.submit(TaskKind.HOLD, lambda o: o.hold(), "holding all joints")


def apply_prompt(s: SessionSnapshot) -> str:
    """Return the plain-mode prompt of `apply_modes`, which names the selected joints."""
    others = others_free(len(s.selected_joints), s.procedure.arm.joint_count)
    return f"Put {joints_named(s.selected_joints)} into position mode{others}"


def resume(context: ActionContext) -> None:
    """Resume an earlier session, chosen from a list."""
    interface = context.interface
    folder_name = context.runner.session.journal.path.parent.name
    options = tuple(
        (e.folder.name, f"{e.folder.name}  {_in_a_line(e)}")
        for e in interface.sessions.sessions()
        if e.folder.name != folder_name
    )
    if not options:
        interface.refuse("there is no other session to resume")
        return
    text = "A resumed session checks arm, fixture and modes again before anything moves."
    question = OneOf(title="Open a session", text=text, options=options[:50])
    interface.ask(
        question, lambda answer: interface.open(lambda: interface.sessions.resumed(answer))
    )


def _in_a_line(entry: SessionEntry) -> str:
    if entry.state is None:
        return f"cannot be read: {entry.problem}"
    state = entry.state
    stage = "exported" if state.exported else "solved" if state.solved else "captured"
    return f"{len(state.used_poses)} poses, {stage}"


def procedure(context: ActionContext) -> None:
    """Start a session with another procedure, chosen from a list."""
    interface = context.interface
    procedures = map(load_procedure, builtin_names("procedure"))
    options = tuple((p.name, summary(p)) for p in procedures)
    text = f"This session is closed and kept{_held(context.s)}, and a new session starts."
    question = OneOf(title="Which procedure?", text=text, options=options)
    interface.ask(question, lambda answer: interface.open(lambda: interface.sessions.new(answer)))


def _held(s: SessionSnapshot) -> str:
    return ", the arm is held" if s.connected else ""


def new_session(context: ActionContext) -> None:
    """Start another session, after confirmation."""
    interface = context.interface
    text = f"This session is closed and kept{_held(context.s)}, and a new session starts at step 1."
    context.confirm("New session?", text, "Start", lambda _: interface.open(interface.sessions.new))


def remount(context: ActionContext) -> None:
    """Release the arm and go on to the next placement, after a confirmation that lists the operator's steps."""
    interface = context.interface
    steps = "\n".join((*remounting_steps(context.s.procedure), "5. Only then connect."))
    text = (
        f"This session continues in placement {context.s.state.placement + 1}, at step 1, and keeps its poses. "
        "The drives are still on. Releasing the arm switches them off, and nothing commands the arm then. Leave "
        f"its controller on, so that no counter is reset.\n{steps}"
    )
    context.confirm(
        "Remount the fixture?",
        text,
        "Release the arm",
        lambda _: interface.open(interface.sessions.remounted),
    )
