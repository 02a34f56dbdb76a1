"""The page of all commands, from their argparse parsers."""

from __future__ import annotations

import argparse
from collections.abc import Callable, Mapping

from operator_app.manual.markup import table

OWN = ("positional arguments", "options")
"""Groups that argparse makes; the others are shared, and shown once."""

INTRODUCTION = """\
# Commands

Without a command, `sarcal` opens the terminal app. Names such as `hinge` are packaged files; a path
works wherever a name does. Results go to stdout, progress to stderr. `sarcal COMMAND --help` prints the
same as this page; what a command returns is on the page of [exit codes](exit-codes.md)."""


def commands_page(
    commands: Mapping[str, str], parser_of: Callable[[str], argparse.ArgumentParser]
) -> str:
    """Return the page: `commands` says in a line what each is for, ``app`` is `sarcal` itself."""
    shared: dict[str, list[tuple[str, str]]] = {}
    blocks = [INTRODUCTION]
    for name, summary in commands.items():
        blocks.append(command_section(parser_of(name), summary, shared))
    for title, rows in shared.items():
        blocks += [f"## {_capital(title)}", table(("option", "meaning"), rows)]
    return "\n\n".join(blocks) + "\n"


def command_section(
    parser: argparse.ArgumentParser,
    summary: str,
    shared: dict[str, list[tuple[str, str]]] | None = None,
) -> str:
    """Return what one command is for and its options; what it shares goes into `shared`, if there is one."""
    blocks = [f"## {parser.prog}", f"{_capital(summary)}."]
    also = []
    for group in parser._action_groups:  # noqa: SLF001 - it has no other list
        rows = [
            (_form(action), _meaning(action, parser.prog))
            for action in group._group_actions  # noqa: SLF001 - nor this
            if action.dest != "help" and action.help is not argparse.SUPPRESS
        ]
        title = group.title or ""
        if not rows:
            continue
        if title in OWN or shared is None:
            head = "argument" if title == OWN[0] else "option"
            blocks.append(table((head, "meaning"), rows))
        else:
            known = shared.setdefault(title, [])
            known += [row for row in rows if row not in known]
            also.append(f"[{title}](#{_anchor(title)})")
    if also:
        blocks.append(f"Further options: {', '.join(also)}.")
    return "\n\n".join(blocks)


def _form(action: argparse.Action) -> str:
    """Return how it is typed: ``-o FILE``, ``--output FILE``."""
    if action.choices is not None and action.metavar is None:
        value = f"{{{','.join(map(str, action.choices))}}}"
    else:
        metavar = action.metavar if isinstance(action.metavar, str) else ""
        value = metavar or (action.dest.upper() if action.option_strings else action.dest)
    if not action.option_strings:
        return f"`[{value}]`" if action.nargs in ("?", "*") else f"`{value}`"
    taken = "" if action.nargs == 0 else f" {value}"
    return ", ".join(f"`{name}{taken}`" for name in action.option_strings)


def _meaning(action: argparse.Action, prog: str) -> str:
    return (action.help or "") % {**vars(action), "prog": prog}


def _anchor(title: str) -> str:
    """Return the anchor of a heading, as Markdown's table of contents makes it."""
    kept = "".join(c for c in title.lower() if c.isalnum() or c in " -_")
    return "-".join(kept.split())


def _capital(text: str) -> str:
    return text[:1].upper() + text[1:]
