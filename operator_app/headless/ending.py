"""What is said of a run that did not come to its end: the arm, the poses, the way on. Knows no terminal."""

from __future__ import annotations

from hardware.canopen.objects import STOP_CONTACTS, EmergencyCode
from hardware.errors import (
    DriveAstray,
    DriveFault,
    DriveLeft,
    HardwareError,
    MappingDiffers,
    NotConfigured,
    WrongArm,
)
from operator_app.composition import CutShort
from operator_app.messages.errors import stopped_words, words
from operator_app.session.store.folders import read_session
from operator_app.units.numbers import plural


def cut_short_lines(found: CutShort) -> list[str]:
    """Sentences, the most important first."""
    session, state = found.session, found.session.state
    interrupted = isinstance(found.cause, KeyboardInterrupt)
    said = "The run was interrupted" if interrupted else "The run has ended early"
    if found.connected and found.held:
        said += "; the arm is held"
    folder = session.journal.kept_in
    if session.journal.loss is not None:
        return [*_danger(found), f"{said}. What could be kept is in {folder}."]
    # The journal's: an interrupt may come between a line and its being counted.
    kept = read_session(folder).state if found.kept else None
    poses = len(state.poses if kept is None else kept.poses)
    lines = [f"{said}; no pose was taken."]
    if poses:
        lines = [
            f"{said}. {plural(poses, 'pose')} {'is' if poses == 1 else 'are'} kept in {folder}.",
            *_way_on(found),
        ]
    if isinstance(found.cause, DriveAstray):
        # Whoever stands there has just seen it move: before anything else, why, and what to do.
        lines.insert(0, f"{stopped_words(str(found.cause))}.")
    if late := _late(found):
        lines.insert(0, late)
    return [*_danger(found), *lines]


def _danger(found: CutShort) -> list[str]:
    """Say that the arm is not held, before anything else; who interrupts a run is told so by its end."""
    left = found.session.not_held
    if left is None or not found.connected or isinstance(found.cause, KeyboardInterrupt):
        return []
    said = words(left)
    return [f"{said.happened}. {said.remedy}."]


def _late(found: CutShort) -> str:
    """Say that this computer was late, where that is why drives tripped: at the next pose it would be too late."""
    cause = found.cause
    if not (isinstance(cause, DriveFault) and cause.code == EmergencyCode.HEARTBEAT_LOST):
        return ""
    late = found.session.late_here
    if late.times == 0:
        return ""
    again = (
        "" if late.times == 1 else f", {late.times} times in all, by {late.longest_s:.2f} s at most"
    )
    return (
        f"This computer was late by {late.last_s:.2f} s{again}: the drives missed its heartbeat for that. End "
        "other programs on it, or give this one real-time priority."
    )


def _way_on(found: CutShort) -> list[str]:
    """Say how to go on: nothing where resuming would end in the same words."""
    cause, session = found.cause, found.session
    folder = session.journal.path.parent
    goes_on = f"Go on with: sarcal run --resume {folder}"
    if isinstance(cause, DriveFault) and cause.code != EmergencyCode.HEARTBEAT_LOST:
        embedded = session.state.settings.get("interface") in (None, "virtual")
        reset = "" if embedded else f" Then clear its trip with: sarcal reset {folder}"
        if cause.code in STOP_CONTACTS:
            return [f"Release the external stop when it is safe.{reset}", goes_on]
        if isinstance(cause, DriveLeft):
            return [
                f"Find out why joint {cause.joint}'s drive did not stay as it was put.",
                goes_on,
            ]
        return [f"Find out what joint {cause.joint} met.{reset}", goes_on]
    if isinstance(cause, DriveAstray):
        return [
            f"Only when you know why joint {cause.joint} went astray: {goes_on[0].lower()}{goes_on[1:]}"
        ]
    wrong = isinstance(cause, MappingDiffers | NotConfigured | WrongArm)
    if isinstance(cause, KeyboardInterrupt) or (isinstance(cause, HardwareError) and not wrong):
        return [goes_on]
    return []
