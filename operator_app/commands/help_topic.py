"""`sarcal help`: the manual in the terminal, page by page. Needs no network and no session."""

from __future__ import annotations

import argparse
import shutil
import sys

from operator_app.commands.table import APP, COMMANDS, parser_of
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.manual.pages import SECTIONS, Manual
from operator_app.manual.reference import reference
from operator_app.words_out import say

WIDEST = 100
"""Longer lines are hard to read, however wide the terminal is."""

APP_SUMMARY = "open the terminal app"


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "topic", nargs="?", metavar="TOPIC", help="page or command; without it, all topics"
    )
    parser.add_argument("--markdown", action="store_true", help="print the page as it is written")


def execute(args: argparse.Namespace) -> int:
    """Print a page, the options of a command, or the list of topics."""
    from operator_app.manual.commands_page import command_section
    from operator_app.manual.pages import NoSuchTopicError
    from operator_app.manual.shown import as_text

    found = manual()
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
