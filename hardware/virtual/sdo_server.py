"""A node's SDO server: expedited, segmented and block transfers (CiA 301, 7.2.4.3), one at a time.

It replaces the server of the `canopen` package, which answers in every NMT state, accepts any amount of data, fails
on an unexpected frame and only logs errors.
"""

from __future__ import annotations

import binascii
import struct
from collections.abc import Generator
from dataclasses import dataclass
from typing import TYPE_CHECKING, Final

from canopen.sdo import constants as sdo
from canopen.sdo.exceptions import SdoAbortedError

from hardware.canopen.objects import COB_SDO_FROM_SERVER

if TYPE_CHECKING:
    from hardware.virtual.node import VirtualNode

_FRAME: Final = struct.Struct("<BHBI")
"""First byte, index, sub-index, and a size or an abort code."""
_BLOCK_END: Final = struct.Struct("<BH5x")
_BLOCK_TAKEN: Final = sdo.RESPONSE_BLOCK_DOWNLOAD | sdo.BLOCK_TRANSFER_RESPONSE
_END_OF_BLOCKS: Final = sdo.REQUEST_BLOCK_DOWNLOAD | sdo.END_BLOCK_TRANSFER
_SPECIFIER, _SUBCOMMAND = 0xE0, 0x03
"""Masks of a frame's first byte: the command specifier, and the subcommand of a block transfer."""
LONGEST_DOCUMENT: Final = 256 * 1024
"""Largest number of bytes that a client may send in one transfer."""
_BLOCK_SEGMENTS: Final = 127
"""Largest number of segments in a block, and the number that this server uses."""

_SEGMENT_HEADS: Final = frozenset({*range(0x20), *range(0x60, 0x80)})
_BLOCK_UPLOAD_HEADS: Final = frozenset(head for head in range(0xA0, 0xC0) if head & 3)
_BLOCK_DOWNLOAD_HEADS: Final = frozenset(range(0x100)) - {sdo.RESPONSE_ABORTED}
"""First bytes of the frames that continue a transfer of each kind; any other first byte begins a new transfer."""

Steps = Generator[list[bytes], bytes, tuple[list[bytes], bytes | None]]
"""Steps of a transfer: the generator yields the answers to a frame and receives the client's next frame.

It returns the last answers and the data received (None for an upload); it may raise `SdoAbortedError`."""


class Deferred(Exception):
    """Raised by a node during a write that it will answer with `NodeSdoServer.answer_later`."""


@dataclass(slots=True)
class _Transfer:
    index: int
    subindex: int
    steps: Steps
    heads: frozenset[int]


class NodeSdoServer:
    """Server of one node; requests are ignored while the node's NMT state allows no object access."""

    def __init__(self, node: VirtualNode) -> None:
        self._node = node
        self._transfer: _Transfer | None = None
        self._waiting: tuple[int, int, list[bytes]] | None = None

    def on_request(self, data: bytes | bytearray) -> None:
        """Answer a request frame of 8 bytes."""
        if not self._node.has_sdo_and_emcy:
            return
        with self._node.lock:
            request, transfer = bytes(data), self._transfer
            self.reset()
            _, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
            try:
                if transfer is not None and request[0] in transfer.heads:
                    index, subindex = transfer.index, transfer.subindex
                    answers = transfer.steps.send(request)
                elif request[0] & _SPECIFIER == sdo.REQUEST_ABORTED:  # has no answer
                    return
                else:
                    transfer = _Transfer(index, subindex, *self._initiate(request, index, subindex))
                    answers = next(transfer.steps)
                self._transfer = transfer
            except StopIteration as end:
                answers, document = end.value
                if document is not None:
                    answers = self._write(index, subindex, document, answers)
            except SdoAbortedError as error:
                answers = [_FRAME.pack(sdo.RESPONSE_ABORTED, index, subindex, error.code)]
            self._send(answers)

    def answer_later(self, abort: int | None) -> None:
        """Answer the deferred request (with `abort` if given), unless the client has abandoned the request."""
        with self._node.lock:
            if self._waiting is None:
                return
            (index, subindex, answers), self._waiting = self._waiting, None
            if abort is not None:
                answers = [_FRAME.pack(sdo.RESPONSE_ABORTED, index, subindex, abort)]
            if self._node.has_sdo_and_emcy:
                self._send(answers)

    def reset(self) -> None:
        """Drop the current transfer."""
        self._transfer = self._waiting = None

    def _initiate(self, request: bytes, index: int, subindex: int) -> tuple[Steps, frozenset[int]]:
        """Return the transfer that a request initiates, and the first bytes of the frames that continue it."""
        ask, step = request[0] & _SPECIFIER, request[0] & _SUBCOMMAND
        if ask == sdo.REQUEST_DOWNLOAD:
            self._node.check_writable(index, subindex)
            return _download(request), _SEGMENT_HEADS
        if ask == sdo.REQUEST_BLOCK_DOWNLOAD and not step & sdo.END_BLOCK_TRANSFER:
            self._node.check_writable(index, subindex)
            return _block_download(request), _BLOCK_DOWNLOAD_HEADS
        if ask != sdo.REQUEST_UPLOAD and not (
            ask == sdo.REQUEST_BLOCK_UPLOAD and step == sdo.INITIATE_BLOCK_TRANSFER
        ):
            raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)
        document = self._node.read_object(index, subindex)
        if not document:
            raise SdoAbortedError(sdo.ABORT_NO_DATA_AVAILABLE)
        # Up to the protocol switch threshold, a block upload is answered as a normal upload.
        if ask == sdo.REQUEST_UPLOAD or len(document) <= request[5]:
            return _upload(request, document), _SEGMENT_HEADS
        return _block_upload(request, document), _BLOCK_UPLOAD_HEADS

    def _write(self, index: int, subindex: int, data: bytes, answers: list[bytes]) -> list[bytes]:
        """Write received data to the node; return the answers, or an empty list if the node defers them."""
        try:
            self._node.write_object(index, subindex, data)
        except Deferred:
            self._waiting = index, subindex, answers
            return []
        except SdoAbortedError as error:
            return [_FRAME.pack(sdo.RESPONSE_ABORTED, index, subindex, error.code)]
        return answers

    def _send(self, frames: list[bytes]) -> None:
        for frame in frames:
            self._node.send(COB_SDO_FROM_SERVER, frame)


def _download(request: bytes) -> Steps:
    """Receive data in the request or in segments."""
    head, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
    answer = _FRAME.pack(sdo.RESPONSE_DOWNLOAD, index, subindex, 0)
    if head & sdo.EXPEDITED:
        size = 4 - (head >> 2 & 3) if head & sdo.SIZE_SPECIFIED else 4
        return [answer], request[4 : 4 + size]
    announced = _announced(request, is_stated=head & sdo.SIZE_SPECIFIED)
    data, toggle, last = bytearray(), 0, 0
    while not last:
        segment = yield [answer]
        _require_segment(segment, sdo.REQUEST_SEGMENT_DOWNLOAD, toggle)
        data += segment[1 : 8 - (segment[0] >> 1 & 7)]
        _require_length(len(data))
        last = segment[0] & sdo.NO_MORE_DATA
        answer = bytes([sdo.RESPONSE_SEGMENT_DOWNLOAD | toggle, *bytes(7)])
        toggle ^= sdo.TOGGLE_BIT
    if announced not in (None, len(data)):
        raise SdoAbortedError(sdo.ABORT_LENGTH_NOT_MATCHED)
    return [answer], bytes(data)


def _upload(request: bytes, document: bytes) -> Steps:
    """Send a document in the answer or in segments."""
    _, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
    size = len(document)
    if size <= 4:
        head = sdo.RESPONSE_UPLOAD | sdo.EXPEDITED | sdo.SIZE_SPECIFIED | (4 - size) << 2
        return [sdo.SDO_STRUCT.pack(head, index, subindex) + document.ljust(4, b"\0")], None
    head, toggle = sdo.RESPONSE_UPLOAD | sdo.SIZE_SPECIFIED, 0
    answer = _FRAME.pack(head, index, subindex, size)
    for start in range(0, size, 7):
        segment = yield [answer]
        _require_segment(segment, sdo.REQUEST_SEGMENT_UPLOAD, toggle)
        part = document[start : start + 7]
        last = sdo.NO_MORE_DATA if start + 7 >= size else 0
        answer = bytes([toggle | (7 - len(part)) << 1 | last]) + part.ljust(7, b"\0")
        toggle ^= sdo.TOGGLE_BIT
    return [answer], None


def _block_download(request: bytes) -> Steps:
    """Receive data in blocks; segments that were lost are requested again."""
    head, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
    announced = _announced(request, is_stated=head & sdo.BLOCK_SIZE_SPECIFIED)
    first = sdo.RESPONSE_BLOCK_DOWNLOAD | sdo.CRC_SUPPORTED
    answers = [_FRAME.pack(first, index, subindex, _BLOCK_SEGMENTS)]
    data, taken, complete = bytearray(), 0, False
    while not complete:
        segment = yield answers
        answers = []
        number, last = segment[0] & ~sdo.NO_MORE_BLOCKS, segment[0] & sdo.NO_MORE_BLOCKS
        in_sequence = number == taken + 1
        if in_sequence:
            data += segment[1:]
            taken = number
            _require_length(len(data))
        if last or number == _BLOCK_SEGMENTS:
            complete = bool(last) and in_sequence
            answers = [bytes([_BLOCK_TAKEN, taken, _BLOCK_SEGMENTS, *bytes(5)])]
            taken = 0
    end, crc = _BLOCK_END.unpack((yield answers))
    if end & (_SPECIFIER | _SUBCOMMAND) != _END_OF_BLOCKS:
        raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)
    document = bytes(data[: len(data) - (end >> 2 & 7)])
    if announced not in (None, len(document)):
        raise SdoAbortedError(sdo.ABORT_LENGTH_NOT_MATCHED)
    if head & sdo.CRC_SUPPORTED and crc != binascii.crc_hqx(document, 0):
        raise SdoAbortedError(sdo.ABORT_CRC_ERROR)
    return [bytes([sdo.RESPONSE_BLOCK_DOWNLOAD | sdo.END_BLOCK_TRANSFER, *bytes(7)])], document


def _block_upload(request: bytes, document: bytes) -> Steps:
    """Send a document in blocks of as many segments as the client requests."""
    _, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
    segments, size, acknowledged = _checked(request[4]), len(document), 0
    head = sdo.RESPONSE_BLOCK_UPLOAD | sdo.CRC_SUPPORTED | sdo.BLOCK_SIZE_SPECIFIED
    frame = yield [_FRAME.pack(head, index, subindex, size)]
    _require_step(frame, sdo.START_BLOCK_UPLOAD)
    while acknowledged < size:
        starts = range(acknowledged, min(acknowledged + 7 * segments, size), 7)
        frame = yield [
            bytes([number | (sdo.NO_MORE_BLOCKS if start + 7 >= size else 0)])
            + document[start : start + 7].ljust(7, b"\0")
            for number, start in enumerate(starts, 1)
        ]
        _require_step(frame, sdo.BLOCK_TRANSFER_RESPONSE)
        if frame[1] > len(starts):
            raise SdoAbortedError(sdo.ABORT_INVALID_SEQUENCE_NUMBER)
        acknowledged += 7 * frame[1]
        if acknowledged < size:
            segments = _checked(frame[2])
    head = sdo.RESPONSE_BLOCK_UPLOAD | sdo.END_BLOCK_TRANSFER | -size % 7 << 2
    frame = yield [_BLOCK_END.pack(head, binascii.crc_hqx(document, 0))]
    _require_step(frame, sdo.END_BLOCK_TRANSFER)
    return [], None


def _announced(request: bytes, *, is_stated: int) -> int | None:
    if not is_stated:
        return None
    size = int.from_bytes(request[4:], "little")
    _require_length(size)
    return size


def _require_segment(segment: bytes, ask: int, toggle: int) -> None:
    if segment[0] & _SPECIFIER != ask:
        raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)
    if segment[0] & sdo.TOGGLE_BIT != toggle:
        raise SdoAbortedError(sdo.ABORT_TOGGLE_NOT_ALTERNATED)


def _require_step(frame: bytes, step: int) -> None:
    if frame[0] & _SUBCOMMAND != step:
        raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)


def _require_length(size: int) -> None:
    if size > LONGEST_DOCUMENT:
        raise SdoAbortedError(sdo.ABORT_LENGTH_TOO_HIGH)


def _checked(segments: int) -> int:
    if not 1 <= segments <= _BLOCK_SEGMENTS:
        raise SdoAbortedError(sdo.ABORT_INVALID_BLOCK_SIZE)
    return segments
