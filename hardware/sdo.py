"""Object access by SDO, one transfer at a time and node, from any thread but the receiving one. Knows no arm."""

from __future__ import annotations

import threading
from collections.abc import Callable, Iterable
from typing import Any

import canopen
from canopen.sdo.client import SdoClient
from canopen.sdo.exceptions import SdoAbortedError, SdoCommunicationError

from hardware.errors import BusError, SdoRefused
from hardware.objects import COB_SDO_FROM_SERVER, COB_SDO_TO_SERVER

ANSWER_TIMEOUT_S = 1.0


class _Sender(canopen.Network):
    """The part of a canopen network that an SDO client uses."""

    def __init__(self, send: Callable[[int, bytes], None]) -> None:
        super().__init__()
        self._send = send

    def send_message(self, can_id: int, data: bytes, remote: bool = False) -> None:  # noqa: FBT001, FBT002
        self._send(can_id, bytes(data))


class ObjectAccess:
    """Reads and writes objects of nodes.

    Parameters
    ----------
    send
        Puts a frame on the bus.
    nodes
        Nodes to talk to.

    Every access raises `SdoRefused` if the node refuses and `BusError` if it does not answer.
    """

    def __init__(self, send: Callable[[int, bytes], None], nodes: Iterable[int]) -> None:
        network = _Sender(send)
        self._clients: dict[int, Any] = {}
        self._locks: dict[int, threading.Lock] = {}
        for node in nodes:
            # canopen's annotations stop here.
            client: Any = SdoClient(  # type: ignore[no-untyped-call]
                COB_SDO_TO_SERVER + node,
                COB_SDO_FROM_SERVER + node,
                canopen.ObjectDictionary(),  # type: ignore[no-untyped-call]
            )
            client.network = network
            client.RESPONSE_TIMEOUT = ANSWER_TIMEOUT_S
            self._clients[node] = client
            self._locks[node] = threading.Lock()

    def deliver(self, identifier: int, data: bytes) -> None:
        """Take in an SDO answer; called by the thread that receives."""
        client = self._clients.get(identifier - COB_SDO_FROM_SERVER)
        if client is not None and len(data) == 8:
            client.on_response(identifier, data, 0.0)

    def read(self, node: int, index: int, subindex: int = 0) -> bytes:
        """Read an object's bytes."""
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

    def _guarded(self, node: int, index: int, subindex: int, access: Callable[[Any], Any]) -> Any:
        with self._locks[node]:
            try:
                return access(self._clients[node])
            except SdoAbortedError as error:
                text = str(error).partition(",")[2].strip() or "refused"
                raise SdoRefused(node, index, subindex, error.code, text) from error
            except SdoCommunicationError as error:
                raise BusError(
                    f"Node {node} does not answer when asked for {index:04X}h sub {subindex} "
                    f"({error}). Check its power and the bus."
                ) from error
