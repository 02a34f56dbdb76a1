"""What is said of a run that did not come to its end: the arm, the poses, the way on. Knows no terminal."""

from __future__ import annotations

from hardware.errors import DriveFault, HardwareError, MappingDiffers, WrongArm
from hardware.objects import EmergencyCode
from operator_app.composition import CutShort
from operator_app.session.folder import read_session

_SILENT = (
    "The arm did not answer when it was told to hold: nobody here knows what it does. Its drives hold by "
    "themselves when they miss the operator's heartbeat. Look before you go near."
)


def cut_short_lines(found: CutShort) -> list[str]:
    """Sentences, the most important first."""
    session, state = found.session, found.session.state
    interrupted = isinstance(found.cause, KeyboardInterrupt)
    said = "The run was interrupted" if interrupted else "The run has ended early"
    # Of this run: what an earlier one had connected to may not be there any more.
    connected = session.identity is not None
    if connected and found.held:
        said += "; the arm is held"
    folder = session.journal.kept_in
    if session.journal.loss is not None:
        return [f"{said}. What could be kept is in {folder}."]
    # The journal's: an interrupt may come between a line and its being counted.
    kept = read_session(folder).state if found.kept else None
    poses = len(state.poses if kept is None else kept.poses)
    lines = [f"{said}; no pose was taken."]
    if poses:
        lines = [f"{said}. {poses} poses are kept in {folder}.", *_way_on(found)]
    if connected and not found.held:
        lines.insert(0, _SILENT)
    return lines


def _way_on(found: CutShort) -> list[str]:
    """Say how to go on: nothing where resuming would end in the same words."""
    cause, session = found.cause, found.session
    folder = session.journal.path.parent
    goes_on = f"Go on with: sarcal run --resume {folder}"
    if isinstance(cause, DriveFault) and cause.code != EmergencyCode.HEARTBEAT_LOST:
        embedded = session.state.settings.get("interface") in (None, "virtual")
        reset = "" if embedded else f" Then clear its trip with: sarcal reset {folder}"
        return [f"Find out what joint {cause.joint} met.{reset}", goes_on]
    wrong = isinstance(cause, MappingDiffers | WrongArm)
    if isinstance(cause, KeyboardInterrupt) or (isinstance(cause, HardwareError) and not wrong):
        return [goes_on]
    return []
