"""How fast the software STOP of the terminal app is. Run: python -m tests.benchmarks.tui

The real program in a pseudo-terminal of 120 x 36, the virtual controller in a process of its own on the loopback bus,
100 SYNC/s. Printed: the time from writing F8 until the seventh quick-stop frame is on the bus, seen by a third
socket, at rest, in a dialog, and while a calibration runs on a loaded bus.
"""

import os
import tempfile
import threading
import time
from contextlib import suppress
from pathlib import Path

import can
import numpy as np

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.cia402 import CONTROLWORD_QUICK_STOP
from hardware.canopen.objects import COB_RPDO1
from tests.oracles.own_process import SARCAL, controller
from tests.oracles.pty_program import WALK, PtyProgram

CHANNEL = f"bench-{os.getpid()}"
POSES = 24
F8 = b"\x1b[19~"
JOINTS = 7
QUICK_STOP = CONTROLWORD_QUICK_STOP.to_bytes(2, "little")
STOPS = 100
PRESSES = 5
LOAD_PER_S = 500
"""Frames a second of other traffic while the bus is loaded."""


class StopWatch:
    """Listens on the bus for quick stops."""

    def __init__(self, bus: can.BusABC) -> None:
        self._seen: dict[int, float] = {}
        self._news = threading.Condition()
        self._notifier = can.Notifier(bus, [self._note])
        self.close = self._notifier.stop

    def _note(self, message: can.Message) -> None:
        node = message.arbitration_id - COB_RPDO1
        if 1 <= node <= JOINTS and message.data[:2] == QUICK_STOP:
            with self._news:
                self._seen.setdefault(node, time.monotonic())
                self._news.notify_all()

    def quiet(self) -> None:
        """Wait until nothing is sent any more: the loop repeats quick stop until the reset has come."""
        with self._news:
            for _ in range(20):
                self._seen.clear()
                if not self._news.wait_for(lambda: bool(self._seen), timeout=0.1):
                    return
        raise RuntimeError("quick stop goes on though nobody asked for it")

    def all_seven(self) -> float:
        with self._news:
            if not self._news.wait_for(lambda: len(self._seen) == JOINTS, timeout=5.0):
                raise TimeoutError(f"quick stop reached {sorted(self._seen)} only")
            return max(self._seen.values())


def main() -> None:
    bus = ("-i", "loopback", "-c", CHANNEL, "--seed", "1")
    with tempfile.TemporaryDirectory() as root, controller(Path(root), *bus):
        command = [*SARCAL, *bus, "--scenario", "datasheet", "--poses", str(POSES)]
        app = PtyProgram(command, size=(120, 36), folder=Path(root))
        try:
            measure(app)
        finally:
            app.close()


def measure(app: PtyProgram) -> None:
    app.seen("Enter connects", 0)
    for keys, text in WALK:
        app.press(keys, text)
    app.seen(f"all {POSES} poses captured", 0, patience_s=120.0)
    app.press(b"1", "Nodes")
    with open_bus(BusSettings(interface="loopback", channel=CHANNEL)) as bus:
        watch = StopWatch(bus)
        try:
            stops(app, watch, "at rest")
            stops(app, watch, "in a dialog", before=b"q")
            foreign = can.Message(arbitration_id=0x7F0, data=bytes(8), is_extended_id=False)
            load = bus.send_periodic(foreign, 1.0 / LOAD_PER_S)
            app.write(b"5")
            ends = "ended by the operator"
            stops(app, watch, "dialog, solving, loaded bus", before=b"5sq", ends=ends)
            load.stop()
        finally:
            watch.close()


def stops(
    app: PtyProgram, watch: StopWatch, what: str, before: bytes = b"", ends: str = ""
) -> None:
    """F8 to the seventh frame on the bus; each time reset before the next. `ends`: message of the ended task."""
    times = []
    for _ in range(STOPS):
        if before:
            app.write(before)
            threading.Event().wait(0.2)
        watch.quiet()
        mark = app.mark()
        pressed = app.write(F8)
        times.append(watch.all_seven() - pressed)
        app.seen("SOFTWARE STOP", mark)
        if ends:
            app.seen(ends, mark)
        if before:
            app.write(b"\x1b")
            threading.Event().wait(0.3)
        reset(app)
        # The text may have been an earlier message, moved up by a row, while the task goes on.
        threading.Event().wait(0.5)
    ms = 1e3 * np.array(times)
    p50, p95, p99 = np.percentile(ms, [50, 95, 99])
    print(f"{what:<30} p50 {p50:6.1f}  p95 {p95:6.1f}  p99 {p99:6.1f}  max {ms.max():6.1f} ms")


def reset(app: PtyProgram) -> None:
    """Reset STOP; as a person does, again if the key reached a dialog or a task that was ending."""
    mark = app.mark()
    for patience_s in (*[3.0] * PRESSES, 60.0):
        app.write(b"R")
        with suppress(TimeoutError):
            app.seen("STOP reset", mark, patience_s)
            return
    raise TimeoutError("STOP was not reset")


if __name__ == "__main__":
    main()
