"""Shell completion of commands, options, packaged names, sessions and topics. Needs the extra ``[completion]``.

With argcomplete installed, once in the shell: ``eval "$(register-python-argcomplete sarcal)"``.
"""

from __future__ import annotations

import argparse
import os
import shlex
from collections.abc import Iterable, Mapping
from pathlib import Path
from typing import Any

BY_DEST: dict[str, Any] = {"arm": "arm", "fixture": "fixture", "procedure": "procedure"}
COPIED = "packaged"
SESSIONS = ("session", "name", "a", "b", "resume")


def words_to_complete(environ: Mapping[str, str] = os.environ) -> list[str] | None:
    """Return the words of the command line to be completed; None outside of completion."""
    if "_ARGCOMPLETE" not in environ:
        return None
    line = environ.get("COMP_LINE", "")
    try:
        return shlex.split(line)[1:]
    except ValueError:
        # An open quote.
        return line.split()[1:]


def complete(parser: argparse.ArgumentParser, command: argparse.ArgumentParser | None) -> None:
    """Complete and exit; return if argcomplete is not installed."""
    try:
        import argcomplete  # type: ignore[import-not-found,import-untyped,unused-ignore]
    except ImportError:
        return
    for action in () if command is None else command._actions:  # noqa: SLF001 - it has no other list
        if action.dest == "topic":
            action.completer = _topics  # type: ignore[attr-defined]
        elif action.dest in (*BY_DEST, *SESSIONS, COPIED):
            action.completer = _names(action.dest)  # type: ignore[attr-defined]
    argcomplete.autocomplete(parser)


def _topics(**_: object) -> Iterable[str]:
    from operator_app.manual.pages import SECTIONS

    return [topic for topics in SECTIONS.values() for topic in topics]


def _names(dest: str) -> Any:
    def completer(prefix: str, parsed_args: argparse.Namespace, **_: object) -> Iterable[str]:
        from operator_app.config.resources import builtin_names

        kind: Any
        if dest == COPIED:
            # Of the kind that is to be made, `new arm --from`, which is not parsed yet.
            typed = words_to_complete() or []
            return [
                name for kind in BY_DEST.values() if kind in typed for name in builtin_names(kind)
            ]
        if dest in BY_DEST:
            # A path will do as well, and only a path begins like one.
            kind = BY_DEST[dest]
            return [*builtin_names(kind), *_paths(prefix)]
        root = getattr(parsed_args, "sessions", None) or Path("sessions")
        folders = sorted(p.name for p in root.iterdir() if p.is_dir()) if root.is_dir() else []
        return ["latest", *folders, *_paths(prefix)]

    return completer


def _paths(prefix: str) -> Iterable[str]:
    if "/" not in prefix and not prefix.startswith("."):
        return []
    where = Path(prefix).expanduser()
    folder = where if prefix.endswith("/") else where.parent
    return [f"{p}/" if p.is_dir() else str(p) for p in folder.glob("*")] if folder.is_dir() else []
