"""What the app says of the age of its data, beside what was on the wire.

The real program in a real terminal (tmux), the virtual controller in a process of its own on the loopback bus. A
third party listens there and keeps the kernel's stamp of every answer of every joint. At each look at the screen:
does it say STALE or lost, and how long ago did the joint that was silent longest answer?
"""

import os
import signal
import subprocess
import sys
import tempfile
import time
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

import pytest

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import COB_HEARTBEAT, COB_TPDO1
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from operator_app.session.ui.snapshot import STALE_S
from tests.oracles.terminal import Terminal, select

pytestmark = [pytest.mark.needs("tmux"), pytest.mark.campaign, pytest.mark.real_time]

SARCAL = str(Path(sys.executable).with_name("sarcal"))
EVERY_S = 0.23
"""Not in step with the repaints, which are every 50 ms."""
BUSY = 4
FREEZES, FROZEN_S = 5, 0.35
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


def wait_for_heartbeat(channel: str, patience_s: float = 60.0) -> None:
    """Wait until the controller is there."""
    end = time.monotonic() + patience_s
    with open_bus(BusSettings(interface="loopback", channel=channel)) as bus:
        while time.monotonic() < end:
            message = bus.recv(1.0)
            if message is not None and message.arbitration_id > COB_HEARTBEAT:
                return
    raise TimeoutError("the controller does not come up")


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """One look: what the screen said, and the true age of the oldest answer just before it was taken."""

    stale: bool
    lost: bool
    age_s: float

    @property
    def old(self) -> bool:
        """Whether the data were old, whatever was said."""
        return self.age_s > STALE_S


def looks_at(
    terminal: Terminal, listener: Listener, number: int, every_s: float = EVERY_S
) -> list[Look]:
    """Look at the screen a number of times."""
    found = []
    for _ in range(number):
        select(every_s)
        at_s = time.time()
        screen = terminal.screen()
        found.append(
            Look(
                stale="STALE" in screen,
                lost="LOST" in screen or "no data" in screen,
                age_s=listener.age_s(at_s),
            )
        )
    return found


def kept_in_journal(root: Path, patience_s: float = 20.0) -> int:
    """How often this computer was late, as the journal has it from the next pose on."""
    (journal,) = root.glob(f"sessions/*/{JOURNAL_NAME}")
    end = time.monotonic() + patience_s
    times = 0
    while not times and time.monotonic() < end:
        select(0.5)
        events = read_journal(journal.parent).events
        times = sum(event.data["times"] for event in events if event.name == "late")
    return times


def capture_by_itself(terminal: Terminal) -> None:
    """Go from Connect to Capture, and let it go on by itself."""
    for keys, shows in (
        (("Enter",), "Check list"),
        (("Enter",), "goes on to Modes"),
        (("Enter",), "Ranked"),
        (("a",), "Apply the modes?"),
        (("y",), "goes on to Capture"),
        (("Enter",), "What the poses determine"),
        (("a",), "ANY KEY STOPS"),
    ):
        terminal.keys(*keys)
        terminal.until(shows)


def watched(number: int) -> tuple[dict[str, list[Look]], int]:
    """Look at a program beside nothing, beside busy processes, as it captures, and frozen now and then.

    Also returns how often its journal says that this computer was late.
    """
    channel = f"ages-{os.getpid()}"
    with tempfile.TemporaryDirectory() as root:
        controller = subprocess.Popen(
            [SARCAL, "controller", "-i", "loopback", "-c", channel, "--seed", "1"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        listener = Listener(channel)
        wait_for_heartbeat(channel)
        command = [SARCAL, "-i", "loopback", "-c", channel, "--scenario", "datasheet", "--seed", "1",
                   "--poses", "60"]  # fmt: skip
        terminal = Terminal(Path(root), command, size=(120, 36))
        try:
            terminal.until("Enter connects")
            terminal.keys("Enter")
            terminal.until("goes on to Fixture")
            found = {"quiet": looks_at(terminal, listener, number)}
            spin = [sys.executable, "-c", "while True: pass"]
            busy = [subprocess.Popen(spin) for _ in range(BUSY)]
            try:
                found["busy"] = looks_at(terminal, listener, number)
            finally:
                for process in busy:
                    process.kill()
                    process.wait()
            capture_by_itself(terminal)
            found["capturing"] = looks_at(terminal, listener, number)
            pid, frozen = terminal.pid(), list[Look]()
            for _ in range(FREEZES):
                os.kill(pid, signal.SIGSTOP)
                select(FROZEN_S)
                os.kill(pid, signal.SIGCONT)
                frozen += looks_at(terminal, listener, 4, EVERY_S / 2)
            found["frozen"] = frozen
            return found, kept_in_journal(Path(root))
        finally:
            terminal.close()
            listener.close()
            controller.terminate()
            controller.wait(20)


def test_fresh_data_are_not_called_old_and_a_late_computer_is_named() -> None:
    found, times = watched(12)
    assert [len(looks) for looks in found.values()] == [12, 12, 12, 20]
    for what, looks in found.items():
        assert not any(look.lost for look in looks), what
        # A look and its screen are two moments: what is old on one of them may be called so.
        stale, old = (sum(getattr(look, name) for look in looks) for name in ("stale", "old"))
        assert stale <= old + 1 + 5 * (what == "frozen")
    # On the screen it is said at most every half a minute; in the journal each of them counts.
    assert times >= 1
