"""Finds files by built-in name or path, and reads them up to a size limit.

A built-in name (``hinge``) always means the built-in file; ``./hinge`` means a file with that name.
"""

import difflib
import errno
import os
import stat
from dataclasses import dataclass
from importlib.resources import files
from importlib.resources.abc import Traversable
from pathlib import Path
from typing import Literal

from operator_app.config.errors import only

Kind = Literal["arm", "fixture", "procedure", "profile"]

DESCRIPTION_LIMIT_BYTES = 16 * 1024 * 1024
"""Largest size of a URDF file."""
YAML_LIMIT_BYTES = 256 * 1024
"""Largest size of a YAML file, far above that of any valid file (about 10 kB): a larger file is the wrong file."""

OPEN_ALREADY = ("/dev/stdin", "/dev/fd/", "/proc/self/fd/")
"""Beginnings of paths of pipes that already have a writer, such as the shell's ``<(command)``."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Resource:
    """Content of a file, and its name for messages: the path as typed, or ``packaged:<name>.yaml``.

    `folder`: folder to which relative paths in the file refer; None for a built-in file.
    """

    file: str
    folder: Path | None
    data: bytes


def builtin_names(kind: Kind) -> tuple[str, ...]:
    """Return the names of the built-in files of a kind."""
    return tuple(sorted(e.name[:-5] for e in _folder(kind).iterdir() if e.name.endswith(".yaml")))


def resolve(kind: Kind, reference: str | Path, *, folder: Path | None = None) -> Resource:
    """Find and read a file by built-in name or path, relative to `folder` (default: working directory).

    Raises ConfigError if `reference` is neither a built-in name nor a file, or if the file cannot be read.
    """
    text = str(reference)
    names = builtin_names(kind)
    if isinstance(reference, str) and text in names:
        packaged = _folder(kind) / f"{text}.yaml"
        return Resource(file=f"packaged:{text}.yaml", folder=None, data=packaged.read_bytes())
    path = expanded(text) if folder is None else folder / expanded(text)
    is_path = os.sep in text or "." in text or text.startswith("~")
    if not text or not (is_path or exists(path)):
        near = [name for name in names if text and name.startswith(text.lower())]
        near = near or difflib.get_close_matches(text.lower(), names, n=1)
        hint = f"did you mean {near[0]}? " if near else ""
        remedy = f"{hint}built-in: {', '.join(names)}; or give a path"
        what = "bus profile" if kind == "profile" else kind
        raise only(text or "''", f"is neither a built-in {what} nor a file", remedy)
    shown = text if folder is None else str(path)
    data = read_limited(path, shown, limit=YAML_LIMIT_BYTES)
    return Resource(file=shown, folder=path.parent, data=data)


def expanded(reference: str | Path) -> Path:
    """Return a path with ``~`` replaced by the home folder; unchanged for an unknown user."""
    # `Path.expanduser` raises for an unknown user, and also expands ./~name.
    return Path(os.path.expanduser(reference))  # noqa: PTH111


def exists(path: Path) -> bool:
    """Whether a file or folder exists; false, instead of an error, if the system denies access."""
    return os.path.exists(path)  # noqa: PTH110


def read_limited(path: Path, shown: str, *, limit: int) -> bytes:
    """Read a file (`shown` in messages); raises ConfigError if it is unreadable or over `limit` bytes."""
    try:
        if stat.S_ISFIFO(path.stat().st_mode) and not str(path).startswith(OPEN_ALREADY):
            # Opening it would wait for its writer, perhaps forever.
            raise OSError(errno.EINVAL, "it is a pipe, not a file")
        with path.open("rb") as file:
            data = file.read(limit + 1)
    except FileNotFoundError as error:
        near = difflib.get_close_matches(path.name, _siblings(path), n=1)
        remedy = f"did you mean {path.with_name(near[0])}?" if near else "check the path"
        raise only(shown, "there is no such file", remedy) from error
    except IsADirectoryError as error:
        raise only(shown, "is a folder, not a file", "name the file in it") from error
    except (OSError, ValueError) as error:
        reason = error.strerror if isinstance(error, OSError) and error.strerror else str(error)
        raise only(shown, f"cannot be read: {reason}", "check the path") from error
    if len(data) > limit:
        text = f"is larger than {limit // 1024} KiB"
        raise only(shown, text, "this is probably the wrong file")
    return data


def _folder(kind: Kind) -> Traversable:
    if kind == "fixture":
        return files("fixtures") / "data"
    return files("operator_app") / "data" / f"{kind}s"


def _siblings(path: Path) -> list[str]:
    try:
        return sorted(entry.name for entry in path.parent.iterdir())
    except (OSError, ValueError):
        return []
