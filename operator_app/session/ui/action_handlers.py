"""What the actions of a session ask of its arm and its solver when their guards hold: hand work over, ask first.

`actions` says which there are. Knows no screen and no terminal.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

from hardware.arm import DriveState, JointMode
from operator_app.messages.errors import summary
from operator_app.planning.mode_rule import and_the_others
from operator_app.session.store.folders import SessionEntry
from operator_app.session.store.state import SessionState
from operator_app.session.ui import guards
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Level, SessionSnapshot, TaskKind
from operator_app.session.ui.user_interface import Chosen, OneOf, Typed, YesNo
from operator_app.session.workflow.placements import remounting_steps
from operator_app.units.figure import MOVED
from operator_app.units.numbers import joints_named, names

VERIFY_POSES = 5


def task(kind: TaskKind, text: str, work: Callable[[Operations], None]) -> Callable[[Chosen], None]:
    """Work that is handed over as it is."""
    return lambda chosen: chosen.hand(kind, text, work)


def connect(chosen: Chosen) -> None:
    """Connect; in a placement of which nothing is known yet, once somebody says that its fixture is mounted."""
    state, text = chosen.s.state, "connecting"
    if not state.unseen:
        chosen.hand(TaskKind.CONNECT, text, lambda o: o.connect())
    elif chosen.s.simulated:
        # Nobody has to do anything.
        chosen.hand(TaskKind.CONNECT, text, lambda o: o.connect_mounted())
    else:
        said = (
            f"Placement {state.placement} has no pose yet. Is its {chosen.s.procedure.fixture.name} mounted, the "
            "loop closed, and nobody within reach of the arm?"
        )
        chosen.ask(
            YesNo(title="Is the fixture mounted?", text=said, yes="Mounted"),
            lambda again, _: again.hand(TaskKind.CONNECT, text, lambda o: o.connect_mounted()),
        )


def manual(chosen: Chosen) -> None:
    """Show a page of the manual, after asking which."""
    face = chosen.face
    options = tuple((topic, f"{topic}: {said}") for topic, said in face.topics().items())
    face.ask(OneOf(title="Manual", text="Which page?", options=options), face.show_page)


def history(chosen: Chosen) -> None:
    """Show all calibrations of the connected arm, or of the arm of this session."""
    chosen.face.show_history(guards.serial_number(chosen.s))


def apply_modes(chosen: Chosen) -> None:
    """Set the modes as marked, after a question."""
    joints = chosen.s.wanted_joints
    count = chosen.s.procedure.arm.joint_count
    driven = names(f"J{j}" for j in joints)
    text = f"The drives are enabled; {_modes_words(chosen.s)}. Nothing moves yet. Stand clear of the arm."
    chosen.ask(
        YesNo(title="Apply the modes?", text=text, yes="Apply"),
        lambda again, _: again.hand(
            TaskKind.MODES,
            f"setting {driven} to position mode{and_the_others(len(joints), count)}",
            lambda o: o.set_modes(joints),
        ),
    )


def _modes_words(s: SessionSnapshot) -> str:
    """Say which modes are applied, and what that means for whoever stands there."""
    joints, count = s.wanted_joints, s.procedure.arm.joint_count
    free = "" if len(joints) == count else ": those give way when pushed"
    driven = names(f"J{j}" for j in joints)
    return f"{driven} in position mode{and_the_others(len(joints), count)}{free}"


def standing_alarms(s: SessionSnapshot) -> dict[int, str]:
    """Return the alarms that can be acknowledged, the newest first."""
    return {a.number: f"Acknowledge the alarm of {a.time}: it was seen" for a in s.alarms[::-1]}


def acknowledge(chosen: Chosen) -> None:
    """Let go of the alarm in sight; where not all its words fit, show them first."""
    shown = chosen.face.alarm(chosen.s)
    alarm = next((a for a in chosen.s.alarms if shown and a.number == shown.number), None)
    if shown is None or alarm is None:
        return
    if shown.whole:
        chosen.runner.acknowledge(alarm.number)
    else:
        chosen.ask(
            YesNo(title=f"Alarm of {alarm.time}", text=alarm.text, yes="Acknowledge"),
            lambda again, _: again.runner.acknowledge(alarm.number),
        )


def automatic(chosen: Chosen) -> None:
    """Take the poses that are left; where drives move a real arm by themselves, after a question."""

    def begin(again: Chosen) -> None:
        again.hand(
            TaskKind.AUTOMATIC, "moving and capturing automatically", lambda o: o.automatic()
        )

    if not guards.moves_metal(chosen.s):
        begin(chosen)
        return
    text = (
        "The arm moves by itself, pose after pose, until all are captured. Nobody within its reach; "
        "somebody has a hand on the hardware stop. Any key stops it."
    )
    chosen.ask(
        YesNo(title="Capture automatically?", text=text, yes="Move"), lambda again, _: begin(again)
    )


def go(chosen: Chosen, waypoint: int | None) -> None:
    """Move to a waypoint."""
    text = "moving" if waypoint is None else f"moving to waypoint {waypoint + 1}"
    chosen.hand(TaskKind.MOVE, text, lambda o: o.go(waypoint or 0))


def home(chosen: Chosen) -> None:
    """Take the arm home, after a question: nobody has spoken for the places on the way."""
    s = chosen.s
    ways = [
        (j, s.procedure.arm.home_rad[j - 1] - s.arm.joints[j - 1].position_rad)
        for j, mode in enumerate(s.modes, 1)
        if mode is JointMode.POSITION and s.arm is not None
    ]
    text = (
        "The drive joints go straight home, slowly, the free ones follow: "
        + ", ".join(f"J{j} by {MOVED(float(way)).with_unit}" for j, way in ways)
        + ". Look whether the way is clear, and stand clear of the arm; any key stops it."
    )
    chosen.ask(
        YesNo(title="Go home?", text=text, yes="Move"),
        lambda again, _: again.hand(TaskKind.HOME, "going home", lambda o: o.go_home()),
    )


def capture(chosen: Chosen) -> None:
    """Capture a pose where the arm is."""
    at = -1 if chosen.s.at_waypoint is None else chosen.s.at_waypoint
    chosen.hand(TaskKind.CAPTURE, "capturing", lambda o: o.capture(at))


def exclude(chosen: Chosen) -> None:
    """Exclude the pose that is meant, or let it count again."""
    number = chosen.face.pose(chosen.s)
    if number is not None:
        chosen.hand(TaskKind.NOTE, "excluding a pose", lambda o: o.exclude(number))


def note(chosen: Chosen) -> None:
    """Write a note to the pose that is meant."""
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


def calibrate(chosen: Chosen) -> None:
    """Calibrate as the settings say."""
    s = chosen.s
    chosen.hand(
        TaskKind.CALIBRATE,
        "calibrating",
        lambda o: o.results.calibrate(s.estimator, s.unsensed_joints),
    )


def upload(chosen: Chosen, forced: str = "") -> None:
    """Upload, after the arm's serial number was typed."""
    serial = "" if chosen.s.identity is None else chosen.s.identity.serial_number
    drives = chosen.s.arm.joints if chosen.s.arm is not None else ()
    held = any(j.drive is DriveState.OPERATION_ENABLED for j in drives)
    first = "The arm is held" if held else "The drives stay off"
    text = (
        f"{first}, the files are written, and the controller of {serial} takes the new "
        f"parameters. Type the arm's serial number, {serial}, to confirm."
    )
    chosen.ask(
        Typed(title="Upload to the controller?", text=text, expected=serial),
        lambda again, _: again.hand(
            TaskKind.UPLOAD, "uploading", lambda o: o.results.upload(forced)
        ),
    )


def force(chosen: Chosen) -> None:
    """Upload what was not accepted, after a reason was typed."""
    why = "; ".join(chosen.s.solution.reasons) if chosen.s.solution is not None else ""
    text = (
        f"Not accepted: {why}. Why are these parameters to be used all the same? The reason is kept "
        "in the journal and in the file."
    )

    def because(again: Chosen, said: str) -> None:
        if said.strip():
            upload(again, said.strip())
        else:
            again.face.refuse("nothing was sent: it takes a reason")

    chosen.ask(Typed(title="Upload all the same?", text=text), because)


def verify(chosen: Chosen) -> None:
    """Take new poses, after a question: the arm moves by itself."""
    joints = () if guards.in_modes(chosen.s) else chosen.s.wanted_joints
    text = f"The arm moves to {VERIFY_POSES} new poses by itself. Stand clear; any key stops it."
    if joints:
        text = f"The drives are enabled again, {_modes_words(chosen.s)}. {text}"
    chosen.ask(
        YesNo(title="Verify with new poses?", text=text, yes="Move"),
        lambda again, _: again.hand(
            TaskKind.VERIFY,
            f"moving to {VERIFY_POSES} new poses",
            lambda o: o.verify(VERIFY_POSES, joints),
        ),
    )


def report(chosen: Chosen) -> None:
    """Write the report page, on the worker's thread."""
    runner = chosen.runner

    def work(_: Operations) -> None:
        target = chosen.face.write_report(runner)
        runner.publish(lambda now: replace(now, report=target))
        runner.say(Level.INFO, f"report written: {target}")

    chosen.hand(TaskKind.EXPORT, "writing the report", work)


def hold(chosen: Chosen) -> None:
    """End what is under way, then hold all joints."""
    chosen.runner.cancel()
    chosen.hand(TaskKind.HOLD, "holding all joints", lambda o: o.hold())


def apply_prompt(s: SessionSnapshot) -> str:
    """Say which joints would be put into position mode."""
    others = and_the_others(len(s.wanted_joints), s.procedure.arm.joint_count)
    return f"Put {joints_named(s.wanted_joints)} into position mode{others}"


def resume(chosen: Chosen) -> None:
    """Take an earlier session, chosen from a list."""
    face = chosen.face
    here = chosen.runner.session.journal.path.parent.name
    options = tuple(
        (e.folder.name, f"{e.folder.name}  {_in_a_line(e)}")
        for e in face.sessions.sessions()
        if e.folder.name != here
    )
    if not options:
        face.refuse("there is no other session to resume")
        return
    text = "Resuming checks the arm, the fixture and the modes again before anything moves."
    question = OneOf(title="Open a session", text=text, options=options[:50])
    face.ask(question, lambda said: face.open(lambda: face.sessions.resumed(said)))


def _in_a_line(entry: SessionEntry) -> str:
    """Say what is in a session; one that cannot be read says why, and what to do once it is chosen."""
    if entry.state is None:
        return f"cannot be read: {entry.problem}"
    return f"{len(entry.state.used_poses)} poses, {_stage(entry.state)}"


def _stage(state: SessionState) -> str:
    if state.exported:
        return "exported"
    return "solved" if state.solved else "captured"


def procedure(chosen: Chosen) -> None:
    """Begin a session with another procedure, chosen from a list."""
    face = chosen.face
    options = tuple((p.name, summary(p)) for p in face.sessions.procedures())
    text = "A new session begins with it; this one is closed and kept, the arm is held."
    question = OneOf(title="Which procedure?", text=text, options=options)
    face.ask(question, lambda said: face.open(lambda: face.sessions.new(said)))


def new_session(chosen: Chosen) -> None:
    """Begin another session, after a question."""
    face = chosen.face
    text = "This session is closed and kept; the arm is held. Another one begins at step 1."
    face.ask(
        YesNo(title="New session?", text=text, yes="Begin"), lambda _: face.open(face.sessions.new)
    )


def remount(chosen: Chosen) -> None:
    """Let go of the arm and go on with the fixture mounted anew, after a question that says what to do."""
    face = chosen.face
    steps = " ".join(remounting_steps(chosen.s.procedure))
    text = (
        f"This session goes on in placement {chosen.s.state.placement + 1}, at step 1, and keeps its poses. "
        "The drives are still on; let go, and they are off, and nobody commands the arm any more. Leave its "
        f"controller on: its counters count. {steps} 5. Only then connect."
    )
    face.ask(
        YesNo(title="Mount the fixture anew?", text=text, yes="Let go of the arm"),
        lambda _: face.open(face.sessions.remounted),
    )
