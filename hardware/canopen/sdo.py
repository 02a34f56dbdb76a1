"""Object access by SDO: one transfer at a time per node, from any thread except the receiving thread."""

import io
import struct
import threading
import time
from collections import Counter
from collections.abc import Callable, Iterable
from contextlib import suppress
from typing import Any

import canopen
from canopen.sdo.client import SdoClient, WritableStream
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from hardware import errors
from hardware.canopen.objects import COB_SDO_FROM_SERVER, COB_SDO_TO_SERVER, DEVICE_TYPE
from hardware.timed_queue import TimedQueue

ANSWER_TIMEOUT_S = 1.0
READ_ATTEMPTS = 3
COMMAND_TIMEOUT_FACTOR = 5.0
"""The time-out of a command is this many times the usual one, because a command is answered only once it has been
carried out (a document has been parsed, or written to disk)."""
MIN_UNANSWERED, MAX_UNANSWERED_FRACTION = 8, 0.1
"""Access stops when at least MIN_UNANSWERED requests, and more than the fraction MAX_UNANSWERED_FRACTION of all
requests, are unanswered. A connection needs 600 requests: if 1 % of all frames are lost, 2 connections in 10,000 are
refused; if 10 % are lost, every connection is."""
MAX_OBJECT_BYTES, MAX_DOCUMENT_BYTES = 4096, 256 * 1024
"""Largest number of bytes read from an object, and from a parameter document (2000h)."""
MIN_READ_BYTES_PER_S = 1000.0
"""A read ends after the time that `max_bytes` bytes take at this rate, plus the time-out of one answer."""
UNIQUENESS_REQUESTS, DUPLICATE_FRACTION = 20, 0.75
"""Number of test requests to a node. If at least the fraction DUPLICATE_FRACTION is answered twice, two devices have
the node's number. If every tenth frame is doubled in each direction, a single device reaches this fraction with a
probability of 3 in 100,000."""
_IN_TRANSIT_S = 0.02
_ABORT, _GENERAL_ERROR = 0x80, 0x08000000


class _Sender:
    """The part of a canopen network that an SDO client uses; counts requests by node."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        self._send = send
        self.asked: Counter[int] = Counter()

    def send_message(self, can_id: int, data: bytes) -> None:
        if data[0] != _ABORT:  # an abort is not answered
            self.asked[can_id - COB_SDO_TO_SERVER] += 1
        self._send(can_id, bytes(data))


class _Client(SdoClient):
    """An SDO client that queues answers in a `TimedQueue` instead of canopen's `queue.Queue`.

    Ctrl-C during a wait can leave a `queue.Queue` locked, which would block the receiving thread.
    """

    @property
    def responses(self) -> Any:
        return self._responses

    @responses.setter
    def responses(self, _empty: object) -> None:
        self._responses: TimedQueue[bytes] = TimedQueue()

    def download(self, index: int, subindex: int, data: bytes, force_segment: bool = False) -> None:  # noqa: FBT001, FBT002
        stream: Any = _WriteStream(self, index, subindex, len(data), force_segment)  # type: ignore[no-untyped-call]
        rest = memoryview(data)
        while True:  # an empty value takes one write
            rest = rest[stream.write(rest) :]
            if not rest:
                break


class _WriteStream(WritableStream):
    """Stream for writing an object. Closing the stream sends nothing.

    The garbage collector may close the stream of a failed write in any thread. canopen's stream would then send a last
    segment. The control loop's thread could block: only it receives the answer, and it may already hold the bus lock.
    """

    def close(self) -> None:
        io.RawIOBase.close(self)


class ObjectAccess:
    """Reads and writes objects of `nodes`; `timeout_s` limits the wait for each answer.

    `send` puts a frame on the bus. Every access raises `SdoRefused` if the node refuses and `BusError` if it does not
    answer. Reading also raises `FramesLost` if too many answers are missing, and `EndlessAnswer` for an answer that is
    too long or too slow.
    """

    def __init__(
        self,
        send: Callable[[int, bytes], None],
        nodes: Iterable[int],
        *,
        timeout_s: float = ANSWER_TIMEOUT_S,
        clock: Callable[[], float] = time.monotonic,
    ) -> None:
        self.raise_if_cancelled: Callable[[], None] = lambda: None
        """Raises an error if accesses are to end; called before each access, and before each further segment read."""
        self._timeout_s, self._clock = timeout_s, clock
        network = self._network = _Sender(send)
        self._answered: Counter[int] = Counter()
        self._unanswered: Counter[int] = Counter()
        self._known_surplus: Counter[int] = Counter()
        self._asked_by_others: set[int] = set()
        self._clients: dict[int, Any] = {}
        self._locks: dict[int, threading.Lock] = {}
        self._pause = threading.Event()
        for node in nodes:
            client: Any = _Client(  # type: ignore[no-untyped-call]
                COB_SDO_TO_SERVER + node,
                COB_SDO_FROM_SERVER + node,
                canopen.ObjectDictionary(),  # type: ignore[no-untyped-call]
            )
            client.network = network
            client.RESPONSE_TIMEOUT = timeout_s
            self._clients[node] = client
            self._locks[node] = threading.Lock()

    def deliver(self, identifier: int, data: bytes) -> None:
        """Take in an SDO answer of a node or an SDO request of another program; called by the receiving thread."""
        if identifier - COB_SDO_TO_SERVER in self._clients:
            self._asked_by_others.add(identifier - COB_SDO_TO_SERVER)
        client = self._clients.get(identifier - COB_SDO_FROM_SERVER)
        if client is not None and len(data) == 8:
            self._answered[identifier - COB_SDO_FROM_SERVER] += 1
            client.on_response(identifier, data, 0.0)

    def require_single_answers(self) -> None:
        """Raise `DuplicateNodeId` for the nodes that have sent more than 1.5 answers per request."""
        requests, answers = self._network.asked, sorted(self._answered.items())
        if duplicates := tuple(node for node, n in answers if n > 1.5 * requests[node]):
            raise self._duplicate_error(duplicates)

    def _duplicate_error(self, nodes: tuple[int, ...]) -> errors.DuplicateNodeId:
        return errors.DuplicateNodeId(
            nodes, asked_by_others=self._asked_by_others.issuperset(nodes)
        )

    def require_unique_nodes(self) -> None:
        """Raise `DuplicateNodeId` for nodes that answer most test requests twice: two devices share the number.

        Only nodes that sent surplus answers since the last call are tested; a bus may have duplicated single frames.
        """
        suspects = [node for node, n in self._surplus().items() if n > self._known_surplus[node]]
        before = self._surplus()
        for node in suspects:
            for _ in range(UNIQUENESS_REQUESTS):
                with suppress(errors.BusError, errors.SdoRefused, errors.DuplicateNodeId):
                    self.read_once(node, DEVICE_TYPE)
        if suspects:
            self._pause.wait(_IN_TRANSIT_S)
        self._known_surplus = self._surplus()
        more, doubled = self._known_surplus - before, DUPLICATE_FRACTION * UNIQUENESS_REQUESTS
        if twice := tuple(node for node in suspects if more[node] >= doubled):
            raise self._duplicate_error(twice)

    def _surplus(self) -> Counter[int]:
        asked = self._network.asked
        return Counter({node: self._answered[node] - asked[node] for node in self._clients})

    def read(
        self, node: int, index: int, subindex: int = 0, *, max_bytes: int = MAX_OBJECT_BYTES
    ) -> bytes:
        """Read an object's bytes, in up to `READ_ATTEMPTS` attempts."""
        for _ in range(READ_ATTEMPTS - 1):
            # Frames may be lost or doubled; reading again changes nothing.
            with suppress(errors.DuplicateNodeId):
                try:
                    return self.read_once(node, index, subindex, max_bytes=max_bytes)
                except errors.EndlessAnswer:
                    raise
                except errors.BusError:
                    self._unanswered[node] += 1
                    self._require_answers()
            # Without this pause, a late answer would be taken for the answer to the next request.
            self._pause.wait(_IN_TRANSIT_S)
        return self.read_once(node, index, subindex, max_bytes=max_bytes)

    def _require_answers(self) -> None:
        requests = self._network.asked
        counts = sorted(self._unanswered.items())
        unanswered = {n: (k, requests[n]) for n, k in counts if self._answered[n]}
        lost = sum(count for count, _ in unanswered.values())
        if lost >= MIN_UNANSWERED and lost > MAX_UNANSWERED_FRACTION * requests.total():
            raise errors.FramesLost(unanswered)

    def read_once(
        self, node: int, index: int, subindex: int = 0, *, max_bytes: int = MAX_OBJECT_BYTES
    ) -> bytes:
        """Read an object's bytes without a second attempt."""
        limit_s = max_bytes / MIN_READ_BYTES_PER_S + self._timeout_s

        def upload(client: Any) -> bytes:
            began_s, data = self._clock(), b""
            stream = client.open(index, subindex, buffering=0)
            try:
                while segment := stream.read(7):
                    data += segment
                    taken_s = self._clock() - began_s
                    if len(data) > max_bytes or taken_s > limit_s:
                        raise errors.EndlessAnswer(
                            node, index, subindex, len(data), max_bytes, limit_s
                        )
                    self.raise_if_cancelled()
            except errors.HardwareError:
                client.abort()
                raise
            return data

        return bytes(self._exclusive(node, index, subindex, upload))

    def read_unsigned(self, node: int, index: int, subindex: int = 0) -> int:
        """Read an unsigned integer of any size."""
        return int.from_bytes(self.read(node, index, subindex), "little")

    def read_signed(self, node: int, index: int, subindex: int = 0) -> int:
        """Read a signed integer of any size."""
        return int.from_bytes(self.read(node, index, subindex), "little", signed=True)

    def read_text(self, node: int, index: int, subindex: int = 0) -> str:
        """Read a visible string; invalid bytes become escapes."""
        return self.read(node, index, subindex).rstrip(b"\x00").decode("utf-8", "backslashreplace")

    def write(self, node: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object's bytes, in segments if there are more than four."""
        self._exclusive(
            node, index, subindex, lambda client: client.download(index, subindex, data)
        )

    def write_unsigned(self, node: int, index: int, subindex: int, value: int, size: int) -> None:
        """Write an unsigned integer of `size` bytes."""
        self.write(node, index, subindex, value.to_bytes(size, "little"))

    def command(self, node: int, index: int, subindex: int, value: int) -> None:
        """Write one byte that starts an action; the time-out is `COMMAND_TIMEOUT_FACTOR` times the usual one."""

        def download(client: Any) -> None:
            timeout_s = client.RESPONSE_TIMEOUT
            client.RESPONSE_TIMEOUT = COMMAND_TIMEOUT_FACTOR * timeout_s
            try:
                client.download(index, subindex, bytes([value]))
            finally:
                client.RESPONSE_TIMEOUT = timeout_s

        self._exclusive(node, index, subindex, download)

    def _exclusive(self, node: int, index: int, subindex: int, access: Callable[[Any], Any]) -> Any:
        with self._locks[node]:
            self.raise_if_cancelled()
            try:
                return access(self._clients[node])
            except (SdoAbortedError, SdoCommunicationError) as error:
                raise self._translated(node, index, subindex, error) from error
            except KeyboardInterrupt:
                abort = struct.pack("<BHBL", _ABORT, index, subindex, _GENERAL_ERROR)
                self._network.send_message(COB_SDO_TO_SERVER + node, abort)
                raise

    def _translated(
        self, node: int, index: int, subindex: int, error: SdoAbortedError | SdoCommunicationError
    ) -> errors.HardwareError:
        if self._answered[node] > self._network.asked[node]:
            return self._duplicate_error((node,))
        if isinstance(error, SdoAbortedError):
            text = str(error).partition(",")[2].strip() or "refused"
            return errors.SdoRefused(node, index, subindex, error.code, text)
        remedy = "Check its power and the bus."
        if self._answered[node]:
            remedy = (
                f"It has answered {self._answered[node]} of {self._network.asked[node]} requests: the bus loses "
                "frames, or the node has failed. Check cable, connectors, terminators and the node's power."
            )
        return errors.BusError(
            f"Node {node} does not answer when asked for {index:04X}h sub {subindex} ({error}). {remedy}"
        )
