"""`sarcal help`: the manual in the terminal."""

from __future__ import annotations

import argparse
import shutil
import sys
from pathlib import Path

from operator_app.commands.options import a_name, a_path
from operator_app.commands.table import APP, COMMANDS, parser_of
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.manual.pages import SECTIONS, Manual
from operator_app.manual.reference import reference
from operator_app.safe_output import say

WIDEST = 100
"""Longest line, in characters."""

APP_SUMMARY = "open the terminal app"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "topic",
        type=a_name,
        nargs="?",
        metavar="TOPIC",
        help="page or command; without it, all topics",
    )
    parser.add_argument("--markdown", action="store_true", help="print the page as Markdown")
    parser.add_argument(
        "--files",
        type=a_path,
        metavar="FOLDER",
        help="write the files of the page into a folder; never over existing files",
    )


def execute(args: argparse.Namespace) -> int:
    """Print a page, the options of a command, or the list of topics."""
    from operator_app.manual.commands_page import command_section
    from operator_app.manual.pages import NoSuchTopicError
    from operator_app.manual.shown import as_text

    found = manual()
    if args.files is not None:
        return _write_files(found, args.topic, args.files)
    if args.topic is None:
        text = _contents(found)
    elif args.topic in COMMANDS:
        text = command_section(parser_of(args.topic), COMMANDS[args.topic])
    else:
        try:
            text = found.page(args.topic).markdown
        except NoSuchTopicError as error:
            near = NoSuchTopicError(args.topic, (*found.topics, *COMMANDS))
            raise UsageError(f"{near}.") from error
    if args.markdown:
        say(text.rstrip("\n"))
        return ExitCode.ACCEPTED
    wide = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDEST
    say(as_text(text, min(wide, WIDEST)).rstrip("\n"))
    return ExitCode.ACCEPTED


def _write_files(found: Manual, topic: str | None, folder: Path) -> int:
    """Write the files of a page."""
    from operator_app.config.atomic import write_atomically
    from operator_app.manual.pages import NoSuchTopicError

    with_files = [t for t in found.topics if not found.made_by_code(t) and found.page(t).files]
    try:
        shown = found.page(topic or "").files
    except NoSuchTopicError as error:
        raise UsageError(f"--files: {error}.") from error
    if not shown:
        raise UsageError(
            f"--files: the page {topic} shows no files; these do: {', '.join(with_files)}"
        )
    there = [name for name in shown if (folder / name).exists()]
    if there:
        raise UsageError(f"--files: {folder / there[0]} exists already; name another folder")
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise UsageError(f"--files: {folder} cannot be made: {error.strerror}") from error
    for name, text in shown.items():
        write_atomically(folder / name, text.encode())
        say(f"{folder / name}")
    return ExitCode.ACCEPTED


def manual() -> Manual:
    """Return the manual of this program."""

    def commands() -> str:
        from operator_app.manual.commands_page import commands_page

        return commands_page({APP: APP_SUMMARY} | COMMANDS, parser_of)

    return Manual({**reference(), "commands": commands})


def _contents(found: Manual) -> str:
    """List the topics by section."""
    lines = ["# The manual of sarcal", "", "`sarcal help TOPIC` shows a page."]
    for section, topics in SECTIONS.items():
        lines += ["", f"## {section}", "", "| topic | what it is |", "|---|---|"]
        lines += [f"| `{topic}` | {found.summary(topic)} |" for topic in topics]
    return "\n".join([*lines, ""])
