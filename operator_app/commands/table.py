"""The table of commands with their summaries and modules, and their completion in a shell."""

from __future__ import annotations

import argparse
import importlib
import os
import shlex
from collections.abc import Iterable
from functools import partial
from pathlib import Path
from typing import TYPE_CHECKING, Any

if TYPE_CHECKING:
    from operator_app.config.resources import Kind

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
    "check": "show all problems of files, or whether a calibration with them can succeed",
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
"""Name for `sarcal` without a command, which opens the terminal app."""

ON_A_BUS = ("arm-check", "controller", "export", "monitor", "probe", "reset", "run", "verify", APP)
"""Commands that open a bus."""


def module(command: str) -> Any:
    """Import and return the module that does a command's work."""
    return importlib.import_module(f"operator_app.commands.{_module_name(command)}")


def _module_name(command: str) -> str:
    # `import` is a Python keyword, `help` a builtin.
    return {"import": "import_poses", "help": "help_topic"}.get(command, command.replace("-", "_"))


def declare(command: str, parser: argparse.ArgumentParser) -> None:
    """Declare the arguments and options of a command, without importing the module that does its work."""
    kind = "bus" if command in ON_A_BUS else "file"
    arguments = importlib.import_module(f"operator_app.commands.{kind}_arguments")
    getattr(arguments, _module_name(command))(parser)


def parser_of(command: str) -> argparse.ArgumentParser:
    """Return the parser of one command (`app` stands for `sarcal` itself), with its name and options."""
    made = argparse.ArgumentParser(prog="sarcal" if command == APP else f"sarcal {command}")
    declare(command, made)
    return made


FILE_ARGUMENTS: tuple[Kind, ...] = ("arm", "fixture", "procedure")
COMPLETED = (*FILE_ARGUMENTS, "packaged", "topic", "session", "name", "a", "b", "resume")
"""Destinations of the arguments and options whose values are completed; the last five are sessions."""


def words_to_complete() -> list[str] | None:
    """Return the words of the command line to be completed; None if no completion was requested."""
    if "_ARGCOMPLETE" not in os.environ:
        return None
    line = os.environ.get("COMP_LINE", "")
    try:
        return shlex.split(line)[1:]
    except ValueError:
        # A quotation mark is still open.
        return line.split()[1:]


def complete(parser: argparse.ArgumentParser, command: argparse.ArgumentParser | None) -> None:
    """Print the shell's completions and exit; return only if argcomplete is not installed."""
    try:
        import argcomplete  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        return
    for action in () if command is None else command._actions:  # noqa: SLF001 - not listed elsewhere
        if action.dest in COMPLETED:
            action.completer = partial(_names, action.dest)  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _names(
    dest: str, *, prefix: str, parsed_args: argparse.Namespace, **_: object
) -> Iterable[str]:
    if dest == "topic":
        from operator_app.manual.pages import SECTIONS

        return [topic for topics in SECTIONS.values() for topic in topics]
    from operator_app.config.resources import builtin_names

    if dest == "packaged":
        # The kind, as in `new arm --from`, is not parsed yet: take it from the typed words.
        typed = words_to_complete() or []
        return [name for kind in FILE_ARGUMENTS if kind in typed for name in builtin_names(kind)]
    if dest in FILE_ARGUMENTS:
        # A path is valid too, and is completed only if the prefix begins like a path.
        return [*builtin_names(dest), *_paths(prefix)]
    root = getattr(parsed_args, "sessions", None) or Path("sessions")
    folders = sorted(p.name for p in root.iterdir() if p.is_dir()) if root.is_dir() else []
    return ["latest", *folders, *_paths(prefix)]


def _paths(prefix: str) -> Iterable[str]:
    from operator_app.config.resources import expanded

    if "/" not in prefix and not prefix.startswith("."):
        return []
    where = expanded(prefix)
    folder = where if prefix.endswith("/") else where.parent
    return [f"{p}/" if p.is_dir() else str(p) for p in folder.glob("*")] if folder.is_dir() else []
