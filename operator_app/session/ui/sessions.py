"""Opens and closes sessions for a user interface; only one session is open at a time."""

from collections.abc import Callable
from contextlib import AbstractContextManager, ExitStack
from pathlib import Path

from operator_app.config.procedure_file import load_procedure
from operator_app.errors import DrivesNotOffError, JournalLostError, SessionError
from operator_app.session.safety.sensor_faults import require_no_sensor_fault
from operator_app.session.store.folders import SessionEntry, documents_of, list_sessions
from operator_app.session.store.journal import is_in_use
from operator_app.session.ui.runner import Runner
from operator_app.session.ui.snapshot import Level
from operator_app.session.workflow.opening import (
    Choices,
    Opening,
    Rig,
    begin,
    open_session,
    remove_if_empty,
    resume,
)
from operator_app.session.workflow.remounting import record_in


class Sessions:
    """Opens and closes the sessions of one folder.

    `procedure`: built-in name or path; None: ``hinge``.
    `choices`: options of the command line.
    `join`: function that returns, for an `Opening`, a context manager that yields the `Rig`, i.e. the arm.
    `warning`: first message to the operator; "" for none.

    Attributes of the session that was closed last:
    `last`: folder; None if the folder was empty and has been removed.
    `exported`: whether parameters were written.
    `held`: whether the arm confirmed that no drive follows commands; None if no arm was connected.
    `lost`: error about the lost journal; None if the journal was not lost.
    `not_held`: error stating that drives may still follow commands; None if the arm confirmed the opposite.
    """

    def __init__(
        self,
        procedure: str | None,
        choices: Choices,
        *,
        root: Path,
        join: Callable[[Opening], AbstractContextManager[Rig]],
        warning: str = "",
    ) -> None:
        self._procedure, self._choices, self.root, self._join = procedure, choices, root, join
        self._warning = warning
        self._stack = ExitStack()
        self._runner: Runner | None = None
        self.last: Path | None = None
        self.held: bool | None = None
        self.exported = False
        self.lost: JournalLostError | None = None
        self.not_held: DrivesNotOffError | None = None

    def new(self, procedure: str | None = None) -> Runner:
        """Start a session and return its runner; `procedure`, if given, becomes the default for later sessions."""
        named = procedure or self._procedure or "hinge"
        runner = self._open(
            begin(named, self._choices, root=self.root), "another session was started"
        )
        self._procedure = procedure or self._procedure
        return runner

    def resumed(self, reference: str) -> Runner:
        """Resume a session and return its runner; `reference`: folder or name of the session, or ``latest``."""
        opening = resume(reference, self._choices, root=self.root)
        return self._open(opening, "another session was resumed")

    def remounted(self) -> Runner:
        """Close the open session and resume it in the next placement; raises DrivesNotOffError if a drive is on."""
        if self._runner is None:
            raise SessionError("no session is open", "start or resume one")
        session = self._runner.session
        folder, number = session.journal.path.parent, session.state.placement + 1
        self.close("the fixture is remounted")
        session.require_drives_off()
        require_no_sensor_fault(session.state, "remounting is refused")
        record_in(folder, "remounting", number)
        runner = self.resumed(str(folder))
        runner.say(
            Level.WARNING,
            f"The drives are off. Secure the arm, remount the {session.procedure.fixture.name}, close the "
            "loop; only then connect.",
        )
        return runner

    @property
    def is_open(self) -> bool:
        """Whether a session is open."""
        return self._runner is not None

    def sessions(self) -> tuple[SessionEntry, ...]:
        """Return all sessions, newest first."""
        return list_sessions(self.root)[::-1]

    def unfinished(self) -> SessionEntry | None:
        """Return the newest session that has used poses and no export; None if there is none.

        Leaves out sessions that are in use and, if a procedure was chosen, sessions of other procedures.
        """
        named = None if self._procedure is None else load_procedure(self._procedure).name
        for entry in self.sessions():
            state = entry.state
            if state is None or not state.used_poses or state.exported or is_in_use(entry.folder):
                continue
            if named in (None, documents_of(state)[0]):
                return entry
        return None

    def close(self, reason: str) -> None:
        """Close the open session. May be called twice."""
        runner, self._runner = self._runner, None
        if runner is not None:
            session = runner.session
            connected = session.identity is not None
            try:
                runner.close(reason)
            finally:
                self._stack.close()
                self.held = session.held if connected else None
                self.exported = bool(session.state.exported)
                self.last = None if remove_if_empty(session) else session.journal.kept_folder
                self.lost = session.journal.loss
                self.not_held = session.not_held
                # Reported in the next session.
                self._warning = runner.supervisor.recording_problem()

    def _open(self, opening: Opening, closing_reason: str) -> Runner:
        """Open a session, then close the previous one (the journal records `closing_reason`); return the new runner."""
        with ExitStack() as stack:
            session = open_session(stack.enter_context(self._join(opening)))
            stack.callback(session.journal.close)
            runner = Runner(session)
            opened = stack.pop_all()
        self.close(closing_reason)
        if self._warning:
            runner.say(Level.WARNING, self._warning)
            self._warning = ""
        for problem in (self.lost, self.not_held):
            if problem is not None:
                runner.say(Level.ALARM, str(problem))
        self._runner, self._stack = runner, opened
        return runner
