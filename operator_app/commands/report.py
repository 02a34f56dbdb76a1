"""`sarcal report`: the report of a session as an HTML page, text or JSON."""

import argparse
import sys
from dataclasses import replace
from pathlib import Path

from operator_app.commands.options import unsensed_joints
from operator_app.config.atomic import write_atomically
from operator_app.exit_codes import ExitCode
from operator_app.report.html.page import REPORT_NAME, report_html
from operator_app.report.plots.figure_files import save_figures
from operator_app.report.results.session import result_text
from operator_app.report.subject import subject_of_session
from operator_app.safe_output import say
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.store.stored_calibration import session_calibration, with_checks
from operator_app.session.workflow.opening import Choices, resume
from solver.errors import UnidentifiableError


def execute(args: argparse.Namespace) -> int:
    """Read the session's calibration and show it."""
    opening = resume(args.session, Choices(), root=args.sessions)
    procedure, folder = opening.effective_procedure, opening.folder
    unsensed = unsensed_joints(args, procedure.arm.joint_count)
    contents = read_journal(folder)
    # Not `opening.state`: a session that is still capturing may have grown since that was read.
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
    subject = subject_of_session(
        folder, contents, procedure, calibration, unidentifiable=unidentifiable
    )
    solution, result = subject.solution, unidentifiable or subject.facts
    if not (args.json or args.text or args.plots):
        _write(args, report_html(subject), folder)
    elif args.plots and solution is not None:
        for file in save_figures(subject, args.plots):
            say(f"Figure      {file}")
    elif result is not None:
        options = {"estimator": args.estimator, "unsensed_joints": unsensed}
        stated = {name: value for name, value in options.items() if value is not None}
        say(result_text(result, replace(procedure, **stated), folder, state, in_json=args.json))
    if solution is None:
        return ExitCode.NOT_IDENTIFIABLE
    return ExitCode.ACCEPTED if solution.accepted else ExitCode.NOT_ACCEPTED


def _write(args: argparse.Namespace, page: bytes, folder: Path) -> None:
    if str(args.output) == "-":
        sys.stdout.buffer.write(page)
    else:
        target = args.output or folder / REPORT_NAME
        write_atomically(target, page)
        say(f"Report      {target}")
