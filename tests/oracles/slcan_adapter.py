"""A serial CAN adapter: Lawicel's ASCII protocol on a pty, connected to a bus. Shares nothing with python-can's slcan.

From the protocol's manual: ``O`` opens, ``C`` closes, ``S6`` sets a bitrate, ``tiiildd..`` is a frame in either
direction; every command ends with a carriage return.
"""

import os
import pty
import select
import threading
import tty
from types import TracebackType
from typing import Self

import can


class SlcanAdapter:
    """`port` is the serial device; `commands` are the received commands other than frames."""

    def __init__(self, bus: can.BusABC) -> None:
        self._bus, self._ours = bus, -1
        self.commands: list[str] = []
        self._ours, self._theirs = pty.openpty()
        tty.setraw(self._ours)
        tty.setraw(self._theirs)
        self.port = os.ttyname(self._theirs)
        self._open, self._end = False, threading.Event()
        self._threads = [
            threading.Thread(target=work, daemon=True) for work in (self._from_host, self._to_host)
        ]

    def __enter__(self) -> Self:
        for thread in self._threads:
            thread.start()
        return self

    def __exit__(
        self,
        kind: type[BaseException] | None,
        error: BaseException | None,
        trace: TracebackType | None,
    ) -> None:
        self._end.set()
        for thread in self._threads:
            thread.join(5.0)
        os.close(self._ours)
        os.close(self._theirs)

    def _from_host(self) -> None:
        buffer = b""
        while not self._end.is_set():
            if not select.select([self._ours], [], [], 0.05)[0]:
                continue
            buffer += os.read(self._ours, 4096)
            *lines, buffer = buffer.split(b"\r")
            for line in lines:
                self._execute(line.decode("ascii"))

    def _execute(self, line: str) -> None:
        if line[:1] != "t":
            self.commands.append(line)
            if line[:1] in ("O", "C"):
                self._open = line[:1] == "O"
            return
        if self._open:
            length = int(line[4])
            self._bus.send(
                can.Message(
                    arbitration_id=int(line[1:4], 16),
                    data=bytes.fromhex(line[5 : 5 + 2 * length]),
                    is_extended_id=False,
                )
            )

    def _to_host(self) -> None:
        while not self._end.is_set():
            frame = self._bus.recv(0.05)
            if frame is not None and self._open:
                line = f"t{frame.arbitration_id:03X}{len(frame.data)}{frame.data.hex().upper()}\r"
                os.write(self._ours, line.encode("ascii"))
