"""Kernel CAN with can-utils as peers, and its errors; runs as root in a guest Linux, and prints the results."""

# ruff: noqa: T201 - the guest's only output

import subprocess
import sys
import time
from pathlib import Path

import can

from hardware.buses.python_can import BusSettings, open_bus
from hardware.errors import BusError


def main() -> None:
    bus = open_bus(BusSettings(interface="socketcan", channel="vcan0"))
    dump = subprocess.Popen(
        ["candump", "-n", "2", "-L", "vcan0,181:7FF"], stdout=subprocess.PIPE, text=True
    )
    deadline = time.monotonic() + 60  # candump is ready when the kernel lists a receiver for 181h
    while " 181 " not in Path("/proc/net/can/rcvlist_fil").read_text():
        if time.monotonic() > deadline:
            sys.exit("candump did not start")
    bus.send(can.Message(arbitration_id=0x181, data=b"\x11\x22\x33", is_extended_id=False))
    bus.send(can.Message(arbitration_id=0x181, data=b"\xff", is_extended_id=False))
    print("DUMP", [line.split()[-1] for line in dump.communicate(timeout=60)[0].splitlines()])
    subprocess.run(["cansend", "vcan0", "581#4B41600027020000"], check=True)
    received = bus.recv(60)
    print("RECEIVED", hex(received.arbitration_id), received.data.hex())
    other = open_bus(BusSettings(interface="socketcan", channel="vcan0"))
    for _ in range(3000):  # two seconds of an arm's traffic, not read by a suspended program
        other.send(can.Message(arbitration_id=0x181, is_extended_id=False))
    other.shutdown()
    print("BUFFERED", sum(bus.recv(0) is not None for _ in range(4000)))
    try:
        open_bus(BusSettings(interface="socketcan", channel="vcan7"))
    except BusError as error:
        print("MISSING", error)
    subprocess.run(["ip", "link", "set", "vcan0", "down"], check=True)
    try:
        open_bus(BusSettings(interface="socketcan", channel="vcan0"))
    except BusError as error:
        print("DOWN", error)
    bus.shutdown()


if __name__ == "__main__":
    main()
