"""A SocketCAN device with a full transmit queue: the kernel's slcan on a serial line without a reader.

Runs as root in User-Mode Linux (vcan0 has no queue); prints the kernel's error, and the results.
"""

# ruff: noqa: T201 - the guest's only output

import ctypes
import fcntl
import os
import pty
import struct
import subprocess
import threading
import time
import tty
from pathlib import Path

import can

from hardware.buses.python_can import BusSettings, open_bus
from hardware.buses.shared_bus import SharedBus
from hardware.errors import BusError

MODULE = Path("/usr/lib/uml/modules", os.uname().release, "kernel/drivers/net/can/slcan/slcan.ko")
FINIT_MODULE, TIOCSETD, N_SLCAN = 313, 0x5423, 17
BURST, FRAMES_PER_S = 2000, 4000.0
LINE = len("t201700112233445566\r")


class SerialLine:
    """The far end of the serial line: an adapter that receives frames while `reads` is set."""

    def __init__(self) -> None:
        libc = ctypes.CDLL(None, use_errno=True)
        libc.mount(b"devpts", b"/dev/pts", b"devpts", 0, b"ptmxmode=0666")
        module = os.open(MODULE, os.O_RDONLY)
        if libc.syscall(FINIT_MODULE, module, b"", 0):
            raise OSError(ctypes.get_errno(), "slcan.ko")
        self._far, near = pty.openpty()
        tty.setraw(near)
        self.reads, self.taken = threading.Event(), 0
        self.reads.set()
        threading.Thread(target=self._read, daemon=True).start()
        fcntl.ioctl(near, TIOCSETD, struct.pack("i", N_SLCAN))

    def _read(self) -> None:
        incomplete = b""
        while True:
            self.reads.wait()
            data = os.read(self._far, 8 * LINE)
            *lines, incomplete = (incomplete + data).split(b"\r")
            self.taken += sum(line.startswith(b"t201") for line in lines)
            time.sleep(len(data) / LINE / FRAMES_PER_S)


def main() -> None:
    """Bring the device up with a queue of ten frames, and send more than that."""
    line = SerialLine()
    for command in ("set can0 type can bitrate 1000000", "set can0 txqueuelen 10", "set can0 up"):
        subprocess.run(["ip", "link", *command.split()], check=True)
    bus = open_bus(BusSettings(interface="socketcan", channel="can0"))
    line.reads.clear()
    frame = can.Message(arbitration_id=0x123, data=bytes(8), is_extended_id=False)
    try:
        for _ in range(100_000):
            bus.send(frame)
    except can.CanOperationError as error:
        print("FULL", error.error_code)
    try:
        SharedBus(bus, send_timeout_s=0.01).send(0x080, b"")
    except BusError as error:
        print("ENDS", error)
    line.reads.set()
    wire = SharedBus(bus, send_timeout_s=2.0)
    for _ in range(BURST):
        wire.send(0x201, bytes(7))
    end_s = time.monotonic() + 60.0
    while line.taken < BURST and time.monotonic() < end_s:
        time.sleep(0.05)
    print("TAKEN", line.taken, "AGAIN", wire.queue_full)


if __name__ == "__main__":
    main()
