"""The app's reports of stale or lost data, compared with the frames on the bus.

The program runs in a real terminal (tmux), the virtual controller in a process of its own on the loopback bus. A
listener keeps the kernel's stamp of every answer. operator_app/session/safety tests the journalled host latency.
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

COB_IDS = range(COB_TPDO1 + 1, COB_TPDO1 + 8)


class AnswerListener:
    """Kernel stamps of the answers of every joint on a channel."""

    def __init__(self, channel: str) -> None:
        self._bus = open_bus(BusSettings(interface="loopback", channel=channel))
        self._bus.set_filters(
            [{"can_id": i, "can_mask": 0x7FF, "extended": False} for i in COB_IDS]
        )
        self._stamps_s: dict[int, list[float]] = {identifier: [] for identifier in COB_IDS}
        self.close = self._bus.shutdown

    def age_s(self, at_s: float) -> float:
        """Age of the oldest joint's last answer at a wall clock time."""
        while (message := self._bus.recv(0.0)) is not None:
            self._stamps_s[message.arbitration_id].append(message.timestamp)
        return at_s - min(
            stamps[bisect_right(stamps, at_s) - 1]
            if stamps and stamps[0] <= at_s
            else -float("inf")
            for stamps in self._stamps_s.values()
        )


def observe(terminal: Terminal, listener: AnswerListener, number: int) -> list[list[bool]]:
    """Return for each observation whether the screen shows STALE, shows lost data, and whether data were old."""
    observations = []
    for _ in range(number):
        select(0.23)  # not in step with the repaints, which are every 50 ms
        at_s = time.time()
        screen = terminal.screen()
        lost = "LOST" in screen or "no data" in screen
        observations.append(["STALE" in screen, lost, listener.age_s(at_s) > STALE_S])
    return observations


def test_fresh_data_are_not_reported_stale_under_load_or_after_a_freeze(tmp_path):
    bus = ("-i", "loopback", "-c", f"ages-{os.getpid()}", "--seed", "1")
    with controller(tmp_path, *bus), ExitStack() as stack:
        listener = AnswerListener(bus[3])
        stack.callback(listener.close)
        terminal = Terminal(tmp_path, [*SARCAL, *bus, "--scenario", "datasheet"], size=(120, 36))
        stack.callback(terminal.close)
        terminal.until("Enter connects")
        terminal.keys("Enter")
        terminal.until("goes on to Fixture")
        observations = {"quiet": observe(terminal, listener, 12), "frozen": []}
        for _ in range(5):
            os.kill(terminal.pid(), signal.SIGSTOP)
            select(0.35)
            os.kill(terminal.pid(), signal.SIGCONT)
            observations["frozen"] += observe(terminal, listener, 4)
        for _ in range(4):
            load = subprocess.Popen([sys.executable, "-c", "while True: pass"])
            stack.callback(load.wait)
            stack.callback(load.kill)
        observations["busy"] = observe(terminal, listener, 12)
    for phase, rows in observations.items():
        stale, lost, old = map(sum, zip(*rows, strict=True))
        assert not lost, phase
        # Screen and bus are read one after the other: data old at one of the two moments may be called so.
        assert stale <= old + 1 + 5 * (phase == "frozen"), phase
