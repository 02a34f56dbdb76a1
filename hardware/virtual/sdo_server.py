"""A node's SDO server: expedited and segmented transfers (CiA 301), one at a time; block transfers are aborted.

It replaces the server of the `canopen` package, which answers in every NMT state, accepts any amount of data, fails
on an unexpected frame and only logs errors.
"""

from __future__ import annotations

import struct
from collections.abc import Generator
from typing import TYPE_CHECKING, Final

from canopen.sdo import constants as sdo
from canopen.sdo.exceptions import SdoAbortedError

from hardware.canopen.objects import COB_SDO_FROM_SERVER

if TYPE_CHECKING:
    from hardware.virtual.node import VirtualNode

_FRAME: Final = struct.Struct("<BHBI")
"""First byte, index, sub-index, and a size or an abort code."""
_SPECIFIER: Final = 0xE0
"""Mask of the command specifier in a frame's first byte."""
_SEGMENT_SPECIFIERS: Final = (sdo.REQUEST_SEGMENT_DOWNLOAD, sdo.REQUEST_SEGMENT_UPLOAD)
"""Command specifiers that continue a transfer; any other one begins a new transfer."""
LONGEST_DOCUMENT: Final = 256 * 1024
"""Largest number of bytes that a client may send in one transfer."""

Steps = Generator[bytes, bytes, tuple[bytes, bytes | None]]
"""Steps of a transfer: the generator yields the answer to a frame and receives the client's next frame.
It returns the last answer and the data received (None for an upload); it may raise `SdoAbortedError`."""


class Deferred(Exception):
    """Raised by a node during a write: the node will answer this write later (`NodeSdoServer.answer_later`)."""


class NodeSdoServer:
    """Server of one node; requests are ignored while the node's NMT state allows no object access."""

    def __init__(self, node: VirtualNode) -> None:
        self._node = node
        self._transfer: tuple[int, int, Steps] | None = None
        self._waiting: tuple[int, int, bytes] | None = None

    def on_request(self, data: bytes | bytearray) -> None:
        """Answer a request frame of 8 bytes."""
        if not self._node.has_sdo_and_emcy:
            return
        with self._node.lock:
            request, transfer = bytes(data), self._transfer
            self.reset()
            specifier = request[0] & _SPECIFIER
            if specifier == sdo.REQUEST_ABORTED:  # has no answer
                return
            _, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
            try:
                if transfer is not None and specifier in _SEGMENT_SPECIFIERS:
                    index, subindex, steps = transfer
                    answer = steps.send(request)
                else:
                    steps = self._initiate(request, specifier, index, subindex)
                    answer = next(steps)
                self._transfer = index, subindex, steps
            except StopIteration as end:
                answer, document = end.value
                self._waiting = index, subindex, answer
                self._finish(index, subindex, document)
                return
            except SdoAbortedError as error:
                answer = _FRAME.pack(sdo.RESPONSE_ABORTED, index, subindex, error.code)
            self._node.send(COB_SDO_FROM_SERVER, answer)

    def answer_later(self, abort: int | None) -> None:
        """Answer the deferred request (with `abort` if given), unless the client has abandoned the request."""
        with self._node.lock:
            if self._waiting is None:
                return
            (index, subindex, answer), self._waiting = self._waiting, None
            if abort is not None:
                answer = _FRAME.pack(sdo.RESPONSE_ABORTED, index, subindex, abort)
            if self._node.has_sdo_and_emcy:
                self._node.send(COB_SDO_FROM_SERVER, answer)

    def reset(self) -> None:
        """Drop the current transfer."""
        self._transfer = self._waiting = None

    def _initiate(self, request: bytes, specifier: int, index: int, subindex: int) -> Steps:
        if specifier == sdo.REQUEST_DOWNLOAD:
            self._node.check_writable(index, subindex)
            return _download(request)
        if specifier != sdo.REQUEST_UPLOAD:
            raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)
        document = self._node.read_object(index, subindex)
        if not document:
            raise SdoAbortedError(sdo.ABORT_NO_DATA_AVAILABLE)
        return _upload(request, document)

    def _finish(self, index: int, subindex: int, data: bytes | None) -> None:
        """Write received data (None: an upload) to the node, then answer the client unless the node answers later."""
        abort: int | None = None
        try:
            if data is not None:
                self._node.write_object(index, subindex, data)
        except Deferred:
            return
        except SdoAbortedError as error:
            abort = error.code
        self.answer_later(abort)


def _download(request: bytes) -> Steps:
    head, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
    answer = _FRAME.pack(sdo.RESPONSE_DOWNLOAD, index, subindex, 0)
    if head & sdo.EXPEDITED:
        size = 4 - (head >> 2 & 3) if head & sdo.SIZE_SPECIFIED else 4
        return answer, request[4 : 4 + size]
    announced = None
    if head & sdo.SIZE_SPECIFIED:
        announced = int.from_bytes(request[4:], "little")
        _require_length(announced)
    data, toggle, last = bytearray(), 0, 0
    while not last:
        segment = yield answer
        _require_segment(segment, sdo.REQUEST_SEGMENT_DOWNLOAD, toggle)
        data += segment[1 : 8 - (segment[0] >> 1 & 7)]
        _require_length(len(data))
        last = segment[0] & sdo.NO_MORE_DATA
        answer = bytes([sdo.RESPONSE_SEGMENT_DOWNLOAD | toggle, *bytes(7)])
        toggle ^= sdo.TOGGLE_BIT
    if announced not in (None, len(data)):
        raise SdoAbortedError(sdo.ABORT_LENGTH_NOT_MATCHED)
    return answer, bytes(data)


def _upload(request: bytes, document: bytes) -> Steps:
    _, index, subindex = sdo.SDO_STRUCT.unpack_from(request)
    size = len(document)
    if size <= 4:
        head = sdo.RESPONSE_UPLOAD | sdo.EXPEDITED | sdo.SIZE_SPECIFIED | (4 - size) << 2
        return sdo.SDO_STRUCT.pack(head, index, subindex) + document.ljust(4, b"\0"), None
    head, toggle = sdo.RESPONSE_UPLOAD | sdo.SIZE_SPECIFIED, 0
    answer = _FRAME.pack(head, index, subindex, size)
    for start in range(0, size, 7):
        segment = yield answer
        _require_segment(segment, sdo.REQUEST_SEGMENT_UPLOAD, toggle)
        part = document[start : start + 7]
        last = sdo.NO_MORE_DATA if start + 7 >= size else 0
        answer = bytes([toggle | (7 - len(part)) << 1 | last]) + part.ljust(7, b"\0")
        toggle ^= sdo.TOGGLE_BIT
    return answer, None


def _require_segment(segment: bytes, ask: int, toggle: int) -> None:
    if segment[0] & _SPECIFIER != ask:
        raise SdoAbortedError(sdo.ABORT_INVALID_COMMAND_SPECIFIER)
    if segment[0] & sdo.TOGGLE_BIT != toggle:
        raise SdoAbortedError(sdo.ABORT_TOGGLE_NOT_ALTERNATED)


def _require_length(size: int) -> None:
    if size > LONGEST_DOCUMENT:
        raise SdoAbortedError(sdo.ABORT_LENGTH_TOO_HIGH)
