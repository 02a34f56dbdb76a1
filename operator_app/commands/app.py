"""`sarcal` without a command: the terminal app, or with --plain the same workflow as prompts."""

from __future__ import annotations

import argparse
import sys

from operator_app.commands.options import (
    bus_options,
    choices_from,
    scenario_options,
    sessions_option,
)
from operator_app.exit_codes import ExitCode, UsageError


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "--procedure", default="hinge", help="procedure file or built-in name (hinge)"
    )
    parser.add_argument("--poses", type=int, metavar="N", help="how many poses to capture")
    parser.add_argument(
        "--resume", metavar="SESSION", help="go on with a session: folder, name or latest"
    )
    parser.add_argument("--ascii", action="store_true", help="only ASCII characters")
    parser.add_argument(
        "--plain", action="store_true", help="numbered prompts instead of a full screen"
    )
    parser.add_argument("--light", action="store_true", help="begin with the light theme")
    parser.add_argument(
        "--speed",
        type=float,
        default=1.0,
        metavar="N",
        help="let the embedded virtual arm run N times faster than real time (default 1)",
    )
    sessions_option(parser)
    bus_options(parser)
    scenario_options(parser)


def execute(args: argparse.Namespace) -> int:
    """Run until the operator leaves."""
    from operator_app.tui.app import run
    from operator_app.tui.look import DARK, LIGHT
    from operator_app.tui.source import ComposedSource

    if not 0.0 < args.speed <= 50.0:
        raise UsageError("--speed: between 0 and 50 times real time")
    if not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError("the terminal app needs a terminal: use --plain, or `sarcal run`")
    source = ComposedSource(
        args.procedure, choices_from(args), root=args.sessions, speed=args.speed
    )
    reason = run(
        source,
        theme=LIGHT if args.light else DARK,
        ascii_only=args.ascii,
        resume=args.resume,
    )
    if source.last is not None:
        how = "left" if reason == "left" else f"ended by {reason}"
        print(
            f"sarcal: {how}; the arm is held. The session is kept in {source.last}.",
            file=sys.stderr,
        )
        print(f"Go on with: sarcal --resume {source.last}", file=sys.stderr)
    return ExitCode.INTERRUPTED if reason.startswith("SIG") else ExitCode.ACCEPTED
