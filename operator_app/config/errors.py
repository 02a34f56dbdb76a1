"""What is wrong with a file, in one complaint that lists everything; bytes to text."""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass


@dataclass(frozen=True, slots=True, kw_only=True)
class Problem:
    """One thing that is wrong with a file.

    Attributes
    ----------
    file
        Name of the file as the user gave it, or ``packaged:<name>``.
    line
        Line, from 1; None when the problem is the file as a whole (it is missing, it is empty).
    column
        YAML: character in the line, from 1. CSV: number of the field, from 1.
    key
        Where in the document, e.g. ``joints[joint 6].sensor.bits``, or the CSV column; "" for the file.
        Items of a list are named by their own number where they have one, else counted from 1.
    text
        What is wrong.
    remedy
        What to do about it.
    """

    file: str
    line: int | None = None
    column: int | None = None
    key: str = ""
    text: str
    remedy: str = ""

    def __str__(self) -> str:
        place = self.file if self.line is None else f"{self.file}:{self.line}"
        head = f"{place}: {self.key}: " if self.key else f"{place}: "
        text = self.text
        if self.remedy:
            # What asks something has its own stop.
            text += f"{'' if text.endswith('?') else ';'} {self.remedy}"
        line = f"{head}{text}"
        # One line whatever the file holds, and nothing in it that a terminal would obey.
        return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in line)


class ConfigError(Exception):
    """A file cannot be used. `problems` holds all that is wrong, in the order of the file."""

    def __init__(self, problems: Iterable[Problem]) -> None:
        listed = tuple(problems)
        if not listed:
            raise ValueError("a ConfigError needs at least one problem")
        self.problems: tuple[Problem, ...] = tuple(
            sorted(listed, key=lambda p: (p.line or 0, p.column or 0))
        )
        super().__init__("\n".join(str(problem) for problem in self.problems))

    def __reduce__(self) -> tuple[type[ConfigError], tuple[tuple[Problem, ...]]]:
        """Made again from its problems: it may come out of another process."""
        return type(self), (self.problems,)


class WriteError(Exception):
    """A file could not be written; whatever was there before is still there, whole."""

    def __init__(self, *, file: str, reason: str) -> None:
        self.file = file
        self.reason = reason
        super().__init__(f"{file}: cannot be written: {reason}")


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
