"""Writing a file whole or not at all, also through a power cut."""

from __future__ import annotations

import os
import stat
import tempfile
from pathlib import Path

from operator_app.config.errors import WriteError


def write_atomically(path: Path, data: bytes, *, through_link: bool = False) -> None:
    """Put `data` into `path`: temporary file in the same folder, fsync, rename, fsync of the folder.

    A reader sees the old file or the new one, never a part. The permissions of an existing file are kept.
    A symbolic link is replaced by a file, and what it points to is left alone: a folder may come from
    somebody else. With `through_link` it stays a link, and the file it points to is replaced.

    Raises
    ------
    WriteError
        The system refused; nothing was changed and no temporary file is left.
    """
    try:
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
        # Also on Ctrl-C: a half-written temporary file is of no use to anybody.
        Path(name).unlink(missing_ok=True)
        raise
    # The rename itself is only safe from a power cut once the folder is on the disk.
    folder = os.open(target.parent, os.O_RDONLY)
    try:
        os.fsync(folder)
    finally:
        os.close(folder)


def _mode(target: Path) -> int:
    try:
        found = target.lstat().st_mode
    except FileNotFoundError:
        found = stat.S_IFLNK
    if stat.S_ISLNK(found):
        # mkstemp makes files for the owner only; a result is an ordinary file.
        mask = os.umask(0)
        os.umask(mask)
        return 0o666 & ~mask
    return stat.S_IMODE(found)
