"""`sarcal` without a command: the terminal app, or with --plain the workflow as prompts."""

from __future__ import annotations

import argparse
import os
import signal
import sys
from collections.abc import Callable, Sequence
from contextlib import AbstractContextManager
from dataclasses import replace
from typing import TYPE_CHECKING, NoReturn

from operator_app.commands.help_topic import manual
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import say

if TYPE_CHECKING:
    from pathlib import Path

    from operator_app.session.ui.sessions import Sessions
    from operator_app.session.workflow.opening import Opening, Rig


def execute(args: argparse.Namespace) -> int:
    """Run until the operator quits; return the exit code."""
    if args.tracker == "stdin":
        raise UsageError(
            "--tracker stdin: standard input is the keyboard here; use tcp:HOST:PORT or file:PATH"
        )
    if not args.plain and os.environ.get("TERM") == "dumb":
        # Such a terminal passes on whole lines only: a single key, such as the space bar for STOP, would not arrive.
        raise UsageError("the terminal app cannot run in this terminal (TERM=dumb): use --plain")
    if not args.plain and not (sys.stdin.isatty() and sys.stdout.isatty()):
        raise UsageError("the terminal app needs a terminal: use --plain, or `sarcal run`")
    made: list[Sessions] = []

    def make_source() -> Sessions:
        from hardware.timing import Pace
        from operator_app.commands.choices import choices_from, recording
        from operator_app.composition import open_arm
        from operator_app.config.user_settings import valid_settings
        from operator_app.session.ui.sessions import Sessions

        usual, warning = valid_settings()
        choices = replace(choices_from(args, journal=False), operator=usual.operator)

        def join(opening: Opening) -> AbstractContextManager[Rig]:
            return open_arm(
                opening, pace=Pace.REAL_TIME, speed=args.speed, record_to=recording(args, opening)
            )

        made.append(
            Sessions(args.procedure, choices, root=args.sessions, join=join, warning=warning)
        )
        return made[0]

    reason = _plain(args, make_source()) if args.plain else _full_screen(args, make_source)
    return _report_end(made, reason, plain=args.plain)


def _report_end(made: Sequence[Sessions], reason: str, *, plain: bool) -> int:
    for sessions in made:
        if sessions.lost is not None:
            say(f"sarcal: {sessions.lost}", err=True)
        if sessions.last is not None:
            say(farewell(sessions, sessions.last, reason, plain=plain), err=True)
        if sessions.not_held is not None:
            say(f"sarcal: {sessions.not_held}", err=True)
            return ExitCode.ARM_FAULT
    return ExitCode.ACCEPTED if reason in ("left", "end of input") else ExitCode.INTERRUPTED


def farewell(sessions: Sessions, folder: Path, reason: str, *, plain: bool = False) -> str:
    """Return the message at the end: final state of the arm, session folder, and how to resume."""
    how = {"left": "", "interrupted": "interrupted; "}.get(reason, f"ended by {reason}; ")
    arm = "the arm is held. " if sessions.held else ""
    if sessions.held is False:
        arm = "the arm did not answer: keep clear, its state is unknown. "
    if sessions.not_held is not None and sessions.not_held.powered:
        arm = "the arm is not held: keep clear. "
    message = f"sarcal: {how}{arm}Session {folder}\n"
    if sessions.exported:
        message += f"parameters.yaml and poses.csv are in it. Report: sarcal report {folder}\n"
    return f"{message}Go on with: sarcal {'--plain ' if plain else ''}--resume {folder}"


def _full_screen(args: argparse.Namespace, make_source: Callable[[], Sessions]) -> str:
    from operator_app.config.user_settings import valid_settings
    from operator_app.tui.app import SarcalApp, run
    from operator_app.tui.theme import DARK, LIGHT, NO_COLOUR

    settings, _ = valid_settings()
    usual = {"dark": DARK, "light": LIGHT, "none": NO_COLOUR}[settings.theme or "dark"]
    app = SarcalApp(
        make_source,
        theme=LIGHT if args.light else usual,
        ascii_only=args.ascii or "utf" not in (sys.stdout.encoding or "").lower(),
        resume=args.resume,
        manual=manual(),
    )
    return run(app)


class _Ended(BaseException):
    """Raised when a signal requests that this process end."""


def _plain(args: argparse.Namespace, source: Sessions) -> str:
    from operator_app.headless.plain import Plain, Terminal
    from operator_app.signals import ending_signals_ignored

    def end(number: int, _: object) -> NoReturn:
        raise _Ended(signal.Signals(number).name)

    before = {n: signal.signal(n, end) for n in (signal.SIGTERM, signal.SIGHUP)}
    # Ctrl-C means STOP.
    before[signal.SIGINT] = signal.signal(signal.SIGINT, signal.default_int_handler)
    reason = "failed"
    try:
        reason = Plain(source, Terminal(), resume=args.resume, manual=manual()).run()
    except _Ended as ended:
        reason = str(ended)
    except KeyboardInterrupt:
        reason = "interrupted"
    finally:
        with ending_signals_ignored():
            source.close(reason)
        for number, handler in before.items():
            signal.signal(number, handler)
    return reason
