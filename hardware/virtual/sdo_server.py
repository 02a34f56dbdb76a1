"""A node's SDO server: expedited, segmented and block transfers, one at a time.

It replaces the server of the `canopen` package, which answers in every NMT state, accepts any amount of data, fails
on an unexpected frame and only logs errors.
"""

from __future__ import annotations

import struct
from collections.abc import Callable
from dataclasses import dataclass
from enum import IntEnum
from typing import Any, Final

from canopen.sdo.exceptions import SdoAbortedError
from canopen.sdo.server import SdoServer

from hardware.canopen.objects import Abort
from hardware.virtual.sdo_block import BlockDownload, BlockUpload

_HEAD: Final = struct.Struct("<BHB")
_ABORT: Final = struct.Struct("<BHBI")
_SIZE: Final = struct.Struct("<I")
LONGEST_DOCUMENT: Final = 256 * 1024
"""Largest number of bytes that a client may send in one transfer."""


class _Ask(IntEnum):
    """Client command specifiers: the upper three bits of a request's first byte."""

    DOWNLOAD_SEGMENT = 0
    DOWNLOAD = 1
    UPLOAD = 2
    UPLOAD_SEGMENT = 3
    ABORT = 4
    BLOCK_UPLOAD = 5
    BLOCK_DOWNLOAD = 6


_SEGMENTS: Final = (_Ask.DOWNLOAD_SEGMENT, _Ask.UPLOAD_SEGMENT)
_DOWNLOADED: Final = 0x60
_SEGMENT_TAKEN: Final = 0x20
_UPLOADING: Final = 0x41
_UPLOADED: Final = 0x43
_ABORTED: Final = 0x80
_EXPEDITED, _SIZED, _LAST, _TOGGLE = 0x02, 0x01, 0x01, 0x10
_GOES_ON: Final = 0x03
"""Subcommand bits of a block upload; 0 in the request that initiates it."""


class Deferred(Exception):
    """Raised by a node during a write to say that it will call `NodeSdoServer.answer_later`."""


@dataclass(slots=True)
class _Transfer:
    index: int
    subindex: int
    data: bytearray
    downloading: bool
    announced: int | None = None
    toggle: int = 0
    sent: int = 0


@dataclass(slots=True)
class _Blocks:
    index: int
    subindex: int
    by: BlockDownload | BlockUpload


class NodeSdoServer(SdoServer):
    """Server of one node, whose `get_data` and `set_data` it calls.

    Requests have the identifier `rx_cobid`, answers `tx_cobid`. While `may_answer` returns false (because of the node's
    NMT state), requests are ignored.
    """

    def __init__(
        self, rx_cobid: int, tx_cobid: int, node: Any, may_answer: Callable[[], bool]
    ) -> None:
        super().__init__(rx_cobid, tx_cobid, node)  # type: ignore[no-untyped-call]
        self._owner = node
        self._may_answer = may_answer
        self._transfer: _Transfer | _Blocks | None = None
        self._waiting: tuple[int, int, bytes] | None = None

    def on_request(self, can_id: int, data: bytes | bytearray, timestamp: float) -> None:
        """Answer a request frame."""
        if len(data) != 8 or not self._may_answer():
            return
        with self._owner.lock:
            head, index, subindex = _HEAD.unpack_from(data)
            done = _HEAD.pack(_DOWNLOADED, index, subindex) + bytes(4)
            transfer = self._transfer
            if isinstance(transfer, _Transfer) and head >> 5 in _SEGMENTS:
                index, subindex = transfer.index, transfer.subindex
                done = bytes([_SEGMENT_TAKEN | transfer.toggle, *bytes(7)])
            blocks = self._blocks_of(head)
            if blocks is not None:
                index, subindex, done = blocks.index, blocks.subindex, BlockDownload.ENDED
            try:
                if blocks is None:
                    self._answer(bytes(data), head, index, subindex)
                else:
                    self._go_on(blocks, bytes(data))
            except Deferred:
                self._transfer, self._waiting = None, (index, subindex, done)
            except SdoAbortedError as error:
                self._transfer = None
                self._abort(index, subindex, error.code)

    def answer_later(self, abort: Abort | None) -> None:
        """Answer the deferred request (with `abort` if given), unless the client has abandoned the request."""
        with self._owner.lock:
            if self._waiting is None:
                return
            (index, subindex, done), self._waiting = self._waiting, None
            if not self._may_answer():
                return
            if abort is None:
                self.network.send_message(self.tx_cobid, done)
            else:
                self._abort(index, subindex, abort)

    def reset(self) -> None:
        """Drop the current transfer."""
        self._transfer = self._waiting = None

    def _answer(self, data: bytes, head: int, index: int, subindex: int) -> None:
        self._waiting = None
        match head >> 5:
            case _Ask.DOWNLOAD:
                self._begin_download(data, head, index, subindex)
            case _Ask.DOWNLOAD_SEGMENT:
                self._take_segment(data, head)
            case _Ask.UPLOAD:
                self._begin_upload(index, subindex, self._to_upload(index, subindex))
            case _Ask.BLOCK_UPLOAD if not head & _GOES_ON:
                self._begin_block_upload(data, index, subindex)
            case _Ask.BLOCK_DOWNLOAD if not head & _LAST:
                self._begin_block_download(data, head, index, subindex)
            case _Ask.UPLOAD_SEGMENT:
                self._give_segment(head)
            case _Ask.ABORT:  # has no answer
                self._transfer = None
            case _:
                raise SdoAbortedError(Abort.UNKNOWN_COMMAND)

    def _begin_download(self, data: bytes, head: int, index: int, subindex: int) -> None:
        self._transfer = None
        if head & _EXPEDITED:
            size = 4 - (head >> 2 & 3) if head & _SIZED else 4
            self._owner.set_data(index, subindex, data[4 : 4 + size], check_writable=True)
        else:
            announced = _SIZE.unpack_from(data, 4)[0] if head & _SIZED else None
            self._owner.check_writable(index, subindex)
            _require_length(announced or 0)
            self._transfer = _Transfer(index, subindex, bytearray(), True, announced)
        self._send(_DOWNLOADED, index, subindex)

    def _take_segment(self, data: bytes, head: int) -> None:
        transfer = self._expect(head, downloading=True)
        transfer.data += data[1 : 8 - (head >> 1 & 7)]
        _require_length(len(transfer.data))
        if head & _LAST:
            self._transfer = None
            if transfer.announced not in (None, len(transfer.data)):
                raise SdoAbortedError(Abort.LENGTH)
            self._owner.set_data(
                transfer.index, transfer.subindex, bytes(transfer.data), check_writable=True
            )
        self.network.send_message(
            self.tx_cobid, bytes([_SEGMENT_TAKEN | transfer.toggle, *bytes(7)])
        )
        transfer.toggle ^= _TOGGLE

    def _begin_upload(self, index: int, subindex: int, data: bytes) -> None:
        size = len(data)
        if size <= 4:
            self._send(_UPLOADED | (4 - size) << 2, index, subindex, data)
        else:
            self._transfer = _Transfer(index, subindex, bytearray(data), False)
            self._send(_UPLOADING, index, subindex, _SIZE.pack(size))

    def _give_segment(self, head: int) -> None:
        transfer = self._expect(head, downloading=False)
        part = bytes(transfer.data[transfer.sent : transfer.sent + 7])
        transfer.sent += len(part)
        last = transfer.sent >= len(transfer.data)
        first = transfer.toggle | (7 - len(part)) << 1 | (_LAST if last else 0)
        self.network.send_message(self.tx_cobid, bytes([first]) + part.ljust(7, b"\0"))
        transfer.toggle ^= _TOGGLE
        if last:
            self._transfer = None

    def _to_upload(self, index: int, subindex: int) -> bytes:
        self._transfer = None
        data: bytes = self._owner.get_data(index, subindex, check_readable=True)
        if not data:
            raise SdoAbortedError(Abort.NO_DATA)
        return data

    def _begin_block_upload(self, data: bytes, index: int, subindex: int) -> None:
        document = self._to_upload(index, subindex)
        if len(document) <= data[5]:  # protocol switch threshold: normal upload
            self._begin_upload(index, subindex, document)
            return
        by = BlockUpload(document, data[4])
        self._transfer = _Blocks(index, subindex, by)
        self.network.send_message(self.tx_cobid, by.begin(index, subindex))

    def _begin_block_download(self, data: bytes, head: int, index: int, subindex: int) -> None:
        self._transfer = None
        announced = _SIZE.unpack_from(data, 4)[0]
        self._owner.check_writable(index, subindex)
        by = BlockDownload(head, announced)
        _require_length(by.announced or 0)
        self._transfer = _Blocks(index, subindex, by)
        self.network.send_message(self.tx_cobid, by.begin(index, subindex))

    def _blocks_of(self, head: int) -> _Blocks | None:
        """Return the current block transfer if the frame continues it, otherwise None."""
        match self._transfer:
            case _Blocks(by=BlockDownload()) if head != _ABORTED:
                return self._transfer
            case _Blocks(by=BlockUpload()) if head >> 5 == _Ask.BLOCK_UPLOAD:
                return self._transfer if head & _GOES_ON else None
        return None

    def _go_on(self, blocks: _Blocks, data: bytes) -> None:
        by, answers = blocks.by, list[bytes]()
        if isinstance(by, BlockUpload):
            answers = by.answer(data)
            if not answers:
                self._transfer = None
        elif by.done:
            self._transfer = None
            document = by.end(data)
            self._owner.set_data(blocks.index, blocks.subindex, document, check_writable=True)
            answers = [by.ENDED]
        else:
            answer = by.take(data)
            _require_length(len(by.data))
            answers = [] if answer is None else [answer]
        for frame in answers:
            self.network.send_message(self.tx_cobid, frame)

    def _expect(self, head: int, *, downloading: bool) -> _Transfer:
        """Return the transfer that a segment belongs to; raises `SdoAbortedError` if there is none."""
        transfer = self._transfer
        if not isinstance(transfer, _Transfer) or transfer.downloading is not downloading:
            raise SdoAbortedError(Abort.UNKNOWN_COMMAND)
        if head & _TOGGLE != transfer.toggle:
            raise SdoAbortedError(Abort.TOGGLE)
        return transfer

    def _send(self, head: int, index: int, subindex: int, data: bytes = b"") -> None:
        frame = _HEAD.pack(head, index, subindex) + data.ljust(4, b"\0")
        self.network.send_message(self.tx_cobid, frame)

    def _abort(self, index: int, subindex: int, code: int) -> None:
        self.network.send_message(self.tx_cobid, _ABORT.pack(_ABORTED, index, subindex, code))


def _require_length(size: int) -> None:
    if size > LONGEST_DOCUMENT:
        raise SdoAbortedError(Abort.TOO_LONG)
