"""Progress of `sarcal run` on stderr: messages, and a report if the run is interrupted."""

from hardware import errors
from hardware.canopen.objects import EmergencyCode
from operator_app.composition import CutShort
from operator_app.messages.errors import lateness_words, stopped_words, trip_cause_remedy, words
from operator_app.safe_output import sanitized, say
from operator_app.session.store.folders import read_session
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from operator_app.units import plural


class ConsoleListener(Listener):
    """Writes the progress of a run to stderr."""

    def __init__(self) -> None:
        self._late_times = 0

    def report(self, text: str) -> None:
        """Write one line."""
        say(sanitized(text), err=True)

    def resumed(self, session: Session) -> None:
        """Report an incomplete last line of the journal, if any, and the number of used poses of a resumed session."""
        if session.journal.contents.torn:
            self.report(f"{session.journal.contents.torn}.")
        self._late_times = session.state.late.times
        self.report(f"Resuming with {len(session.state.used_poses)} poses.")

    def cut_short(self, cut: CutShort) -> None:
        """Report what has been saved of a run that ended early, and how to continue."""
        for line in cut_short_lines(cut):
            self.report(line)

    def pose_captured(self, state: SessionState, total: int) -> None:
        """Report the pose, the number of used poses out of `total`, and any new delays of this computer."""
        if new := state.late.times - self._late_times:
            self._late_times = state.late.times
            self.report(f"Warning: {lateness_words(state.late, new)}.")
        self.report(f"Pose {state.captured} captured ({len(state.used_poses)} of {total}).")


def cut_short_lines(cut: CutShort) -> list[str]:
    """Return the messages about a run that ended early, the most important first."""
    session, state = cut.session, cut.session.state
    interrupted = isinstance(cut.cause, KeyboardInterrupt)
    what = "The run was interrupted" if interrupted else "The run ended early"
    if cut.connected and session.held:
        what += "; the arm is held"
    folder = session.journal.kept_folder
    if session.journal.loss is not None:
        return [*_danger(cut), f"{what}. The rescued entries are in {folder}."]
    # Read the journal: an interrupt may come after an event is written to it and before the state has the event.
    saved_state = read_session(folder).state if cut.kept else None
    poses = len(state.poses if saved_state is None else saved_state.poses)
    lines = [*_danger(cut), *_lateness(cut)]
    if isinstance(cut.cause, errors.DriveDiverged):
        # The arm has just moved by itself: state the cause first.
        lines.append(f"{stopped_words(str(cut.cause))}.")
    if not poses:
        return [*lines, f"{what}; no pose was captured."]
    kept = f"{plural(poses, 'pose')} {'is' if poses == 1 else 'are'} kept in {folder}."
    return [*lines, f"{what}. {kept}", *_how_to_continue(cut)]


def _danger(cut: CutShort) -> list[str]:
    """Return a warning if the arm did not confirm that it holds; none after an interrupt: `unattended` then raises."""
    error = cut.session.not_held
    if error is None or not cut.connected or isinstance(cut.cause, KeyboardInterrupt):
        return []
    return [str(words(error))]


def _lateness(cut: CutShort) -> list[str]:
    """Return a message if drives tripped because this computer sent its heartbeat too late."""
    cause, late = cut.cause, cut.session.reader.recorded_latency
    tripped = isinstance(cause, errors.DriveFault) and cause.code == EmergencyCode.HEARTBEAT_LOST
    if not tripped or late.times == 0:
        return []
    again = "" if late.times == 1 else f" ({late.times} times, by {late.longest_s:.2f} s at most)"
    text = f"This computer was late by {late.last_s:.2f} s{again}: the drives missed its heartbeat."
    return [f"{text} End other programs on it, or give sarcal real-time priority."]


def _how_to_continue(cut: CutShort) -> list[str]:
    """Return lines on how to continue the session; empty if a resumed session would fail again."""
    cause, session = cut.cause, cut.session
    folder = session.journal.path.parent
    goes_on = f"Go on with: sarcal run --resume {folder}"
    if isinstance(cause, errors.DriveDropout):
        return [f"Find out why the drive of joint {cause.joint} dropped out.", goes_on]
    if isinstance(cause, errors.DriveFault) and cause.code != EmergencyCode.HEARTBEAT_LOST:
        embedded = session.state.settings.get("interface") in (None, "virtual")
        reset = "" if embedded else f" Then clear its trip with: sarcal reset {folder}"
        return [f"{trip_cause_remedy(cause.code)}.{reset}", goes_on]
    if isinstance(cause, errors.DriveDiverged):
        return [
            f"Only when you know why joint {cause.joint} diverged: {goes_on[0].lower()}{goes_on[1:]}"
        ]
    wrong = isinstance(cause, errors.MappingMismatch | errors.PdoSetupFailed | errors.WrongArm)
    if isinstance(cause, KeyboardInterrupt) or (
        isinstance(cause, errors.HardwareError) and not wrong
    ):
        return [goes_on]
    return []
