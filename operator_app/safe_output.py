"""Output of text from outside (notes, serial numbers, device and file names) without control characters.

Journals and CSV files keep such text unchanged. Elsewhere, characters that a terminal interprets are replaced.
"""

import json
import os
import sys
import unicodedata
from collections.abc import Iterable
from contextlib import suppress
from pathlib import Path
from typing import TextIO

MARK = "\ufffd"
"""Character shown instead of each character that is not allowed, so that columns keep their width."""


def sanitized(text: str, *, keep: str = "") -> str:
    """Return text in which `MARK` replaces control characters, line breaks and direction overrides, except `keep`."""
    if text.isprintable():
        return text
    kept = {c for c in text if c in keep or c.isprintable() or unicodedata.category(c) == "Zs"}
    return "".join(c if c in kept else MARK for c in text)


def lines(texts: Iterable[str]) -> str:
    """Join texts with line breaks; characters that are not printable are replaced by `MARK`."""
    return "\n".join(map(sanitized, texts))


def as_json(value: object) -> str:
    """Return a result as indented JSON; raises ValueError for NaN and infinity."""
    return json.dumps(value, indent=2, allow_nan=False)


def say(text: str = "", *, err: bool = False, streaming: bool = False) -> None:
    """Print text and a line break on stdout or, if `err`, on stderr.

    A failed write to stderr is ignored, and so is a closed pipe: exit code and files also hold the result. But if
    `streaming`, a closed pipe raises `BrokenPipeError`. Other failures on stdout, e.g. a full disk, raise `OSError`.
    """
    stream = sys.stderr if err else sys.stdout
    encoding = stream.encoding or "utf-8"
    shown = sanitized(f"{text}\n", keep="\n").encode(encoding, "replace").decode(encoding)
    if err:
        try:
            sys.stderr.write(shown)
            sys.stderr.flush()
        except OSError:
            silence(sys.stderr)
        return
    try:
        sys.stdout.write(shown)
    except BrokenPipeError:
        silence(sys.stdout)
        if streaming:
            raise


def silence(stream: TextIO) -> None:
    """Redirect a stream to the null device, so that writing its buffer does not fail again at exit."""
    with suppress(OSError, ValueError):
        nowhere = os.open(os.devnull, os.O_WRONLY)
        os.dup2(nowhere, stream.fileno())
        os.close(nowhere)


def open_closed_streams() -> None:
    """Open the null device in place of closed standard streams, before another file gets their descriptors."""
    for name, mode in (("stdin", "r"), ("stdout", "w"), ("stderr", "w")):
        if getattr(sys, name) is None:
            setattr(sys, name, Path(os.devnull).open(mode, encoding="utf-8"))  # noqa: SIM115
