"""The table of commands with their summaries, and their modules."""

from __future__ import annotations

import argparse
import importlib
from typing import Any

COMMANDS = {
    "run": "calibrate an arm from start to finish, without questions",
    "plan": "choose drive joints and poses before anything moves",
    "solve": "calibrate from a file of poses, without an arm",
    "import": "make a session from poses or a joint log of your own",
    "verify": "test a calibration with new poses",
    "export": "write, show or upload the parameters of a session",
    "report": "write an HTML report of a session",
    "compare": "show what drifted between two calibrations",
    "history": "show what shifted over all calibrations of one arm, and when the next is due",
    "reproduce": "reproduce the paper: tables, figures, sources of error, remedies",
    "new": "make an arm, fixture or procedure file",
    "check": "show all problems of files, or the outlook of a calibration with them",
    "session": "list sessions, show one, or repair a damaged journal",
    "probe": "show which nodes are on a bus and whether they can be driven; moves nothing",
    "arm-check": "check an arm on the bench in a safe order; asks before anything moves",
    "monitor": "watch a bus beside a running session; sends nothing",
    "reset": "clear drive faults and a STOP; moves nothing",
    "settings": "show or change your defaults: bus, theme, operator",
    "eds": "write the EDS files of joint drive and supervisor",
    "controller": "run the virtual controller as a process",
    "help": "show a page of the manual",
}

APP = "app"
"""Without a command: the terminal app, whose options belong to `sarcal` itself."""


def module(command: str) -> Any:
    """Import and return the module of a command."""
    # `import` is a Python keyword, `help` a builtin.
    name = {"import": "import_poses", "help": "help_topic"}.get(command, command.replace("-", "_"))
    return importlib.import_module(f"operator_app.commands.{name}")


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of one command, `app` for `sarcal` itself, as its help page shows it."""
    made = argparse.ArgumentParser(prog="sarcal" if command == APP else f"sarcal {command}")
    module(command).add_arguments(made)
    return made
