"""The commands there are, what each is for in a line, and where its parser and its work are. Runs none."""

from __future__ import annotations

import argparse
import importlib
from typing import Any

COMMANDS = {
    "run": "calibrate an arm from start to finish, without questions",
    "plan": "choose drive joints and poses before anything moves",
    "solve": "calibrate from a file of poses, without an arm",
    "import": "make a session out of poses or a joint log of your own",
    "verify": "judge new poses by a calibration made before them",
    "export": "write, show or upload the parameters of a session",
    "report": "write an HTML report of a session",
    "compare": "say what drifted between two calibrations",
    "history": "say what shifted over all calibrations of one arm, and when the next is due",
    "reproduce": "reproduce the paper: its tables, its figures, its sources of error, its remedies",
    "new": "make an arm, fixture or procedure file",
    "check": "say all that is wrong with files, or what would be done with them",
    "session": "list sessions, show one, or repair the journal of one that is damaged",
    "probe": "say which nodes are on a bus and whether they can be driven; moves nothing",
    "arm-check": "check an arm on the bench in a safe order; asks before anything moves",
    "monitor": "watch a bus beside a running session; sends nothing",
    "reset": "clear tripped drives and a STOP; moves nothing",
    "settings": "show or change what you always want: bus, theme, operator",
    "eds": "write the EDS files of joint drive and supervisor",
    "controller": "run the virtual controller as its own process",
    "help": "show a page of the manual",
}

APP = "app"
"""Without a command: the terminal app, whose options belong to `sarcal` itself."""


def module(command: str) -> Any:
    """Return the module of a command, imported when it is wanted."""
    # `import` is a word of Python's, and `help` has its own module's name for itself.
    name = {"import": "import_poses", "help": "help_topic"}.get(command, command.replace("-", "_"))
    return importlib.import_module(f"operator_app.commands.{name}")


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of one command, `app` for `sarcal` itself, as its help page shows it."""
    made = argparse.ArgumentParser(prog="sarcal" if command == APP else f"sarcal {command}")
    module(command).add_arguments(made)
    return made
