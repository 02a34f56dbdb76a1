"""`sarcal history`: accepted calibrations and verifications of an arm, and shifts between them."""

import argparse
import math
from datetime import timedelta
from pathlib import Path

from operator_app.config.atomic import write_atomically
from operator_app.documents import arm_history
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.report.html.page import history_html
from operator_app.report.results.history import history_json, history_text
from operator_app.safe_output import as_json, say
from operator_app.session.store.folders import list_sessions
from operator_app.session.workflow.importing import UNKNOWN_SERIAL_NUMBER


def _only_serial(root: Path) -> str:
    states = [entry.state for entry in list_sessions(root)]
    serials = sorted(
        {s.serial_number for s in states if s is not None} - {"", UNKNOWN_SERIAL_NUMBER}
    )
    if not states:
        raise UsageError(f"there are no sessions in {root}; name another folder with --sessions")
    if not serials:
        raise UsageError(
            f"no session in {root} states a serial number; import with --serial to state one"
        )
    if len(serials) > 1:
        raise UsageError(f"name one of the serial numbers in {root}: {', '.join(serials)}")
    return serials[0]


def execute(args: argparse.Namespace) -> int:
    """Read the sessions and print the history."""
    if args.serial == UNKNOWN_SERIAL_NUMBER:
        raise UsageError(
            "sessions without a serial number may be from several arms; import with --serial"
        )
    history = arm_history(
        args.serial or _only_serial(args.sessions),
        args.sessions,
        kept_mounted=args.kept_mounted,
        interval=None if args.every is None else timedelta(days=math.ceil(args.every)),
    )
    if args.output is not None:
        write_atomically(args.output, history_html(history))
    if args.json:
        say(as_json(history_json(history)))
    else:
        say(history_text(history))
        if args.output is not None:
            say(f"\nPage        {args.output}")
    return ExitCode.NOT_ACCEPTED if history.shifted else ExitCode.ACCEPTED
