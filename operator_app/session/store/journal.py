"""The journal: an append-only file with a checksummed line per event; `append` returns once the line is on disk.

All other files of a session can be made again from the journal. If another program deletes, moves, replaces or changes
the journal, all events are written to a new folder beside the session folder, or else in the temporary directory.
"""

from __future__ import annotations

import errno
import fcntl
import os
import tempfile
from collections.abc import Callable, Iterator, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager, suppress
from datetime import UTC, datetime
from itertools import zip_longest
from pathlib import Path
from typing import Any

from operator_app.errors import JournalError, JournalForeignError, JournalLostError
from operator_app.session.store.journal_format import (
    JOURNAL_NAME,
    JournalContents,
    JournalEvent,
    create_file,
    format_line,
    free_path,
    fsync_folder,
    numbered_paths,
    os_errors_as_journal_errors,
    parse_journal,
    read_bytes,
    timestamped_path,
    utc_in_words,
    write_new_file,
)

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """Return the current wall-clock time in UTC."""
    return datetime.now(UTC)


class Journal:
    """An open, locked journal.

    `clock`: states the times of the events. `created_folders`: folders that were created for this journal, the
    innermost first. `loss`: error that is raised after the file was lost; None before.
    """

    def __init__(
        self,
        path: Path,
        descriptor: int,
        contents: JournalContents,
        raw: bytes,
        created_folders: tuple[Path, ...] = (),
    ) -> None:
        self.path, self.created_folders = path, created_folders
        self.contents = contents
        self.clock: Clock = utc_now
        self._descriptor = descriptor
        self._chain = contents.chain
        # All lines are kept, to write them to another folder if the file is lost.
        self._lines = raw.splitlines(keepends=True)
        self._size = len(raw)
        self._broken = ""
        self.loss: JournalLostError | None = None
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sarcal-journal")

    @classmethod
    def create(cls, beside: Path) -> Journal:
        """Create a journal in the first of the folders `beside`, `beside`-2, `beside`-3, ... that has no journal.

        Raises `JournalError` if writing fails.
        """
        remedy = "choose a folder with free space and write permission"
        for folder in numbered_paths(beside):
            path = folder / JOURNAL_NAME
            created_folders = tuple(f for f in (folder, *folder.parents) if not f.exists())
            problem = os_errors_as_journal_errors(f"cannot write {path}", remedy)
            with problem, suppress(FileExistsError):
                folder.mkdir(parents=True, exist_ok=True)
                descriptor = create_file(path)
                _lock(descriptor, path)
                fsync_folder(folder)
                contents = JournalContents(events=(), file=path)
                return cls(path, descriptor, contents, b"", created_folders)
        raise AssertionError("there is always a next name")

    @classmethod
    def resume(cls, folder: Path) -> Journal:
        """Open the journal in `folder` and move an incomplete last line to another file; raises `JournalError`."""
        path = folder / JOURNAL_NAME
        remedy = "name a session folder; `sarcal session list` shows them"
        with os_errors_as_journal_errors(f"cannot open {path}", remedy):
            try:
                descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_NONBLOCK | os.O_CLOEXEC)
            except IsADirectoryError as error:
                raise JournalForeignError(
                    f"{path} is a folder, not a file", "move it away, or name another session"
                ) from error
            except OSError as error:
                if error.errno not in (errno.EROFS, errno.EACCES, errno.EPERM):
                    raise
                raise JournalError(
                    f"cannot write to {path}: {error.strerror}",
                    "make the folder and its files writable, or resume a copy of it in a folder that is; "
                    "`sarcal report --text` reads it as it is",
                ) from error
        _lock(descriptor, path)
        try:
            with os_errors_as_journal_errors(
                f"cannot write {path}", "free space or repair the disk"
            ):
                raw = read_bytes(path)
                if path.is_symlink():
                    raise JournalForeignError(
                        f"{path} is a symbolic link to a file in another folder",
                        f"name that session, {path.resolve().parent}",
                    )
                contents, whole = parse_journal(raw, path), raw.rfind(b"\n") + 1
                if contents.torn:
                    write_new_file(timestamped_path(path, "torn"), raw[whole:])
                    os.ftruncate(descriptor, whole)
                    os.fsync(descriptor)
        except JournalError:
            os.close(descriptor)
            raise
        return cls(path, descriptor, contents, raw[:whole])

    def append(self, name: str, data: Mapping[str, Any]) -> JournalEvent:
        """Write one event and return once it is on disk. A failed write leaves the file as it was.

        A separate thread writes, so that a signal in the caller's thread cannot leave an incomplete line. Raises
        JournalLostError if another program deleted, moved, replaced or changed the file, and JournalError if the disk
        cannot be written.
        """
        return self._writer.submit(self._append, name, data).result()

    def require_intact(self, *, unchanged: bool = False) -> None:
        """Raise JournalLostError if another program deleted, moved, replaced or changed the file.

        If `unchanged`, also read the file again and compare every line with what this program read or wrote before.
        """
        if self.closed:
            return
        if self.loss is not None:
            raise self.loss
        problem = self._file_problem() or (self._changed_line() if unchanged else "")
        if problem:
            self._writer.submit(self._raise_lost, problem, b"").result()

    def _append(self, name: str, data: Mapping[str, Any]) -> JournalEvent:
        if self.loss is not None:
            raise self.loss
        if self._broken:
            raise JournalError(
                f"{self.path} can no longer be written: {self._broken}",
                "repair the disk, then resume this session and check its last entry",
            )
        event = JournalEvent(
            seq=len(self._lines) + 1, utc=utc_in_words(self.clock()), name=name, data=data
        )
        line, chain = format_line(event, self._chain)
        problem = self._file_problem()
        if problem:
            self._raise_lost(problem, line)
        with os_errors_as_journal_errors(
            f"cannot write {self.path}",
            "free space or repair the disk, then resume this session; nothing accepted so far is lost",
        ):
            self._write(line)
        self._chain = chain
        self._lines.append(line)
        self._size += len(line)
        return event

    def _write(self, line: bytes) -> None:
        """Write a line to disk; leave the file as it was if that fails."""
        try:
            if os.write(self._descriptor, line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._descriptor)
        except OSError:
            try:
                os.ftruncate(self._descriptor, self._size)
                os.fsync(self._descriptor)
            except OSError as error:
                self._broken = f"part of a failed line could not be removed ({error.strerror})"
            raise

    # -- lost ------------------------------------------------------------------------------------

    def _file_problem(self) -> str:
        try:
            on_disk, opened = self.path.stat(), os.fstat(self._descriptor)
        except (FileNotFoundError, NotADirectoryError):
            return "was deleted, moved or renamed"
        except OSError as error:
            return f"can no longer be reached ({error.strerror})"
        if (on_disk.st_dev, on_disk.st_ino) != (opened.st_dev, opened.st_ino):
            return "was replaced by another file"
        if opened.st_size < self._size:
            return f"was cut from {self._size} to {opened.st_size} bytes"
        # If `_broken`, the excess bytes are part of this program's own failed line.
        if opened.st_size > self._size and not self._broken:
            return "was written to by another program"
        return ""

    def _changed_line(self) -> str:
        try:
            stored = os.pread(self._descriptor, self._size, 0).splitlines(keepends=True)
        except OSError as error:
            return f"cannot be read back ({error.strerror})"
        pairs = enumerate(zip_longest(self._lines, stored), 1)
        return next((f"was changed in line {k}" for k, (own, read) in pairs if own != read), "")

    def _raise_lost(self, problem: str, line: bytes) -> None:
        """Write all lines, including `line`, to a new session folder, then raise JournalLostError."""
        if self.loss is not None:
            raise self.loss
        own, rescued, remedy = self.path.parent, None, ""
        for root in (own.parent, Path(tempfile.gettempdir())):
            try:
                folder = free_path(root / f"{own.name}-rescued")
                folder.mkdir(parents=True)
                write_new_file(folder / JOURNAL_NAME, b"".join((*self._lines, line)))
                fsync_folder(root)
            except OSError as error:
                reason = f"{root}: {error.strerror}"
                remedy = f"the rescue copy failed ({reason}): find out what happened to the folder"
            else:
                rescued, with_last = folder, ", with the last entry," if line else ""
                remedy = (
                    f"all entries{with_last} are in {rescued}: find out what happened to the folder, then go on "
                    f"with --resume {rescued}"
                )
                break
        self.loss = JournalLostError(
            f"{self.path} {problem} while this session was using it; nothing more is recorded",
            remedy,
            rescued=rescued,
        )
        raise self.loss

    @property
    def kept_folder(self) -> Path:
        """Folder with the complete journal: the session's folder or, if the file was lost, that of the rescue copy."""
        if self.loss is not None and self.loss.rescued is not None:
            return self.loss.rescued
        return self.path.parent

    # -- end -------------------------------------------------------------------------------------

    @property
    def closed(self) -> bool:
        """Whether `close` has been called."""
        return self._descriptor < 0

    def close(self) -> None:
        """Finish writing and unlock the journal; may be called again."""
        self._writer.shutdown()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def read_journal(folder: Path) -> JournalContents:
    """Return the contents of the journal in `folder`, without locking it; raises `JournalError`."""
    path = folder / JOURNAL_NAME
    return parse_journal(read_bytes(path), path)


def is_in_use(folder: Path) -> bool:
    """Whether a process has locked the journal in `folder`."""
    try:
        descriptor = os.open(folder / JOURNAL_NAME, os.O_RDONLY | os.O_NONBLOCK | os.O_CLOEXEC)
    except OSError:
        return False
    try:
        fcntl.flock(descriptor, fcntl.LOCK_SH | fcntl.LOCK_NB)
    except OSError:
        return True
    finally:
        os.close(descriptor)
    return False


@contextmanager
def locked(
    path: Path, access: int = os.O_RDONLY, remedy: str = "name another folder"
) -> Iterator[None]:
    """Context in which no other process uses a journal; raises `JournalError` if one does, or it cannot be opened.

    `access`: how the journal is opened; on some file systems, only a journal opened for writing can be locked.
    """
    with os_errors_as_journal_errors(f"cannot open {path}", remedy):
        descriptor = os.open(path, access | os.O_NONBLOCK | os.O_CLOEXEC)
    _lock(descriptor, path)
    try:
        yield
    finally:
        os.close(descriptor)


def _lock(descriptor: int, path: Path) -> None:
    """Lock a journal, or close it and raise `JournalError` if another process has locked it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise JournalError(
            f"{path} is in use by another sarcal process",
            "close that process first: only one at a time may use a session",
        ) from error
