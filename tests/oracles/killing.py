"""Programs killed at instants that a seed chooses, one after another, until nothing more is left to kill.

A chain is one operator's day: `sarcal run`, killed, gone on with by --resume, killed again, to the end; and
so the next session. On the loopback bus the virtual controller is a program of its own and is killed too; its
parameters live in a folder. What must hold is looked at from outside, in files: no line of a journal that was
whole at a death is ever missing or changed, every pose that counts is right by the loop's own closure, the
parameter slot in force is one whole document, nobody prints a traceback.
"""

from __future__ import annotations

import hashlib
import json
import os
import random
import re
import signal
import subprocess
import time
from collections import Counter
from collections.abc import Iterator
from contextlib import suppress
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracles.fault_session import CLOSES, loop_error
from tests.oracles.own_process import SARCAL, environment

PATIENCE_S = 300.0
POSES = 6
PHASES = (
    "begin", "opened", "connected", "control", "modes", "pose", "pose", "pose", "reading",
    "solved", "checked", "exported",
)  # fmt: skip
"""After which entry of the journal somebody is killed; `begin`: from the start of the program on."""
LATEST_S = {"begin": 2.5, "exported": 0.3}
"""How long after it at most; else `LATER_S`."""
LATER_S = 1.5

CPU_S, MEMORY_MB = 5.0, 500.0
"""Most of the processor that noticing a dead controller may take, and of memory anybody."""


class Victim(Enum):
    """Who is killed; an embedded arm dies with its operator."""

    OPERATOR = "operator"
    CONTROLLER = "controller"
    EMBEDDED = "operator with its arm"


@dataclass
class Deaths:
    """What was seen of some kills.

    `killed`: how many by victim and by the journal's last entry then. `reactions_s`: CPU time of an operator
    from its controller's death to its own end. `words`: what operators said that ended by themselves.
    """

    killed: Counter[tuple[str, str]] = field(default_factory=Counter)
    sessions: int = 0
    poses: int = 0
    torn: int = 0
    faults: list[str] = field(default_factory=list)
    reactions_s: list[float] = field(default_factory=list)
    peak_mb: float = 0.0
    words: Counter[str] = field(default_factory=Counter)

    @property
    def total(self) -> int:
        return sum(self.killed.values())

    def add(self, other: Deaths) -> None:
        """Take in another chain's."""
        self.killed += other.killed
        self.words += other.words
        self.sessions += other.sessions
        self.poses += other.poses
        self.torn += other.torn
        self.faults += other.faults
        self.reactions_s += other.reactions_s
        self.peak_mb = max(self.peak_mb, other.peak_mb)


class Program:
    """One `sarcal`, its output in a file."""

    def __init__(self, folder: Path, name: str, *arguments: str) -> None:
        self.output = folder / f"{name}.txt"
        with self.output.open("wb") as output:
            self.process = subprocess.Popen(
                [*SARCAL, *arguments],
                cwd=folder,
                env=environment(),
                stdin=subprocess.DEVNULL,
                stdout=output,
                stderr=subprocess.STDOUT,
            )
        self.peak_mb = 0.0
        self.cpu_s = 0.0

    def said(self) -> str:
        return self.output.read_text("utf-8", "replace")

    def look(self) -> bool:
        """Whether it still runs; notes what it has taken so far."""
        with suppress(OSError, ValueError, IndexError):
            proc = Path(f"/proc/{self.process.pid}")
            found = re.search(r"VmHWM:\s+(\d+) kB", (proc / "status").read_text())
            if found:
                self.peak_mb = max(self.peak_mb, int(found[1]) / 1e3)
                times = (proc / "stat").read_text().rpartition(")")[2].split()
                ticks = int(times[11]) + int(times[12])
                self.cpu_s = ticks / os.sysconf("SC_CLK_TCK")
        return self.process.poll() is None

    def wait(self, seconds: float) -> bool:
        """Let it go on for so long; whether it still runs."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)
        return self.look()

    def kill(self) -> None:
        self.look()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


class Chain:
    """Kills until `kills` are done, then lets the last session come to its end."""

    def __init__(self, folder: Path, seed: int, kills: int, *, embedded: bool) -> None:
        self.folder, self.kills, self.embedded = folder, kills, embedded
        self.rng = random.Random(f"kills {seed}")  # noqa: S311 - to be repeated
        self.found = Deaths()
        self.channel = f"kills-{os.getpid()}-{seed}"
        self.controller: Program | None = None
        self.session: Path | None = None
        self.kept = b""
        self.documents: set[str] = set()
        self._programs = 0
        self._refused = 0
        folder.mkdir(parents=True, exist_ok=True)

    # ---- one day --------------------------------------------------------------------------------------

    def run(self) -> Deaths:
        try:
            while not self.found.faults:
                finished = self._life()
                if finished and self.found.total >= self.kills:
                    break
        finally:
            if self.controller is not None:
                self.controller.kill()
                self._look_at(self.controller)
        return self.found

    def _life(self) -> bool:
        """One operator program, to its end or its death; whether a session came to its end."""
        if not self.embedded and self.controller is None:
            self.controller = self._begin(
                "controller", "-i", "loopback", "-c", self.channel, "--scenario", "exact",
                "--state", "slots",
            )  # fmt: skip
            while "In another terminal" not in self.controller.said():
                if not self.controller.wait(0.02):
                    self._fault(f"the controller did not begin: {self.controller.said()}")
                    return True
        bus = () if self.embedded else ("-i", "loopback", "-c", self.channel)
        what = ("run", "hinge", "--poses", str(POSES), "--scenario", "exact")
        if self.session is not None:
            what = ("run", "--resume", str(self.session))
        known = set(self._sessions())
        operator = self._begin(*what, *bus)
        if self.found.total >= self.kills:
            return self._to_its_end(operator, known)
        victim = Victim.EMBEDDED
        if not self.embedded:
            victim = self.rng.choice((Victim.OPERATOR, Victim.OPERATOR, Victim.CONTROLLER))
        phase = self.rng.choice(PHASES)
        later_s = self.rng.random() ** 2 * LATEST_S.get(phase, LATER_S)
        if not self._wait_for(operator, phase, known) or operator.wait(later_s) is False:
            return self._to_its_end(operator, known)
        if victim is Victim.CONTROLLER and self.controller is not None:
            operator.look()
            before_s = operator.cpu_s
            self.controller.kill()
            self._note(victim)
            self._look_at(self.controller)
            self.controller = None
            finished = self._to_its_end(operator, known, alone=True)
            self.found.reactions_s.append(operator.cpu_s - before_s)
            if operator.cpu_s - before_s > CPU_S:
                self._fault(
                    f"{operator.cpu_s - before_s:.1f} s of CPU after the controller's death"
                )
            return finished
        operator.kill()
        self._find(known)
        self._note(victim)
        self._look_at(operator)
        self._look_at_journal()
        self._look_at_slots()
        return False

    def _to_its_end(self, operator: Program, known: set[Path], *, alone: bool = False) -> bool:
        """Wait until it ends by itself and judge how; `alone`: its controller is dead."""
        deadline = time.monotonic() + PATIENCE_S
        while operator.wait(0.05):
            if time.monotonic() > deadline:
                operator.kill()
                self._fault(f"did not end in {PATIENCE_S:g} s: {operator.said()[-600:]}")
                return True
        self._find(known)
        self._look_at(operator)
        self._look_at_journal()
        self._look_at_slots()
        code, said = operator.process.returncode, operator.said()
        if code in (0, 4):
            self._finish(code)
            return True
        last = said.strip().splitlines()[-1] if said.strip() else ""
        self.found.words[f"exit {code}: {re.sub(r'[0-9.]+', '#', last)[:150]}"] += 1
        if code != 3 or (alone and "the arm is held" in said):
            self._fault(f"exit code {code}: {said[-1500:]}")
        # What is advised may have to wait for the drives to trip; it may not be refused again and again.
        self._refused = 0 if alone else self._refused + 1
        if self._refused > 3:
            self._fault(f"does not go on: {said[-1500:]}")
        return False

    def _finish(self, code: int) -> None:
        """Judge a session that came to its end, and forget it."""
        poses = self._poses()
        used = [p for n, p in poses.items() if n not in self._excluded()]
        self.found.sessions += 1
        self.found.poses += len(used)
        self._refused = 0
        if len(used) != POSES:
            self._fault(f"{len(used)} poses in the end, not {POSES}")
        for pose in used:
            error = loop_error(np.array(pose["mean_rad"]))
            if error > CLOSES:
                self._fault(f"pose {pose['number']} is wrong: the loop is {error:.2g} from closed")
        if self.session is not None and code == 0:
            parameters = (self.session / "parameters.yaml").read_bytes()
            if not self.embedded and self._active() != parameters:
                self._fault("the slot in force is not what the session uploaded")
        self.session, self.kept = None, b""

    # ---- what there is --------------------------------------------------------------------------------

    def _begin(self, *arguments: str) -> Program:
        self._programs += 1
        return Program(self.folder, f"{arguments[0]}-{self._programs}", *arguments)

    def _sessions(self) -> Iterator[Path]:
        return (path.parent for path in (self.folder / "sessions").glob("*/journal.jsonl"))

    def _find(self, known: set[Path]) -> None:
        """Find the session that the operator began; one without its first line is none."""
        if self.session is None:
            for path in set(self._sessions()) - known:
                # A session in which no arm was found goes away again.
                with suppress(FileNotFoundError):
                    if b"\n" in (path / "journal.jsonl").read_bytes():
                        self.session = path

    def _events(self) -> list[dict[str, Any]]:
        if self.session is None or not (self.session / "journal.jsonl").exists():
            return []
        whole, _, _ = (self.session / "journal.jsonl").read_bytes().rpartition(b"\n")
        return [json.loads(line) for line in whole.splitlines()]

    def _poses(self) -> dict[int, dict[str, Any]]:
        return {e["data"]["number"]: e["data"] for e in self._events() if e["event"] == "pose"}

    def _excluded(self) -> set[int]:
        return {e["data"]["number"] for e in self._events() if e["event"] == "pose_excluded"}

    def _wait_for(self, operator: Program, phase: str, known: set[Path]) -> bool:
        """Wait until the journal has one more entry of that kind; false if the operator ended before."""
        if phase == "begin":
            return True
        mark = f'"event":"{phase}"'.encode()
        before = self.kept.count(mark)
        while operator.wait(0.01):
            self._find(known)
            if self.session is not None:
                with suppress(FileNotFoundError):
                    journal = (self.session / "journal.jsonl").read_bytes()
                    if journal.count(mark) > before:
                        return True
        return False

    def _active(self) -> bytes | None:
        """Document in force, by the files alone; None if there is none yet."""
        slots = self.folder / "slots"
        if not (slots / "active").exists():
            return None
        stored = (slots / f"slot_{(slots / 'active').read_text().lower()}").read_bytes()
        head, _, document = stored.partition(b"\n")
        if head.split()[-1].decode() != hashlib.sha256(document).hexdigest():
            self._fault("the slot in force is torn")
        return document

    # ---- what must hold -------------------------------------------------------------------------------

    def _note(self, victim: Victim) -> None:
        events = self._events()
        self.found.killed[victim.value, events[-1]["event"] if events else "begin"] += 1

    def _look_at(self, program: Program) -> None:
        said = program.said()
        if "Traceback" in said:
            self._fault(f"traceback: {said[-2500:]}")
        self.found.peak_mb = max(self.found.peak_mb, program.peak_mb)
        if program.peak_mb > MEMORY_MB:
            self._fault(f"{program.peak_mb:.0f} MB")

    def _look_at_journal(self) -> None:
        if self.session is None:
            return
        try:
            raw = (self.session / "journal.jsonl").read_bytes()
        except FileNotFoundError:
            if b'"event":"connected"' in self.kept:
                self._fault("the journal is gone")
            # A session in which no arm was found goes away again.
            self.session, self.kept = None, b""
            return
        if not raw.startswith(self.kept):
            self._fault("lines of the journal that were whole are missing or changed")
        whole = raw[: raw.rfind(b"\n") + 1]
        self.found.torn += whole != raw
        self.kept = whole

    def _look_at_slots(self) -> None:
        document = None if self.embedded else self._active()
        if document is not None and not document.endswith(b"\n"):
            self._fault("the document in force is cut off")

    def _fault(self, what: str) -> None:
        self.found.faults.append(f"{self.folder.name}, program {self._programs}: {what}")


def chain(folder: str, seed: int, kills: int, *, embedded: bool) -> Deaths:
    """Run one; for a pool of processes."""
    return Chain(Path(folder), seed, kills, embedded=embedded).run()
