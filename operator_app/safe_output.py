"""Where words leave this program: nothing that a terminal or a reader would obey goes with them.

A pose's label, a serial number, a device's name, a file name, an operator's note: somebody else wrote
them. Journals keep them as they are, a CSV so that they come back; on a screen, in a page, in a pipe
they are text. Knows no screen.
"""

from __future__ import annotations

import os
import sys
import unicodedata
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TextIO

MARK = "\ufffd"
"""Stands for a character that is not shown, one for one, so that columns stay columns."""


def harmless(text: str, *, keep: str = "") -> str:
    """Return text in which control characters, line breaks and direction overrides are marked.

    That is whatever Unicode calls other than a letter, mark, number, sign or space; `keep` lists
    characters that the place where it goes takes for what they are, such as line breaks.
    """
    if text.isprintable():
        return text
    return "".join(c if c in keep or _is_shown(c) else MARK for c in text)


def lines(found: Iterable[str]) -> str:
    """Put lines one below the other; none of them breaks."""
    return "\n".join(map(harmless, found))


def say(text: str = "", *, err: bool = False, streaming: bool = False) -> None:
    """Print lines on stdout or stderr.

    Progress that cannot be written, and a result whose reader has gone, go nowhere: what a command found is in its
    exit code and its files. Of a `streaming` one that somebody watches, the reader's going is the end.

    Raises
    ------
    BrokenPipeError
        The reader of a streaming one has gone.
    OSError
        A result cannot be written: a full disk, say.
    """
    if err:
        stderr = Stderr()
        stderr.write(_shown(text, stderr.encoding))
        stderr.flush()
        return
    try:
        sys.stdout.write(_shown(text, sys.stdout.encoding or "utf-8"))
    except BrokenPipeError:
        silence(sys.stdout)
        if streaming:
            raise


class Stderr:
    """Stderr as a file for progress: where it is full, or nobody reads it any more, that goes nowhere."""

    @property
    def _stream(self) -> TextIO:
        # Of a progress bar that has taken stderr's place: what is behind it.
        found: TextIO = getattr(sys.stderr, "rich_proxied_file", sys.stderr)
        return found

    @property
    def encoding(self) -> str:
        """Of stderr."""
        return self._stream.encoding or "utf-8"

    def isatty(self) -> bool:
        """Whether somebody looks at it."""
        return self._stream.isatty()

    def fileno(self) -> int:
        """Of stderr."""
        return self._stream.fileno()

    def write(self, text: str) -> int:
        """Write as far as that is possible."""
        try:
            return self._stream.write(text)
        except OSError:
            silence(self._stream)
            return len(text)

    def flush(self) -> None:
        """Flush as far as that is possible."""
        try:
            self._stream.flush()
        except OSError:
            silence(self._stream)


def silence(stream: TextIO) -> None:
    """Lead a stream nowhere: what is left in its buffer must not fail once more when the interpreter ends."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def stand_in_for_closed() -> None:
    """Put the null device where a standard stream was closed, before a file of ours gets its number."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115


def _shown(text: str, encoding: str) -> str:
    return harmless(f"{text}\n", keep="\n").encode(encoding, "replace").decode(encoding)


def _is_shown(c: str) -> bool:
    return c.isprintable() or unicodedata.category(c) == "Zs"
