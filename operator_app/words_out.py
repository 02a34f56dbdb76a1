"""Where words leave this program: nothing that a terminal or a reader would obey goes with them.

A pose's label, a serial number, a device's name, a file name, an operator's note: somebody else wrote
them. Files keep them as they are; on a screen, in a page, in a pipe they are text. Knows no screen.
"""

from __future__ import annotations

import sys
import unicodedata
from collections.abc import Iterable

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


def say(text: str = "", *, err: bool = False) -> None:
    """Print lines on stdout or stderr."""
    stream = sys.stderr if err else sys.stdout
    encoding = stream.encoding or "utf-8"
    print(harmless(text, keep="\n").encode(encoding, "replace").decode(encoding), file=stream)


def _is_shown(c: str) -> bool:
    return c.isprintable() or unicodedata.category(c) == "Zs"
