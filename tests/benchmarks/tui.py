"""How fast the terminal app answers. Run: python -m tests.benchmarks.tui

The real program in a pseudo-terminal of 120 x 36. The virtual controller is a process of its own on
the loopback bus, 100 SYNC/s, and the screen is repainted 20 times a second. Printed:

- key to screen: from writing a key until the first byte of what it changes, p50 and p95, at rest and
  while a calibration runs
- STOP: from writing F8 until the seventh quick-stop frame is on the bus, seen by a third process's
  socket, at rest, in a dialog, and while a calibration runs on a loaded bus
"""

import os
import subprocess
import sys
import tempfile
import threading
import time
from pathlib import Path

import can
import numpy as np

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.cia402 import CONTROLWORD_QUICK_STOP
from hardware.canopen.objects import COB_RPDO1
from tests.oracles.pty_program import PtyProgram

SARCAL = str(Path(sys.executable).with_name("sarcal"))
CHANNEL = f"bench-{os.getpid()}"
POSES = 24
F8 = b"\x1b[19~"
JOINTS = 7
KEYS = STOPS = 100
PRESSES = 5
LOAD_PER_S = 500
"""Frames a second of other traffic while the bus is loaded."""


class StopWatch:
    """Listens on the bus for quick stops."""

    def __init__(self) -> None:
        self._bus = open_bus(BusSettings(interface="loopback", channel=CHANNEL))
        self._seen: dict[int, float] = {}
        self._news = threading.Condition()
        self._end = False
        self._thread = threading.Thread(target=self._listen, daemon=True)
        self._thread.start()

    def _listen(self) -> None:
        while not self._end:
            message = self._bus.recv(0.2)
            if message is None:
                continue
            node = message.arbitration_id - COB_RPDO1
            if 1 <= node <= JOINTS and len(message.data) >= 2:
                word = int.from_bytes(message.data[:2], "little")
                if word == CONTROLWORD_QUICK_STOP:
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

    def close(self) -> None:
        self._end = True
        self._thread.join()
        self._bus.shutdown()


class Load:
    """Other traffic on the bus: frames that concern nobody."""

    def __init__(self) -> None:
        self._end = threading.Event()
        self._thread = threading.Thread(target=self._send, daemon=True)
        self._thread.start()

    def _send(self) -> None:
        bus = open_bus(BusSettings(interface="loopback", channel=CHANNEL))
        message = can.Message(arbitration_id=0x7F0, data=bytes(8), is_extended_id=False)
        while not self._end.wait(1.0 / LOAD_PER_S):
            bus.send(message)
        bus.shutdown()

    def close(self) -> None:
        self._end.set()
        self._thread.join()


def main() -> None:
    with tempfile.TemporaryDirectory() as root:
        folder = Path(root)
        controller = subprocess.Popen(
            [SARCAL, "controller", "-i", "loopback", "-c", CHANNEL, "--seed", "1"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        app = PtyProgram(
            [SARCAL, "-i", "loopback", "-c", CHANNEL, "--scenario", "datasheet", "--seed", "1",
             "--poses", str(POSES)],
            size=(120, 36), folder=folder,
        )  # fmt: skip
        try:
            measure(app)
        finally:
            app.close()
            controller.terminate()
            controller.wait(20)


def measure(app: PtyProgram) -> None:
    app.seen("Enter connects", 0)
    app.press(b"\r", "goes on to Fixture")
    app.press(b"\r", "Check list")
    app.press(b"\r", "goes on to Modes")
    app.press(b"\r", "Ranked")
    app.press(b"a", "Apply the modes?")
    app.press(b"y", "goes on to Capture")
    app.press(b"\r", "What the poses determine")
    app.write(b"a")
    app.seen(f"all {POSES} poses captured", 0, patience_s=120.0)
    answers(app, "at rest")
    watch = StopWatch()
    try:
        stops(app, watch, "at rest")
        stops(app, watch, "in a dialog", before=b"q")
        load = Load()
        app.write(b"5")
        stops(
            app, watch, "dialog, solving, loaded bus", before=b"5sq", ends="ended by the operator"
        )
        load.close()
    finally:
        watch.close()
    answers(app, "while solving", solving=True)


def answers(app: PtyProgram, what: str, *, solving: bool = False) -> None:
    """Key to screen: to Capture and back to Connect, until its title is written.

    `solving`: a calibration is begun before each pair of keys and ended after it, which it says: so it ran.
    """
    times = []
    app.press(b"1", "Nodes")
    for _ in range(KEYS // 2):
        mark = app.mark()
        if solving:
            app.write(b"5s")
            threading.Event().wait(0.3)
        for keys, title in ((b"4", "Captured"), (b"1", "Nodes")):
            times.append(app.press(keys, title))
            # Not in step with the repaints, which are every 50 ms.
            threading.Event().wait(0.05 + 0.03 * (len(times) % 7))
        if solving:
            app.write(b"5z")
            app.seen("ended by the operator", mark)
            app.press(b"1", "Nodes")
    show(f"key, {what}", times)


def stops(
    app: PtyProgram, watch: StopWatch, what: str, before: bytes = b"", ends: str = ""
) -> None:
    """F8 to the seventh frame on the bus; each time reset before the next. `ends`: what it must end."""
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
        # What was written may be the message of the time before, moved up by a row: the work goes on then.
        threading.Event().wait(0.5)
    show(f"STOP, {what}", times)


def reset(app: PtyProgram) -> None:
    """Reset STOP; as a person does, again where the key fell into a dialog or work that was ending."""
    mark = app.mark()
    for _ in range(PRESSES):
        app.write(b"R")
        try:
            app.seen("STOP reset", mark, patience_s=3.0)
        except TimeoutError:
            continue
        return
    app.seen("STOP reset", mark, patience_s=3.0)


def show(what: str, times: list[float]) -> None:
    ms = 1e3 * np.array(times)
    p50, p95, p99 = np.percentile(ms, [50, 95, 99])
    print(
        f"{what:<34} p50 {p50:6.1f}  p95 {p95:6.1f}  p99 {p99:6.1f}  max {ms.max():6.1f} ms  (n {len(ms)})"
    )


if __name__ == "__main__":
    main()
