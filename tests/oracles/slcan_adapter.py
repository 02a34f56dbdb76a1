"""A serial CAN adapter: Lawicel's ASCII protocol on a pty, connected to a bus. Shares nothing with python-can's slcan.

From the protocol's manual: ``O`` opens, ``C`` closes, ``S6`` sets a bitrate, ``tiiildd..`` is a frame in either
direction; every command ends with a carriage return.
"""

import os
import pty
import select
import threading
import tty
from collections.abc import Iterator
from contextlib import contextmanager

import can

from hardware.buses.loopback import LoopbackBus


@contextmanager
def slcan_adapter(bus: LoopbackBus) -> Iterator[tuple[str, list[str]]]:
    """The serial device of a running adapter, and the received commands other than frames."""
    ours, theirs = pty.openpty()
    tty.setraw(ours)
    tty.setraw(theirs)
    commands: list[str] = []
    ended = threading.Event()

    def run() -> None:
        received, is_open = b"", False
        while not ended.is_set():
            readable, _, _ = select.select([ours, bus], [], [], 0.05)
            if bus in readable and (frame := bus.recv(0.0)) is not None and is_open:
                text = f"t{frame.arbitration_id:03X}{len(frame.data)}{frame.data.hex().upper()}\r"
                os.write(ours, text.encode("ascii"))
            if ours in readable:
                *lines, received = (received + os.read(ours, 4096)).split(b"\r")
                for line in map(bytes.decode, lines):
                    if line[:1] != "t":
                        commands.append(line)
                        is_open = line[0] == "O" if line[:1] in ("O", "C") else is_open
                    elif is_open:
                        number, data = int(line[1:4], 16), bytes.fromhex(line[5:])
                        bus.send(
                            can.Message(arbitration_id=number, data=data, is_extended_id=False)
                        )
        os.close(ours)
        os.close(theirs)

    thread = threading.Thread(target=run, daemon=True)
    thread.start()
    try:
        yield os.ttyname(theirs), commands
    finally:
        ended.set()
        thread.join(5.0)
