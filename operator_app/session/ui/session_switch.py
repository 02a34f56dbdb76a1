"""Which session is open: another one, one of another procedure, the same in another placement.

Knows no screen and no terminal.
"""

from __future__ import annotations

from operator_app.messages.errors import summary
from operator_app.session.store.folders import SessionEntry
from operator_app.session.store.state import SessionState
from operator_app.session.ui.user_interface import Chosen, OneOf, YesNo
from operator_app.session.workflow.placements import remounting_steps


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
