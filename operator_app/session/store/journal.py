"""The journal: an append-only file of what happened, one fsynced and checksummed line an event.

Everything else in a session folder can be made again from it. Watched while it is written: a line that
would go into a file nobody will find goes into a new session beside it. Knows no event's meaning.
"""

from __future__ import annotations

import errno
import fcntl
import os
import tempfile
from collections.abc import Callable, Mapping
from concurrent.futures import ThreadPoolExecutor
from contextlib import suppress
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

from operator_app.errors import (
    JournalError,
    JournalExistsError,
    JournalForeignError,
    JournalLostError,
)
from operator_app.session.store.journal_files import (
    names_from,
    new_file,
    new_session,
    stamped,
    sync_folder,
    write_new,
)
from operator_app.session.store.journal_format import (
    JOURNAL_NAME,
    JournalContents,
    JournalEvent,
    Parsed,
    line_of,
    parse,
    read_regular,
    require_regular,
)

Clock = Callable[[], datetime]


def utc_now() -> datetime:
    """Return the wall clock in UTC."""
    return datetime.now(UTC)


class Journal:
    """An open, locked journal. Lines are on disk when `append` returns.

    `made` are the folders that were made for it, the innermost first.
    """

    def __init__(
        self,
        path: Path,
        descriptor: int,
        parsed: Parsed,
        raw: bytes,
        made: tuple[Path, ...] = (),
    ) -> None:
        self.path, self.made = path, made
        self.contents = parsed.contents
        self._descriptor = descriptor
        self._seq = len(parsed.contents.events)
        self._chain = parsed.chain
        # All of it: what is kept elsewhere when the file is taken away.
        self._lines = raw.splitlines(keepends=True)
        self._size = len(raw)
        self._broken = ""
        self._loss: JournalLostError | None = None
        self._writer = ThreadPoolExecutor(max_workers=1, thread_name_prefix="sarcal-journal")

    @classmethod
    def create_beside(cls, folder: Path) -> Journal:
        """Start a journal in a new `folder`; where another program was faster, in the next of its name that is free."""
        for candidate in names_from(folder):
            with suppress(JournalExistsError):
                return cls.create(candidate)
        raise AssertionError("names do not end")

    @classmethod
    def create(cls, folder: Path) -> Journal:
        """Start a journal in a new or empty `folder`; JournalExistsError if there is one already."""
        path = folder / JOURNAL_NAME
        made = tuple(f for f in (folder, *folder.parents) if not f.exists())
        try:
            folder.mkdir(parents=True, exist_ok=True)
            descriptor = new_file(path)
        except FileExistsError as error:
            raise JournalExistsError(
                f"{path} exists already",
                f"resume it with --resume {folder}, or name another folder",
            ) from error
        except OSError as error:
            raise JournalError(
                f"cannot write {path}: {error.strerror}",
                "choose a folder you may write to",
            ) from error
        lock(descriptor, path)
        sync_folder(folder)
        contents = JournalContents(events=(), torn="", file=str(path))
        return cls(path, descriptor, Parsed(contents=contents, chain="", whole_bytes=0), b"", made)

    @classmethod
    def resume(cls, folder: Path) -> Journal:
        """Open the journal of `folder` to go on; a torn last line is cut off, kept beside it, and said."""
        path = folder / JOURNAL_NAME
        try:
            descriptor = os.open(path, os.O_RDWR | os.O_APPEND | os.O_NONBLOCK | os.O_CLOEXEC)
        except IsADirectoryError as error:
            raise JournalForeignError(
                f"{path} is a folder, not a file", "move it away, or name another session"
            ) from error
        except OSError as error:
            raise JournalError(
                f"cannot open {path}: {error.strerror}",
                "name a session folder; `sarcal session list` shows them",
            ) from error
        lock(descriptor, path)
        try:
            require_regular(descriptor, path)
            if path.is_symlink():
                raise JournalForeignError(
                    f"{path} is a symbolic link: its lines would go into the file of another folder",
                    f"name the session it leads to, {path.resolve().parent}",
                )
            raw = read_regular(path)
            parsed = parse(raw, path)
            if parsed.contents.torn:
                write_new(stamped(path, "torn"), raw[parsed.whole_bytes :])
                os.ftruncate(descriptor, parsed.whole_bytes)
                os.fsync(descriptor)
        except OSError as error:
            os.close(descriptor)
            raise JournalError(
                f"cannot write {path}: {error.strerror}", "free space or repair the disk"
            ) from error
        except JournalError:
            os.close(descriptor)
            raise
        return cls(path, descriptor, parsed, raw[: parsed.whole_bytes])

    def append(self, name: str, data: Mapping[str, Any], *, clock: Clock = utc_now) -> JournalEvent:
        """Write one event; returns when it is on disk. A line that cannot be is taken back.

        The writing is done by a thread of its own: a signal that interrupts the caller at any
        moment leaves the line whole and the next one numbered right.

        Raises
        ------
        JournalLostError
            The file is not where it was, or not as it was left.
        JournalError
            The disk refuses.
        """
        return self._writer.submit(self._append, name, data, clock).result()

    def require_there(self, *, unchanged: bool = False) -> None:
        """Raise JournalLostError if a line written now would be found by nobody; writes nothing then.

        With `unchanged` the file is read back as well, and every line must be what was written.
        """
        if self.closed:
            return
        if self._loss is not None:
            raise self._loss
        problem = self._what_happened_to_it() or (self._change() if unchanged else "")
        if problem:
            self._writer.submit(self._lose, problem, b"").result()

    def _append(self, name: str, data: Mapping[str, Any], clock: Clock) -> JournalEvent:
        if self._loss is not None:
            raise self._loss
        if self._broken:
            raise JournalError(
                f"{self.path} takes no more lines: {self._broken}",
                "repair the disk, then resume this session and look at its last entry",
            )
        event = JournalEvent(
            seq=self._seq + 1,
            utc=clock().isoformat(timespec="milliseconds").replace("+00:00", "Z"),
            name=name,
            data=data,
        )
        line, chain = line_of(event, self._chain)
        problem = self._what_happened_to_it()
        if problem:
            self._lose(problem, line)
        try:
            self._write(line)
        except OSError as error:
            raise JournalError(
                f"cannot write {self.path}: {error.strerror}",
                "free space or repair the disk, then resume this session; "
                "nothing accepted so far is lost",
            ) from error
        self._seq, self._chain = event.seq, chain
        self._lines.append(line)
        self._size += len(line)
        return event

    def _write(self, line: bytes) -> None:
        """Put a line on disk, or leave the file as it was."""
        try:
            if os.write(self._descriptor, line) != len(line):
                raise OSError(errno.ENOSPC, os.strerror(errno.ENOSPC))
            os.fsync(self._descriptor)
        except OSError:
            # Any part of it, even a whole line, would make the next one look damaged.
            self._take_back(self._size)
            raise

    def _take_back(self, size: int) -> None:
        try:
            os.ftruncate(self._descriptor, size)
            os.fsync(self._descriptor)
        except OSError as error:
            self._broken = f"one that was refused could not be taken back ({error.strerror})"

    # -- taken away ------------------------------------------------------------------------------

    def _what_happened_to_it(self) -> str:
        """Say why nobody would find a line that is written now; empty when all is well."""
        try:
            there, here = self.path.stat(), os.fstat(self._descriptor)
        except (FileNotFoundError, NotADirectoryError):
            return "was deleted, moved or renamed"
        except OSError as error:
            return f"cannot be reached any more ({error.strerror})"
        if (there.st_dev, there.st_ino) != (here.st_dev, here.st_ino):
            return "was replaced by another file"
        if here.st_size < self._size:
            return f"was cut from {self._size} to {here.st_size} bytes"
        # A line that could not be taken back is our own, and said elsewhere.
        if here.st_size > self._size and not self._broken:
            return "was written to by another program"
        return ""

    def _change(self) -> str:
        """Say which line is not what was written, or proved itself when it was read; empty when all are."""
        position = 0
        for number, line in enumerate(self._lines, 1):
            try:
                found = os.pread(self._descriptor, len(line), position)
            except OSError as error:
                return f"cannot be read back ({error.strerror})"
            if found != line:
                return f"was changed in line {number}"
            position += len(line)
        return ""

    def _lose(self, problem: str, line: bytes) -> None:
        """Keep everything, and the line in hand, as a new session beside this one; raise."""
        if self._loss is not None:
            raise self._loss
        rescued, reason = self._rescued(line)
        if rescued is None:
            remedy = f"nothing could be rescued ({reason}): find out what happened to the folder"
        else:
            own = ", the entry in hand included," if line else ""
            remedy = (
                f"everything{own} is in {rescued}: find out what happened to the folder, then go on "
                f"with --resume {rescued}"
            )
        self._loss = JournalLostError(
            f"{self.path} {problem} while this session was writing it; nothing more is accepted",
            remedy,
            rescued=rescued,
        )
        raise self._loss

    def _rescued(self, line: bytes) -> tuple[Path | None, str]:
        """Write a session that holds all lines, where that is possible; and why it was not."""
        own, reason = self.path.parent, ""
        for root in (own.parent, Path(tempfile.gettempdir())):
            try:
                return new_session(root, f"{own.name}-rescued", [*self._lines, line]), ""
            except OSError as error:
                reason = f"{root}: {error.strerror}"
        return None, reason

    @property
    def loss(self) -> JournalLostError | None:
        """How the file was taken away from under the session, if it was."""
        return self._loss

    @property
    def kept_in(self) -> Path:
        """Folder that holds everything that was accepted."""
        if self._loss is not None and self._loss.rescued is not None:
            return self._loss.rescued
        return self.path.parent

    # -- end -------------------------------------------------------------------------------------

    @property
    def closed(self) -> bool:
        """Whether `close` has been called."""
        return self._descriptor < 0

    def close(self) -> None:
        """Finish what is being written and release the journal. Safe to call twice."""
        self._writer.shutdown()
        if self._descriptor >= 0:
            os.close(self._descriptor)
            self._descriptor = -1


def read_journal(folder: Path) -> JournalContents:
    """Read a journal without locking or changing it."""
    path = folder / JOURNAL_NAME
    return parse(read_regular(path), path).contents


def lock(descriptor: int, path: Path) -> None:
    """Take a journal for this process alone; JournalError, and it is closed, where another has it."""
    try:
        fcntl.flock(descriptor, fcntl.LOCK_EX | fcntl.LOCK_NB)
    except OSError as error:
        os.close(descriptor)
        raise JournalError(
            f"{path} is in use by another sarcal",
            "close that one first; one session has one operator",
        ) from error
