"""`sarcal report`: one HTML page about a session, read from its journal."""

from __future__ import annotations

import argparse
import sys
from pathlib import Path

from operator_app.commands.options import estimator_options, parse_joints, sessions_option
from operator_app.exit_codes import ExitCode


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("session", metavar="SESSION", help="session folder, its name or latest")
    parser.add_argument(
        "-o",
        "--output",
        type=Path,
        metavar="FILE",
        help="write the page there (default: report.html in the session folder; - is stdout)",
    )
    estimator_options(parser)
    sessions_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Read the session's calibration and write the page."""
    from operator_app.commands.options import require_joints
    from operator_app.composition import carried_procedure
    from operator_app.config.atomic import write_atomically
    from operator_app.report.html import report_html
    from operator_app.report.subject import subject_of_session
    from operator_app.session.journal import read_journal
    from operator_app.session.opening import Choices, resume

    unsensed = parse_joints(args.unsensed) if args.unsensed else None
    opening = resume(args.session, Choices(), root=args.sessions)
    procedure = carried_procedure(opening)
    require_joints(unsensed or (), procedure.arm.joint_count)
    contents = read_journal(opening.folder)
    subject = subject_of_session(
        opening.folder.resolve().name,
        contents.events,
        procedure,
        torn=contents.torn,
        estimator=args.estimator,
        unsensed_joints=unsensed,
    )
    page = report_html(subject)
    if str(args.output) == "-":
        sys.stdout.buffer.write(page)
    else:
        target = args.output or opening.folder / REPORT_NAME
        write_atomically(target, page)
        print(f"Report      {target}")
    if subject.solution is None:
        return ExitCode.NOT_IDENTIFIABLE
    return ExitCode.ACCEPTED if subject.solution.accepted else ExitCode.NOT_ACCEPTED


REPORT_NAME = "report.html"
