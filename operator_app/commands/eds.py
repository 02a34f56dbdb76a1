"""`sarcal eds`: electronic data sheets of joint drive and supervisor, for other CANopen tools."""

import argparse

from hardware.eds import EDS_FILES
from operator_app.commands.options import make_folder
from operator_app.config.atomic import write_atomically
from operator_app.config.resources import exists
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import say


def execute(args: argparse.Namespace) -> int:
    """Write the files; an existing file with other contents is never overwritten."""
    sheets = {args.output / sheet.name: sheet.read_bytes() for sheet in EDS_FILES.values()}
    for target, data in sheets.items():
        if exists(target) and (not target.is_file() or target.read_bytes() != data):
            raise UsageError(f"{target} exists and differs; name another folder with -o")
    make_folder("-o", args.output)
    for target, data in sheets.items():
        write_atomically(target, data)
        say(f"EDS         {target}")
    return ExitCode.ACCEPTED
