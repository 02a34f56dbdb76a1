"""What `sarcal report` makes of a journal's events, and how a page writes a number."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace
from typing import Any

from hardware.virtual.scenarios import scenario
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.report.subject import Subject, subject_of_session
from operator_app.session.calibrated import calibrated, checked
from operator_app.session.journal import Event
from operator_app.session.replay import replay
from solver.errors import UnidentifiableError

HOSTILE = '<script>alert("1")</script></td></table>\u202e & \x07\ud800'


def procedure(poses: int) -> Procedure:
    found = load_procedure("hinge")
    return replace(
        found,
        arm=scenario("datasheet").arm(found.arm),
        capture=replace(found.capture, poses=poses, samples_per_pose=8),
    )


def subject_of(events: Sequence[Event], **options: Any) -> Subject:
    """As `sarcal report` reads a journal."""
    state = replay((e.name, e.data, e.utc) for e in events)
    try:
        found = calibrated(state, procedure(16), **options)
    except UnidentifiableError as error:
        return subject_of_session("session", events, procedure(16), None, unidentifiable=error)
    return subject_of_session(
        "session", events, procedure(16), checked(found, state, procedure(16))
    )


def number(words: str) -> float:
    return float(words.replace("\u2212", "-"))
