"""Object access by SDO, one transfer at a time and node, from any thread but the receiving one. Knows no arm."""

from __future__ import annotations

import struct
import sys
import threading
from collections import Counter
from collections.abc import Callable, Iterable, Iterator
from contextlib import suppress
from typing import Any

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from hardware.canopen.objects import COB_SDO_FROM_SERVER, COB_SDO_TO_SERVER, DEVICE_TYPE
from hardware.errors import BusError, FramesLost, HardwareError, SdoRefused, TwoDevices

ANSWER_TIMEOUT_S = 1.0
READ_ATTEMPTS = 3
COMMAND_PATIENCE = 5.0
"""A command is answered when it is done: a document is parsed, or written to a disk."""
FEWEST_LOST, LOST_SHARE = 8, 0.1
"""Requests not answered in time, at the least and of all, from which on a bus is not gone on with: each was waited
for, and of the 600 of a connection some would fail three times. Where 1 % of all frames are lost, 2 connections in
10,000 are refused by it; where 10 % are, all."""
ASKED_AGAIN, TWICE_SHARE = 20, 0.75
"""Of a bus that doubles every tenth frame each way, one in 10^8 single devices answers so many of them twice."""
_ON_ITS_WAY_S = 0.02
_ABORT, _GENERAL_ERROR = 0x80, 0x08000000


class _Sender(canopen.Network):
    """The part of a canopen network that an SDO client uses."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send
        self.asked: Counter[int] = Counter()

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: FBT001, FBT002
        if data[0] != _ABORT:  # which is not answered
            self.asked[can_id - COB_SDO_TO_SERVER] += 1
        self._send(can_id, bytes(data))


class ObjectAccess:
    """Reads and writes objects of nodes.

    Parameters
    ----------
    send
        Puts a frame on the bus.
    nodes
        Nodes to talk to.
    timeout_s
        How long a node may take for an answer.

    Every access raises `SdoRefused` if the node refuses and `BusError` if it does not answer; reading raises
    `FramesLost` on a bus that loses too many.
    """

    def __init__(
        self,
        send: Callable[[int, bytes], None],
        nodes: Iterable[int],
        *,
        timeout_s: float = ANSWER_TIMEOUT_S,
    ) -> None:
        network = self._network = _Sender(send)
        self._answered: Counter[int] = Counter()
        self._unanswered: Counter[int] = Counter()
        self._known_surplus: Counter[int] = Counter()
        self._clients: dict[int, Any] = {}
        self._locks: dict[int, threading.Lock] = {}
        self._pause = threading.Event()
        for node in nodes:
            # canopen's annotations stop here.
            client: Any = SdoClient(  # type: ignore[no-untyped-call]
                COB_SDO_TO_SERVER + node,
                COB_SDO_FROM_SERVER + node,
                canopen.ObjectDictionary(),  # type: ignore[no-untyped-call]
            )
            client.network = network
            client.RESPONSE_TIMEOUT = timeout_s
            self._clients[node] = client
            self._locks[node] = threading.Lock()

    def deliver(self, identifier: int, data: bytes) -> None:
        """Take in an SDO answer; called by the thread that receives."""
        client = self._clients.get(identifier - COB_SDO_FROM_SERVER)
        if client is not None and len(data) == 8:
            self._answered[identifier - COB_SDO_FROM_SERVER] += 1
            client.on_response(identifier, data, 0.0)

    def answering_twice(self) -> tuple[int, ...]:
        """Nodes from which clearly more answers came than were asked for."""
        asked = self._network.asked
        return tuple(node for node, n in sorted(self._answered.items()) if n > 1.5 * asked[node])

    def require_single(self) -> None:
        """Ask nodes that gave an answer too many since this was called last, and see whether they go on.

        Frames are doubled by a bus as well, now and then: whoever answers nearly all of so many requests twice is two.

        Raises
        ------
        TwoDevices
        """
        suspects = [node for node, n in self._surplus().items() if n > self._known_surplus[node]]
        before = self._surplus()
        for node in suspects:
            for _ in range(ASKED_AGAIN):
                with suppress(BusError, SdoRefused, TwoDevices):
                    self.read_once(node, DEVICE_TYPE)
        if suspects:
            self._pause.wait(_ON_ITS_WAY_S)
        self._known_surplus = self._surplus()
        twice = tuple(
            node
            for node in suspects
            if self._known_surplus[node] - before[node] >= TWICE_SHARE * ASKED_AGAIN
        )
        if twice:
            raise TwoDevices(twice)

    def _surplus(self) -> Counter[int]:
        """By node, how many more answers came than were asked for; fewer where some are missing."""
        return Counter(
            {node: self._answered[node] - self._network.asked[node] for node in self._clients}
        )

    def read(self, node: int, index: int, subindex: int = 0) -> bytes:
        """Read an object's bytes."""
        for _ in range(READ_ATTEMPTS - 1):
            # Frames do get lost, or come twice; to ask again changes nothing.
            with suppress(TwoDevices):
                try:
                    return self.read_once(node, index, subindex)
                except BusError:
                    self._unanswered[node] += 1
                    self._require_answers()
            # What is still on its way would be taken for the next answer.
            self._pause.wait(_ON_ITS_WAY_S)
        return self.read_once(node, index, subindex)

    def _require_answers(self) -> None:
        """Raise where too many requests were not answered in time by nodes that are there."""
        asked = self._network.asked
        left = {n: (k, asked[n]) for n, k in sorted(self._unanswered.items()) if self._answered[n]}
        lost = sum(unanswered for unanswered, _ in left.values())
        if lost >= FEWEST_LOST and lost > LOST_SHARE * asked.total():
            raise FramesLost(left)

    def read_once(self, node: int, index: int, subindex: int = 0) -> bytes:
        """Read an object's bytes, and ask no second time if no answer comes."""
        data = self._guarded(node, index, subindex, lambda client: client.upload(index, subindex))
        return bytes(data)

    def read_unsigned(self, node: int, index: int, subindex: int = 0) -> int:
        """Read an unsigned integer of any size."""
        return int.from_bytes(self.read(node, index, subindex), "little")

    def read_signed(self, node: int, index: int, subindex: int = 0) -> int:
        """Read a signed integer of any size."""
        return int.from_bytes(self.read(node, index, subindex), "little", signed=True)

    def read_text(self, node: int, index: int, subindex: int = 0) -> str:
        """Read a visible string; bytes that are no text are shown as such."""
        data = self.read(node, index, subindex)
        return data.rstrip(b"\x00").decode("utf-8", "backslashreplace")

    def write(self, node: int, index: int, subindex: int, data: bytes) -> None:
        """Write an object's bytes, in segments if there are more than four."""
        self._guarded(node, index, subindex, lambda client: client.download(index, subindex, data))

    def write_unsigned(self, node: int, index: int, subindex: int, value: int, size: int) -> None:
        """Write an unsigned integer of `size` bytes."""
        self.write(node, index, subindex, value.to_bytes(size, "little"))

    def command(self, node: int, index: int, subindex: int, value: int) -> None:
        """Write one byte that has the node do something: it has `COMMAND_PATIENCE` times as long for its answer."""

        def ordered(client: Any) -> None:
            timeout_s = client.RESPONSE_TIMEOUT
            client.RESPONSE_TIMEOUT = COMMAND_PATIENCE * timeout_s
            try:
                client.download(index, subindex, bytes([value]))
            finally:
                client.RESPONSE_TIMEOUT = timeout_s

        self._guarded(node, index, subindex, ordered)

    def _guarded(self, node: int, index: int, subindex: int, access: Callable[[Any], Any]) -> Any:
        outside = sys.exception()  # what a caller is busy with is nothing that this access met
        with self._locks[node]:
            try:
                return access(self._clients[node])
            except (SdoAbortedError, SdoCommunicationError) as error:
                met = tuple(_met(error, outside))
                raise self._in_words(node, index, subindex, met) from error

    def _in_words(
        self, node: int, index: int, subindex: int, met: tuple[BaseException, ...]
    ) -> HardwareError | KeyboardInterrupt:
        """Say what went wrong with an access, that met these, the last first."""
        if any(isinstance(error, KeyboardInterrupt) for error in met):
            # The client wanted to end the transfer in good order, and could not: that is not the reason.
            self._network.send_message(
                COB_SDO_TO_SERVER + node,
                struct.pack("<BHBL", _ABORT, index, subindex, _GENERAL_ERROR),
            )
            return KeyboardInterrupt()
        if self._answered[node] > self._network.asked[node]:
            return TwoDevices((node,))
        silence = next((error for error in met if isinstance(error, SdoCommunicationError)), None)
        if silence is None and isinstance(met[0], SdoAbortedError):
            text = str(met[0]).partition(",")[2].strip() or "refused"
            return SdoRefused(node, index, subindex, met[0].code, text)
        # After a silence the client still closes its transfer, of which the node knows nothing any more: that
        # it refuses this is not the reason.
        remedy = "Check its power and the bus."
        if self._answered[node]:
            remedy = (
                f"It has answered {self._answered[node]} of {self._network.asked[node]} requests: the bus loses "
                "frames, or it is gone by now. Check cable, connectors and terminators, and its power."
            )
        return BusError(
            f"Node {node} does not answer when asked for {index:04X}h sub {subindex} ({silence}). {remedy}"
        )


def _met(error: BaseException | None, outside: BaseException | None) -> Iterator[BaseException]:
    """An error and those that it came upon, the last first, without what was there before."""
    while error is not None and error is not outside:
        yield error
        error = error.__context__
