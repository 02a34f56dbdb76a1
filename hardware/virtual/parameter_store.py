"""Two parameter slots that survive a power cut at any moment, and the check of a document against this arm.

A document is written to a temporary file, which then replaces the slot that is not active. The file that names the
active slot is replaced in the same way. Files and folder are synchronised (fsync), so that a power cut leaves the
active slot intact. A SHA-256 in each slot detects other damage. The operator program supplies the parser of documents
(`Validate`).
"""

import errno
import hashlib
import math
import os
import stat
import tempfile
from collections.abc import Callable, Sequence
from dataclasses import dataclass
from pathlib import Path
from typing import Final

from hardware.canopen.objects import Slot, SlotState
from hardware.virtual.axis import AxisSettings

_POINTER: Final = "active"
_FILE: Final = {Slot.A: "slot_a", Slot.B: "slot_b"}
_MAGIC: Final = b"sarcal slot 1 "
_TEMPORARY: Final = ".new"
_LONGEST: Final = 1 << 20
"""Largest number of bytes read from a file: four times the longest document that a supervisor accepts."""


class Disk:
    """Files in memory. The subclass `FolderDisk` is durable: once a method returns, a power cut does not undo it."""

    def __init__(self) -> None:
        self.files: dict[str, bytes] = {}

    def read(self, name: str) -> bytes | None:
        """Return the content of a file; None if the file does not exist."""
        return self.files.get(name)

    def write(self, name: str, data: bytes) -> None:
        """Write a file."""
        self.files[name] = data

    def rename(self, old: str, new: str) -> None:
        """Rename a file, replacing any file of the new name."""
        self.files[new] = self.files.pop(old)


class FolderDisk(Disk):
    """A folder on disk, created if missing. Raises `OSError` if it cannot be written."""

    def __init__(self, folder: Path) -> None:
        self._folder = folder
        folder.mkdir(parents=True, exist_ok=True)
        tempfile.TemporaryFile(dir=folder).close()

    def read(self, name: str) -> bytes | None:
        """Return the content of a file, at most 1 MiB; None if the file does not exist."""
        try:
            descriptor = self._descriptor(name, os.O_RDONLY)
        except FileNotFoundError:
            return None
        with os.fdopen(descriptor, "rb") as file:
            return file.read(_LONGEST)

    def write(self, name: str, data: bytes) -> None:
        """Write a file, and return when it is on the disk."""
        with os.fdopen(self._descriptor(name, os.O_WRONLY | os.O_CREAT | os.O_TRUNC), "wb") as file:
            file.write(data)
            file.flush()
            os.fsync(file.fileno())

    def rename(self, old: str, new: str) -> None:
        """Rename a file, replacing any file of the new name; returns once the change is on the disk."""
        (self._folder / old).replace(self._folder / new)
        folder = os.open(self._folder, os.O_RDONLY)
        try:
            os.fsync(folder)
        finally:
            os.close(folder)

    def _descriptor(self, name: str, flags: int) -> int:
        """Open a regular file; `OSError` for a pipe, which could block."""
        path = self._folder / name
        descriptor = os.open(path, flags | os.O_NONBLOCK | os.O_CLOEXEC, 0o666)
        if not stat.S_ISREG(os.fstat(descriptor).st_mode):
            os.close(descriptor)
            raise OSError(errno.EINVAL, "not a file", str(path))
        return descriptor


class ParameterStore:
    """Parameter documents in slots A and B on `disk` (default: in memory). Raises `OSError` if the disk fails."""

    def __init__(self, disk: Disk | None = None) -> None:
        self._disk = Disk() if disk is None else disk

    @property
    def active(self) -> Slot:
        """The active slot; `NONE` if no slot is active or if the active slot is damaged."""
        pointer = self._disk.read(_POINTER)
        for slot in _FILE:
            if pointer == slot.name.encode() and self.state(slot) is SlotState.WHOLE:
                return slot
        return Slot.NONE

    @property
    def spare(self) -> Slot:
        """The slot that is not active."""
        return Slot.B if self.active is Slot.A else Slot.A

    def state(self, slot: Slot) -> SlotState:
        """Return whether a slot is empty or, if it is not, whether its document is intact or damaged."""
        stored = self._disk.read(_FILE[slot])
        if stored is None:
            return SlotState.EMPTY
        return SlotState.DAMAGED if _unwrap(stored) is None else SlotState.WHOLE

    def document(self, slot: Slot) -> bytes | None:
        """Return the document in a slot; None if the slot has no document or is damaged."""
        stored = None if slot is Slot.NONE else self._disk.read(_FILE[slot])
        return None if stored is None else _unwrap(stored)

    def commit(self, document: bytes) -> Slot:
        """Write a document to the spare slot, make that slot active and return it."""
        slot = self.spare
        self._replace(_FILE[slot], _wrap(document))
        self._replace(_POINTER, slot.name.encode())
        return slot

    def roll_back(self) -> Slot:
        """Make the spare slot active and return it; the slot must have an intact document."""
        slot = self.spare
        self._replace(_POINTER, slot.name.encode())
        return slot

    def _replace(self, name: str, data: bytes) -> None:
        self._disk.write(name + _TEMPORARY, data)
        self._disk.rename(name + _TEMPORARY, name)


def _wrap(document: bytes) -> bytes:
    return _MAGIC + hashlib.sha256(document).hexdigest().encode() + b"\n" + document


def _unwrap(stored: bytes) -> bytes | None:
    _, _, document = stored.partition(b"\n")
    return document if stored == _wrap(document) else None


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidatedParameters:
    """Content of a valid document: the arm's serial number, and offsets of joints 1..n in counts (607Ch) and in rad."""

    arm_serial: str
    home_offset_counts: tuple[int, ...]
    theta_off_rad: tuple[float, ...]


Validate = Callable[[bytes], ValidatedParameters]
"""Parses a document; raises `ValueError` with the reason for the operator."""


def refusal_reason(
    parameters: ValidatedParameters, axes: Sequence[AxisSettings], serial_number: str
) -> str | None:
    """Return why this arm refuses the parameters; None if it accepts them."""
    if parameters.arm_serial != serial_number:
        return f"the document is for arm {parameters.arm_serial}, this is arm {serial_number}"
    joints = len(axes)
    counts, angles = parameters.home_offset_counts, parameters.theta_off_rad
    if len(counts) != joints or len(angles) != joints:
        return f"the document has {len(counts)} home offsets and {len(angles)} angles, but this arm has {joints} joints"
    for axis, offset, angle in zip(axes, counts, angles, strict=True):
        if not math.isfinite(angle):
            return f"theta_off of joint {axis.joint} is not a finite number"
        limit = axis.home_offset_limit_counts
        if abs(offset) > limit:
            return f"home offset of joint {axis.joint} is {offset} counts, outside {-limit} .. {limit} counts"
        if abs(angle * axis.scale.counts_per_rad - offset) > 1.0:
            return (
                f"home offset of joint {axis.joint} is {offset} counts, but its theta_off is "
                f"{angle * axis.scale.counts_per_rad:.1f} counts (they may differ by at most 1 count)"
            )
    return None
