# ruff: noqa: T201 - a benchmark prints
"""What the app says of the age of its data, beside what was on the wire. Run: python -m tests.benchmarks.ages [LOOKS]

The real program in a real terminal (tmux), the virtual controller in a process of its own on the loopback bus;
once on the machine as it is, once with four busy processes beside it, then with a program that the system lets
run in turn only (no real-time priority: as for most users), then while it is frozen for 0.35 s now and then.
A third party listens on the bus and keeps the kernel's stamp of every answer of every joint. At each look at
the screen: does it say STALE or lost, is it said that this computer was late, and how long ago did the joint
that was silent longest answer?
"""

from __future__ import annotations

import os
import shutil
import signal
import subprocess
import sys
import tempfile
import time
from bisect import bisect_right
from dataclasses import dataclass
from pathlib import Path

from hardware.buses.python_can import BusSettings, open_bus
from hardware.canopen.objects import COB_HEARTBEAT, COB_TPDO1
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from operator_app.session.ui.snapshot import STALE_S
from tests.oracles.terminal import Terminal, select

SARCAL = str(Path(sys.executable).with_name("sarcal"))
LOOKS = 40
EVERY_S = 0.23
"""Not in step with the repaints, which are every 50 ms."""
BUSY = 4
FREEZES, FROZEN_S = 5, 0.35
IN_TURN = ("setpriv", "--bounding-set", "-sys_nice", "--inh-caps", "-sys_nice")
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
    late: bool
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
                late="this computer was late" in screen,
                age_s=listener.age_s(at_s),
            )
        )
    return found


def busy_processes(number: int) -> list[subprocess.Popen[bytes]]:
    """Programs that compute and never rest."""
    return [subprocess.Popen([sys.executable, "-c", "while True: pass"]) for _ in range(number)]


def end(processes: list[subprocess.Popen[bytes]]) -> None:
    """End those that were started here."""
    for process in processes:
        process.kill()
        process.wait()


def show(what: str, looks: list[Look]) -> None:
    """Print what was seen."""
    ages = sorted(look.age_s for look in looks)
    true = sum(look.old for look in looks)
    print(
        f"{what:<22} looks {len(looks):3}  STALE {sum(k.stale for k in looks):3}  lost {sum(k.lost for k in looks):3}  "
        f"late said {sum(k.late for k in looks):3}  on the wire: older than 0.1 s {true:3}, "
        f"median {1e3 * ages[len(ages) // 2]:.0f} ms, oldest {1e3 * ages[-1]:.0f} ms"
    )


def main() -> None:
    """Look, and print."""
    number = int(sys.argv[1]) if len(sys.argv) > 1 else LOOKS
    for name, before in (("", ()), (", in turn", IN_TURN)):
        if before and shutil.which(before[0]) is None:
            print("setpriv (util-linux) is not there: not run without real-time priority")
            break
        found, times = watched(number, name, before)
        for what, looks in found.items():
            show(what, looks)
        print(f"in the journal: this computer was late {times} times")


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
        (("Enter",), "What the poses tell"),
        (("a",), "ANY KEY STOPS"),
    ):
        terminal.keys(*keys)
        terminal.until(shows)


def watched(number: int, name: str, before: tuple[str, ...]) -> tuple[dict[str, list[Look]], int]:
    """Look at a program and its controller that are started by the words `before`."""
    channel = f"ages-{os.getpid()}-{len(before)}"
    with tempfile.TemporaryDirectory() as root:
        controller = subprocess.Popen(
            [*before, SARCAL, "controller", "-i", "loopback", "-c", channel, "--seed", "1"],
            stdout=subprocess.DEVNULL, stderr=subprocess.DEVNULL,
        )  # fmt: skip
        listener = Listener(channel)
        wait_for_heartbeat(channel)
        command = [*before, SARCAL, "-i", "loopback", "-c", channel, "--scenario", "datasheet", "--seed", "1",
                   "--poses", "60"]  # fmt: skip
        terminal = Terminal(Path(root), command, size=(120, 36))
        try:
            terminal.until("Enter connects")
            terminal.keys("Enter")
            terminal.until("goes on to Fixture")
            found = {f"quiet{name}": looks_at(terminal, listener, number)}
            busy = busy_processes(BUSY)
            try:
                found[f"{BUSY} busy{name}"] = looks_at(terminal, listener, number)
            finally:
                end(busy)
            capture_by_itself(terminal)
            found[f"capturing{name}"] = looks_at(terminal, listener, number)
            pid, frozen = terminal.pid(), list[Look]()
            for _ in range(FREEZES):
                os.kill(pid, signal.SIGSTOP)
                select(FROZEN_S)
                os.kill(pid, signal.SIGCONT)
                frozen += looks_at(terminal, listener, 4, EVERY_S / 2)
            found[f"frozen {FROZEN_S} s{name}"] = frozen
            return found, kept_in_journal(Path(root))
        finally:
            terminal.close()
            listener.close()
            controller.terminate()
            controller.wait(20)


if __name__ == "__main__":
    main()
