"""What the app says of the age of its data, beside what was on the wire.

The real program in a real terminal (tmux), the virtual controller in a process of its own on the loopback bus. A
third party listens there and keeps the kernel's stamp of every answer of every joint. At each look at the screen:
does it say STALE or lost, and how long ago did the joint that was silent longest answer? That a journal keeps how
often this computer was late is tested in operator_app/session/safety.
"""

import os
import signal
import subprocess
import sys
import time
from bisect import bisect_right
from contextlib import ExitStack

import pytest

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import COB_TPDO1
from operator_app.session.ui.snapshot import STALE_S
from tests.oracles.own_process import SARCAL, controller
from tests.oracles.terminal import Terminal, select

pytestmark = [pytest.mark.needs("tmux"), pytest.mark.campaign, pytest.mark.real_time]

JOINTS = 7


class Listener:
    """Kernel stamps of the answers of every joint on a channel."""

    def __init__(self, channel: str) -> None:
        bus = open_bus(BusSettings(interface="loopback", channel=channel))
        answers = [
            {"can_id": COB_TPDO1 + joint, "can_mask": 0x7FF, "extended": False}
            for joint in range(1, JOINTS + 1)
        ]
        bus.set_filters(answers)
        self._bus = bus
        self.stamps_s: dict[int, list[float]] = {joint: [] for joint in range(1, JOINTS + 1)}

    def take_in(self) -> None:
        """Read what has come; the kernel keeps 4 MB of it meanwhile."""
        while (message := self._bus.recv(0.0)) is not None:
            self.stamps_s[message.arbitration_id - COB_TPDO1].append(message.timestamp)

    def age_s(self, at_s: float) -> float:
        """How long before that time (wall clock) the joint silent longest had answered."""
        self.take_in()
        ages = []
        for stamps in self.stamps_s.values():
            before = bisect_right(stamps, at_s)
            ages.append(at_s - stamps[before - 1] if before else float("inf"))
        return max(ages)

    def close(self) -> None:
        """Stop listening."""
        self._bus.shutdown()


def looks_at(terminal: Terminal, listener: Listener, number: int) -> list[tuple[bool, bool, bool]]:
    """Whether the screen said STALE, whether it said lost, and whether the data were old, look by look."""
    found = []
    for _ in range(number):
        select(0.23)  # not in step with the repaints, which are every 50 ms
        at_s = time.time()
        screen = terminal.screen()
        lost = "LOST" in screen or "no data" in screen
        found.append(("STALE" in screen, lost, listener.age_s(at_s) > STALE_S))
    return found


def test_fresh_data_are_not_called_old_beside_busy_processes_nor_after_a_freeze(tmp_path):
    bus = ("-i", "loopback", "-c", f"ages-{os.getpid()}", "--seed", "1")
    with controller(tmp_path, *bus), ExitStack() as stack:
        listener = Listener(bus[3])
        stack.callback(listener.close)
        terminal = Terminal(tmp_path, [*SARCAL, *bus, "--scenario", "datasheet"], size=(120, 36))
        stack.callback(terminal.close)
        terminal.until("Enter connects")
        terminal.keys("Enter")
        terminal.until("goes on to Fixture")
        found = {"quiet": looks_at(terminal, listener, 12), "frozen": []}
        for _ in range(5):
            os.kill(terminal.pid(), signal.SIGSTOP)
            select(0.35)
            os.kill(terminal.pid(), signal.SIGCONT)
            found["frozen"] += looks_at(terminal, listener, 4)
        for _ in range(4):
            spinning = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(spinning.wait)
            stack.callback(spinning.kill)
        found["busy"] = looks_at(terminal, listener, 12)
    for what, looks in found.items():
        stale, lost, old = (sum(column) for column in zip(*looks, strict=True))
        assert not lost, what
        # A look and its screen are two moments: what is old on one of them may be called so.
        assert stale <= old + 1 + 5 * (what == "frozen"), what
