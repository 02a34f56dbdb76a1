"""`sarcal eds`: electronic data sheets of joint drive and supervisor, for other CANopen tools."""

from __future__ import annotations

import argparse
from pathlib import Path

from operator_app.commands.options import a_path, option
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import say


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    option(
        parser,
        "-o --output DIR",
        "folder to write joint.eds and supervisor.eds into (default: this one)",
        type=a_path,
        default=Path(),
    )


def execute(args: argparse.Namespace) -> int:
    """Write the files; a different file of the same name is never overwritten."""
    from hardware.eds import EDS_FILES
    from operator_app.config.atomic import write_atomically

    sheets = {args.output / sheet.name: sheet.read_bytes() for sheet in EDS_FILES.values()}
    for target, data in sheets.items():
        if target.exists() and (not target.is_file() or target.read_bytes() != data):
            raise UsageError(f"{target} exists and differs; name another folder with -o")
    try:
        args.output.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"-o: {args.output} cannot be created: {error.strerror}") from error
    for target, data in sheets.items():
        write_atomically(target, data)
        say(f"EDS         {target}")
    return ExitCode.ACCEPTED
