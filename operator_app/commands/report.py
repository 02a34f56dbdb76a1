"""`sarcal report`: report of a session as HTML page, text or JSON."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from operator_app.commands.options import given_joints, unsensed_joints
from operator_app.config.atomic import write_atomically
from operator_app.effective_procedure import effective_procedure
from operator_app.exit_codes import ExitCode
from operator_app.report.html.page import REPORT_NAME, report_html
from operator_app.report.plots.figure_files import save_figures
from operator_app.report.results.session import session_json, session_text, unidentifiable_json
from operator_app.report.subject import Subject, subject_of_session
from operator_app.report.text import facts_text, unidentifiable_text
from operator_app.safe_output import as_json, say
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import session_calibration, with_checks
from operator_app.session.workflow.opening import Choices, resume
from solver.errors import UnidentifiableError


def execute(args: argparse.Namespace) -> int:
    """Read the session's calibration and show it."""
    opening = resume(args.session, Choices(), root=args.sessions)
    procedure = effective_procedure(opening)
    unsensed = unsensed_joints(args, procedure.arm.joint_count)
    contents = read_journal(opening.folder)
    state = session_state(contents)
    calibration, unidentifiable = None, None
    try:
        # From the journal or, if it is not stored there, computed now; the report states which.
        calibration = session_calibration(
            state, procedure, estimator=args.estimator, unsensed_joints=unsensed
        )
        calibration = with_checks(calibration, state, procedure)
    except UnidentifiableError as error:
        unidentifiable = error
    name = opening.folder.resolve().name
    subject = subject_of_session(
        name,
        contents.events,
        procedure,
        calibration,
        torn=contents.torn,
        unidentifiable=unidentifiable,
    )
    if args.json or args.text:
        _print(args, subject, opening.folder, state)
    elif args.plots is not None:
        _draw(args.plots, subject)
    else:
        _write(args, subject, opening.folder)
    if subject.solution is None:
        return ExitCode.NOT_IDENTIFIABLE
    return ExitCode.ACCEPTED if subject.solution.accepted else ExitCode.NOT_ACCEPTED


def _print(args: argparse.Namespace, subject: Subject, folder: Path, state: SessionState) -> None:
    unidentifiable, solution, facts = subject.unidentifiable, subject.solution, subject.facts
    if unidentifiable is not None:
        if args.text:
            say(unidentifiable_text(unidentifiable))
            return
        data = unidentifiable_json(
            unidentifiable,
            subject.procedure,
            folder,
            state,
            estimator=args.estimator,
            unsensed_joints=given_joints(args.unsensed),
        )
        say(as_json(data))
    if solution is None or facts is None:
        return
    if args.json:
        data = session_json(facts, solution.paper, folder, state)
        say(as_json(data))
    else:
        say(f"{facts_text(facts)}\n\n{session_text(folder, state, accepted=solution.accepted)}")


def _draw(folder: Path, subject: Subject) -> None:
    if subject.unidentifiable is not None:
        say(unidentifiable_text(subject.unidentifiable))
        return
    for file in save_figures(subject, folder):
        say(f"Figure      {file}")


def _write(args: argparse.Namespace, subject: Subject, folder: Path) -> None:
    page = report_html(subject)
    if str(args.output) == "-":
        sys.stdout.buffer.write(page)
    else:
        target = args.output or folder / REPORT_NAME
        write_atomically(target, page)
        say(f"Report      {target}")
