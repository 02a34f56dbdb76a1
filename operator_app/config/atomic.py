"""Writes a file whole or not at all, even in a power cut, and formats YAML that `strict_yaml` reads back exactly.

Floats have enough digits (at most 17) to give the same double again. Text that looks like another type is quoted.
"""

import math
import os
import re
import stat
import tempfile
from collections.abc import Mapping
from contextlib import suppress
from pathlib import Path
from typing import Any

import yaml

from operator_app.config.errors import WriteError
from operator_app.config.strict_yaml import resolve_plain


def write_atomically(path: Path, data: bytes, *, through_link: bool = False) -> None:
    """Write `data` to a temporary file in the same folder, fsync this file, rename it to `path`, and fsync the folder.

    A reader finds the old file or the new one, never a part, even after a power cut. The permissions of an existing
    file are kept. If `path` is a symbolic link, the file replaces only the link. This protects the link's target, which
    can be any file if the folder is from somebody else. With `through_link`, the file replaces the target instead.

    Raises WriteError if the operating system refuses to write, or if `path` is a device, a pipe or a link to one.
    Without this check, root could replace `/dev/null`. After an error, no temporary file remains.
    """
    try:
        if path.exists() and not (path.is_file() or path.is_dir()):
            raise WriteError(file=str(path), reason="this is a device or a pipe; name a file")
        _replace(Path(os.path.realpath(path)) if through_link else path, data)
    except OSError as error:
        raise WriteError(file=str(path), reason=error.strerror or str(error)) from error


def _replace(target: Path, data: bytes) -> None:
    handle, name = tempfile.mkstemp(
        prefix=f".{target.name[:100]}.", suffix=".tmp", dir=target.parent
    )
    try:
        with os.fdopen(handle, "wb") as file:
            file.write(data)
            file.flush()
            os.fchmod(file.fileno(), _mode(target))
            os.fsync(file.fileno())
        Path(name).replace(target)
    except BaseException:
        # Also on Ctrl-C: a half-written temporary file is useless.
        Path(name).unlink(missing_ok=True)
        raise
    # The rename survives a power cut only once the folder is on the disk. Syncing a folder needs read permission.
    with suppress(OSError):
        folder = os.open(target.parent, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)


def _mode(target: Path) -> int:
    if target.exists() and not target.is_symlink():
        return stat.S_IMODE(target.stat().st_mode)
    # mkstemp makes files for the owner only; a result has ordinary permissions.
    mask = os.umask(0)
    os.umask(mask)
    return 0o666 & ~mask


PLAIN = re.compile(r"[A-Za-z][A-Za-z0-9_./-]*")


def dump_strict(data: Mapping[str, Any], *, comment: str = "") -> bytes:
    """Format a mapping of plain values as YAML; the lines of `comment` come first, each after a ``#``.

    Raises `ValueError` for a value that a strict file cannot hold, such as NaN.
    """
    text = yaml.dump(
        data, Dumper=_StrictDumper, sort_keys=False, default_flow_style=None, width=100
    )
    head = "".join(f"# {line}\n" for line in comment.splitlines())
    return (head + text).encode("utf-8")


def scalar_text(value: str) -> str:
    """Format text as the value of a YAML key, on one line, quoted if it could be read as another type."""
    written: str = yaml.dump(value, Dumper=_StrictDumper, width=math.inf)
    return written.removesuffix("...\n").rstrip("\n")


class _StrictDumper(yaml.SafeDumper):
    def ignore_aliases(self, data: Any) -> bool:
        return True


def _represent_float(dumper: yaml.SafeDumper, value: float) -> yaml.Node:
    if not math.isfinite(value):
        raise ValueError(f"{value} cannot be written: only finite numbers can")
    text = repr(float(value))
    # YAML 1.1 readers read 1e-08 as text.
    text = text if "." in text else text.replace("e", ".0e")
    return dumper.represent_scalar("tag:yaml.org,2002:float", text)


def _represent_str(dumper: yaml.SafeDumper, value: str) -> yaml.Node:
    if any("\ud800" <= c <= "\udfff" for c in value):
        raise ValueError("half a character cannot be written")
    plain = PLAIN.fullmatch(value) is not None and resolve_plain(value) == value
    return dumper.represent_scalar("tag:yaml.org,2002:str", value, style=None if plain else '"')


_StrictDumper.add_representer(float, _represent_float)
_StrictDumper.add_representer(str, _represent_str)
