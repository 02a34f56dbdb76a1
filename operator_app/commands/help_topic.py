"""`sarcal help`: the manual in the terminal; also hooks for mkdocs, which builds a website from the manual."""

import argparse
import shutil
import sys
from functools import partial
from pathlib import Path
from typing import Any

from operator_app.commands.options import make_folder
from operator_app.commands.table import APP, COMMANDS, parser_of
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.manual.pages import (
    CONTENTS,
    SECTIONS,
    Manual,
    NoSuchTopicError,
    files_on,
    made_by_code,
)
from operator_app.safe_output import say

WIDEST = 100
"""Longest line, in characters."""
HELP_WIDTH = 78
"""Longest line, in characters, of the help of a command, which is not wrapped again."""


def execute(args: argparse.Namespace) -> int:
    """Print a page, the options of a command, or the list of topics; with ``--files``, write the files of a page."""
    from operator_app.manual.shown import as_text

    pages = manual()
    if args.files is not None:
        return _write_files(pages, args.topic, args.files)
    if args.topic is None:
        text = CONTENTS
    elif args.topic in COMMANDS:
        text = command_section(args.topic)
    else:
        try:
            text = pages.page(args.topic)
        except NoSuchTopicError as error:
            near = NoSuchTopicError(args.topic, (*pages.topics, *COMMANDS))
            raise UsageError(f"{near}.") from error
    if args.markdown:
        say(text.rstrip("\n"))
        return ExitCode.ACCEPTED
    wide = shutil.get_terminal_size().columns if sys.stdout.isatty() else WIDEST
    say(as_text(text, min(wide, WIDEST)).rstrip("\n"))
    return ExitCode.ACCEPTED


def _write_files(pages: Manual, topic: str | None, folder: Path) -> int:
    from operator_app.config.atomic import write_atomically
    from operator_app.config.resources import exists

    with_files = [t for t in pages.topics if not made_by_code(t) and files_on(pages.page(t))]
    if topic is None:
        raise UsageError(f"--files: name a page that shows files: {', '.join(with_files)}")
    try:
        shown = files_on(pages.page(topic))
    except NoSuchTopicError as error:
        raise UsageError(f"--files: {error}.") from error
    if not shown:
        raise UsageError(
            f"--files: the page {topic} shows no files; these do: {', '.join(with_files)}"
        )
    existing = [name for name in shown if exists(folder / name)]
    if existing:
        raise UsageError(f"--files: {folder / existing[0]} exists already; name another folder")
    make_folder("--files", folder)
    for name, text in shown.items():
        write_atomically(folder / name, text.encode())
        say(f"{folder / name}")
    return ExitCode.ACCEPTED


def manual() -> Manual:
    """Return the manual of this program."""
    return Manual(commands_page)


INTRODUCTION = """\
# Commands

Without a command, `sarcal` opens the terminal app. Names such as `hinge` are built-in files; a path
works wherever a name does. Results go to stdout, progress to stderr. `sarcal COMMAND --help` prints the
same as this page; what a command returns is on the page of [exit codes](exit-codes.md)."""


def commands_page() -> str:
    """Return the manual's page about `sarcal` without a command and about each command."""
    return "\n\n".join([INTRODUCTION, *map(command_section, (APP, *COMMANDS))]) + "\n"


def command_section(name: str) -> str:
    """Return summary and help of one command."""
    parser = parser_of(name)
    parser.formatter_class = partial(argparse.HelpFormatter, width=HELP_WIDTH)
    # From Python 3.14 on, the help for a terminal is coloured.
    parser.color = False  # type: ignore[attr-defined,unused-ignore]
    summary = COMMANDS.get(name, "open the terminal app")
    summary = summary[:1].upper() + summary[1:]
    return f"## {parser.prog}\n\n{summary}.\n\n```text\n{parser.format_help()}```"


def on_config(config: Any) -> Any:
    """Set the website's navigation from the table of topics (mkdocs hook)."""
    sections = [{name: [f"{topic}.md" for topic in topics]} for name, topics in SECTIONS.items()]
    config.nav = [{"Start": "index.md"}, *sections]
    return config


def on_files(files: Any, config: Any) -> Any:
    """Add the generated pages (mkdocs hook)."""
    from mkdocs.structure.files import File  # type: ignore[import-not-found,import-untyped,unused-ignore]

    pages = manual()
    for topic in pages.topics:
        if made_by_code(topic):
            files.append(File.generated(config, f"{topic}.md", content=pages.page(topic)))
    return files
