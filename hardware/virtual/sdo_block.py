"""Server side of SDO block transfer (CiA 301, 7.2.4.3.9 to 7.2.4.3.17)."""

from __future__ import annotations

import binascii
import struct
from enum import IntEnum
from typing import Final

from canopen.sdo.exceptions import SdoAbortedError

from hardware.canopen.objects import Abort

SEGMENTS: Final = 127
"""Largest number of segments in a block, and the number that this server uses."""

_UPLOAD, _DOWNLOAD, _TAKEN, _CRC, _SIZED, _LAST = 0xC0, 0xA0, 0xA2, 0x04, 0x02, 0x80
_END: Final = struct.Struct("<BH5x")
_BEGIN: Final = struct.Struct("<BHBI")


class _Step(IntEnum):
    """Client subcommands: the lower two bits of a frame's first byte."""

    INITIATE = 0
    END = 1
    ACKNOWLEDGE = 2
    START = 3


class BlockDownload:
    """A block download; the initiating frame has the first byte `head` and announces the size `announced`.

    `data` is what was received, in whole segments. `done`: all segments were received, so that `end` is next.
    """

    def __init__(self, head: int, announced: int) -> None:
        self.data = bytearray()
        self.done = False
        self.announced = announced if head & _SIZED else None
        self._with_crc = bool(head & _CRC)
        self._taken = 0

    @staticmethod
    def begin(index: int, subindex: int) -> bytes:
        """Return the answer to the initiating frame."""
        return _BEGIN.pack(_DOWNLOAD | _CRC, index, subindex, SEGMENTS)

    def take(self, segment: bytes) -> bytes | None:
        """Take in a segment; return the answer at the end of a block, else None. Lost segments are requested again."""
        number, last = segment[0] & ~_LAST, bool(segment[0] & _LAST)
        in_sequence = number == self._taken + 1
        if in_sequence:
            self.data += segment[1:]
            self._taken = number
        if not last and number != SEGMENTS:
            return None
        self.done = last and in_sequence
        segments, self._taken = self._taken, 0
        return bytes([_TAKEN, segments, SEGMENTS, *bytes(5)])

    def end(self, frame: bytes) -> bytes:
        """Take in the final frame, check length and checksum, and return the document."""
        head, crc = _END.unpack(frame)
        if head & 0xE3 != _UPLOAD | _Step.END:
            raise SdoAbortedError(Abort.UNKNOWN_COMMAND)
        document = bytes(self.data[: len(self.data) - (head >> 2 & 7)])
        if self.announced not in (None, len(document)):
            raise SdoAbortedError(Abort.LENGTH)
        if self._with_crc and crc != binascii.crc_hqx(document, 0):
            raise SdoAbortedError(Abort.BLOCK_CRC)
        return document

    ENDED: Final = bytes([_DOWNLOAD | _Step.END, *bytes(7)])


class BlockUpload:
    """A block upload, in blocks of as many segments as the client requests."""

    def __init__(self, data: bytes, segments: int) -> None:
        self._data, self._segments = data, _checked(segments)
        self._acknowledged = self._sent = 0
        self._started = False

    def begin(self, index: int, subindex: int) -> bytes:
        """Return the answer to the initiating frame."""
        return _BEGIN.pack(_UPLOAD | _CRC | _SIZED, index, subindex, len(self._data))

    def answer(self, frame: bytes) -> list[bytes]:
        """Return the frames that answer a client frame; none for the client's last frame."""
        step, complete = frame[0] & 3, self._acknowledged >= len(self._data)
        if step == _Step.END and complete:
            return []
        if step == _Step.START and not self._started:
            self._started = True
            return self._block()
        if step != _Step.ACKNOWLEDGE or complete or not self._started:
            raise SdoAbortedError(Abort.UNKNOWN_COMMAND)
        if frame[1] > self._sent:
            raise SdoAbortedError(Abort.BLOCK_SEQUENCE)
        self._acknowledged += 7 * frame[1]
        if self._acknowledged < len(self._data):
            self._segments = _checked(frame[2])
            return self._block()
        head = _UPLOAD | _Step.END | -len(self._data) % 7 << 2
        return [_END.pack(head, binascii.crc_hqx(self._data, 0))]

    def _block(self) -> list[bytes]:
        """Return the frames of the next block, from the first segment that is not acknowledged."""
        until = self._acknowledged + 7 * self._segments
        starts = range(self._acknowledged, min(until, len(self._data)), 7)
        self._sent = len(starts)
        return [
            bytes([number | (_LAST if start + 7 >= len(self._data) else 0)])
            + self._data[start : start + 7].ljust(7, b"\0")
            for number, start in enumerate(starts, 1)
        ]


def _checked(segments: int) -> int:
    if not 1 <= segments <= SEGMENTS:
        raise SdoAbortedError(Abort.BLOCK_SIZE)
    return segments
