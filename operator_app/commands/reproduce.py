"""`sarcal reproduce`: repeats the paper's experiment with a simulated arm of the same type."""

import argparse

from operator_app.exit_codes import ExitCode
from operator_app.planning.reproduction import published
from operator_app.report.results.reproduction import published_json, published_text
from operator_app.safe_output import as_json, say


def execute(args: argparse.Namespace) -> int:
    """Repeat the paper's experiment and print the results."""
    say("Capturing six sets of poses and calibrating ten times: about 30 s.", err=True)
    reproduction = published(poses=args.poses)
    say(as_json(published_json(reproduction)) if args.json else published_text(reproduction))
    return ExitCode.ACCEPTED
