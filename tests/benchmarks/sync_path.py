# ruff: noqa: T201 - a benchmark prints
"""What a SYNC costs the virtual controller, beside its plant. Run: python -m tests.benchmarks.sync_path

`no bus` swallows frames; `virtual` is python-can's bus, with a second handle that receives. `commands`
sends a new RPDO1 to every joint before each SYNC. CPU time of this process, us per SYNC.
"""

from __future__ import annotations

import argparse
import struct
import time
from collections.abc import Callable

import can

from hardware.virtual.controller import VirtualController
from tests.oracles.virtual_rig import ARM, TrivialPlant, axes


class NoBus(can.BusABC):
    def __init__(self) -> None:
        self.channel_info = "no bus"
        super().__init__(channel=None)

    def send(self, msg: can.Message, timeout: float | None = None) -> None:
        pass


def _cpu_us(work: Callable[[], None], count: int) -> float:
    began = time.process_time()
    for _ in range(count):
        work()
    return (time.process_time() - began) / count * 1e6


def measure(bus: can.BusABC, count: int) -> tuple[float, float, float]:
    """CPU time of the plant alone, of a SYNC, of seven commands and a SYNC."""
    settings = axes()
    plant = TrivialPlant([axis.scale.counts_per_rad for axis in settings])
    controller = VirtualController(bus, plant, axes=settings, arm=ARM)
    sync = can.Message(arbitration_id=0x80, is_extended_id=False)
    take_in = controller._take_in
    take_in(can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False))
    take_in(can.Message(arbitration_id=0x000, data=b"\x01\x00", is_extended_id=False))
    controller.supervisor.set_data(0x2010, 0, struct.pack("<I", 127))
    take_in(sync)

    def command(word: int, by: int) -> None:
        for joint, node in enumerate(controller.drives, start=1):
            data = struct.pack("<Hib", word, node.drive.target_counts + by, 8)
            take_in(can.Message(arbitration_id=0x200 + joint, data=data, is_extended_id=False))

    for word in (0x06, 0x07, 0x0F):
        command(word, 0)
    for _ in range(5):
        take_in(sync)
    direction = 1

    def command_and_sync() -> None:
        nonlocal direction
        direction = -direction
        command(0x0F, direction)
        take_in(sync)

    commands = [node.drive.command() for node in controller.drives]
    return (
        _cpu_us(lambda: plant.step(commands) and None, count),
        _cpu_us(lambda: take_in(sync), count),
        _cpu_us(command_and_sync, count),
    )


def main() -> None:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--count", type=int, default=5000)
    count = parser.parse_args().count
    with (
        NoBus() as no_bus,
        can.Bus("sync-path", interface="virtual") as near,
        can.Bus("sync-path", interface="virtual"),
    ):
        for name, bus in (("no bus", no_bus), ("virtual", near)):
            plant, sync, commanded = measure(bus, count)
            print(
                f"{name:8} SYNC {sync - plant:6.1f} us, with commands {commanded - plant:6.1f} us "
                f"(plant {plant:.1f} us not counted)"
            )


if __name__ == "__main__":
    main()
