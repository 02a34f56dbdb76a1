"""Bytes to text, and complaints about a file as a whole. Knows no format."""

from __future__ import annotations

from operator_app.config.errors import ConfigError, Problem


def decode_text(data: bytes, file: str) -> str:
    """Decode UTF-8, with or without a byte order mark; ConfigError for anything else."""
    if data.startswith((b"\xff\xfe", b"\xfe\xff")):
        raise only(file, None, None, "is UTF-16 text", "save it as UTF-8")
    if b"\0" in data:
        raise only(file, None, None, "is a binary file", "is this the right file?")
    try:
        return data.decode("utf-8-sig")
    except UnicodeDecodeError as error:
        line = data.count(b"\n", 0, error.start) + 1
        raise only(file, line, None, "is not UTF-8 text", "save it as UTF-8") from error


def only(file: str, line: int | None, column: int | None, text: str, remedy: str) -> ConfigError:
    """Build the error of a file with one problem."""
    return ConfigError((Problem(file=file, line=line, column=column, text=text, remedy=remedy),))
