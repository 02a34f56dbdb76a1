"""`sarcal compare`: drift between two calibrations of an arm."""

import argparse

from operator_app.calibration.comparison import IncomparableError, compare
from operator_app.documents import parameters_at
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.report.results.comparison import comparison_json, comparison_text
from operator_app.safe_output import as_json, say


def execute(args: argparse.Namespace) -> int:
    """Compare the calibrations and print the result."""
    before = parameters_at(args.a, args.sessions)
    after = parameters_at(args.b, args.sessions)
    try:
        comparison = compare(before, after, level=args.level, remounted=args.remounted)
    except IncomparableError as error:
        raise UsageError(f"{args.a}, {args.b}: {error}") from error
    say(as_json(comparison_json(comparison)) if args.json else comparison_text(comparison))
    return ExitCode.NOT_ACCEPTED if comparison.drifted else ExitCode.ACCEPTED
