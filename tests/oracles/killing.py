"""Sessions whose processes are killed at random times and resumed, and invariants of their files.

`sarcal run` is killed and resumed until it ends, session after session. On the loopback bus the virtual controller is
a second process, which is killed too; its parameter slots are in a folder. Invariants, checked from outside: a
complete journal line is never lost or changed, every accepted pose closes the loop, the active parameter slot is one
complete document, no process prints a traceback.
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
from contextlib import suppress
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any

import numpy as np

from tests.oracles.fault_session import MAX_CLOSURE_ERROR, loop_error
from tests.oracles.own_process import SARCAL, environment

PATIENCE_S = 300.0
POSES = 6
PHASES = (
    "begin", "opened", "connected", "control", "modes", "pose", "pose", "pose", "reading",
    "solved", "checked", "exported",
)  # fmt: skip
"""Journal events after which a process is killed; `begin` is the start of the program."""
LATEST_S = {"begin": 2.5, "exported": 0.3}
LATER_S = 1.5
"""Longest delay of a kill after the event: by event, and of all others."""

CPU_S, MEMORY_MB = 5.0, 500.0
"""Limits of the CPU time to detect a dead controller, and of the memory of a process."""


@dataclass
class KillStatistics:
    """Kills, completed sessions with their poses, and violated invariants."""

    kills: int = 0
    sessions: int = 0
    poses: int = 0
    faults: list[str] = field(default_factory=list)


class Program:
    def __init__(self, folder: Path, name: str, *arguments: str) -> None:
        self._file = folder / f"{name}.txt"
        with self._file.open("wb") as output:
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

    def output(self) -> str:
        return self._file.read_text("utf-8", "replace")

    def wait(self, seconds: float = 0.0) -> bool:
        """Wait, update memory and CPU time, and return whether the process still runs."""
        with suppress(subprocess.TimeoutExpired):
            self.process.wait(seconds)
        with suppress(OSError, ValueError, IndexError):
            proc = Path(f"/proc/{self.process.pid}")
            peak = re.search(r"VmHWM:\s+(\d+) kB", (proc / "status").read_text())
            if peak:
                self.peak_mb = max(self.peak_mb, int(peak[1]) / 1e3)
                times = (proc / "stat").read_text().rpartition(")")[2].split()
                self.cpu_s = (int(times[11]) + int(times[12])) / os.sysconf("SC_CLK_TCK")
        return self.process.poll() is None

    def kill(self) -> None:
        self.wait()
        self.process.send_signal(signal.SIGKILL)
        self.process.wait()


class KillSequence:
    """Repeats kills until there are `kills`, then completes the last session."""

    def __init__(self, folder: Path, seed: int, kills: int, *, embedded: bool) -> None:
        self.folder, self.kills, self.embedded = folder, kills, embedded
        self.rng = random.Random(f"kills {seed}")  # noqa: S311 - to be repeated
        self.deaths = KillStatistics()
        self.channel = f"kills-{os.getpid()}-{seed}"
        self.controller: Program | None = None
        self.session: Path | None = None
        self.complete_lines = b""
        self._programs = 0
        self._refused = 0
        folder.mkdir(parents=True, exist_ok=True)

    def run(self) -> KillStatistics:
        try:
            while not self.deaths.faults:
                finished = self._run_operator()
                if finished and self.deaths.kills >= self.kills:
                    break
        finally:
            if self.controller is not None:
                self.controller.kill()
                self._check_program(self.controller)
        return self.deaths

    def _run_operator(self) -> bool:
        """Run one operator process until it ends or is killed; whether a session was completed."""
        if not self.embedded and self.controller is None:
            self.controller = self._start(
                "controller", "-i", "loopback", "-c", self.channel, "--scenario", "exact",
                "--state", "slots",
            )  # fmt: skip
            while "In another terminal" not in self.controller.output():
                if not self.controller.wait(0.02):
                    self._fault(f"the controller did not start: {self.controller.output()}")
                    return True
        bus = () if self.embedded else ("-i", "loopback", "-c", self.channel)
        command = ("run", "hinge", "--poses", str(POSES), "--scenario", "exact")
        if self.session is not None:
            command = ("run", "--resume", str(self.session))
        earlier = self._sessions()
        operator = self._start(*command, *bus)
        if self.deaths.kills >= self.kills:
            return self._await_end(operator, earlier)
        # An embedded arm is part of the operator's process.
        kill_controller = not self.embedded and self.rng.choice((False, False, True))
        phase = self.rng.choice(PHASES)
        delay_s = self.rng.random() ** 2 * LATEST_S.get(phase, LATER_S)
        if not self._wait_for(operator, phase, earlier) or not operator.wait(delay_s):
            return self._await_end(operator, earlier)
        self.deaths.kills += 1
        if kill_controller and self.controller is not None:
            operator.wait()
            before_s = operator.cpu_s
            self.controller.kill()
            self._check_program(self.controller)
            self.controller = None
            finished = self._await_end(operator, earlier, controller_dead=True)
            reaction_s = operator.cpu_s - before_s
            if reaction_s > CPU_S:
                self._fault(f"{reaction_s:.1f} s of CPU after the controller's death")
            return finished
        operator.kill()
        self._find_session(earlier)
        self._check_program(operator)
        self._check_files()
        return False

    def _await_end(
        self, operator: Program, earlier: set[Path], *, controller_dead: bool = False
    ) -> bool:
        """Wait until the operator ends by itself and check the result; whether a session was completed."""
        deadline = time.monotonic() + PATIENCE_S
        while operator.wait(0.05):
            if time.monotonic() > deadline:
                operator.kill()
                self._fault(f"did not end in {PATIENCE_S:g} s: {operator.output()[-600:]}")
                return True
        self._find_session(earlier)
        self._check_program(operator)
        self._check_files()
        code, output = operator.process.returncode, operator.output()
        if code in (0, 4):
            self._check_session(code)
            return True
        if code != 3 or (controller_dead and "the arm is held" in output):
            self._fault(f"exit code {code}: {output[-1500:]}")
        # A resumption may be refused until the drives have tripped, but not repeatedly.
        self._refused = 0 if controller_dead else self._refused + 1
        if self._refused > 3:
            self._fault(f"cannot be resumed: {output[-1500:]}")
        return False

    def _check_session(self, code: int) -> None:
        """Check a completed session, and forget it."""
        events = self._events()
        excluded = {e["data"]["number"] for e in events if e["event"] == "pose_excluded"}
        poses = {e["data"]["number"]: e["data"] for e in events if e["event"] == "pose"}
        used = [pose for number, pose in poses.items() if number not in excluded]
        self.deaths.sessions += 1
        self.deaths.poses += len(used)
        self._refused = 0
        if len(used) != POSES:
            self._fault(f"{len(used)} poses instead of {POSES}")
        for pose in used:
            error = loop_error(np.array(pose["mean_rad"]))
            if error > MAX_CLOSURE_ERROR:
                self._fault(f"pose {pose['number']} is wrong: closure error {error:.2g}")
        if self.session is not None and code == 0:
            parameters = (self.session / "parameters.yaml").read_bytes()
            if not self.embedded and self._active_document() != parameters:
                self._fault("the active slot is not the document that the session uploaded")
        self.session, self.complete_lines = None, b""

    def _start(self, *arguments: str) -> Program:
        self._programs += 1
        return Program(self.folder, f"{arguments[0]}-{self._programs}", *arguments)

    def _sessions(self) -> set[Path]:
        return {path.parent for path in (self.folder / "sessions").glob("*/journal.jsonl")}

    def _find_session(self, earlier: set[Path]) -> None:
        """Find the session that the operator began: a journal with a complete first line."""
        if self.session is None:
            for path in self._sessions() - earlier:
                # A session without an arm is removed again.
                with suppress(FileNotFoundError):
                    if b"\n" in (path / "journal.jsonl").read_bytes():
                        self.session = path

    def _events(self) -> list[dict[str, Any]]:
        if self.session is None or not (self.session / "journal.jsonl").exists():
            return []
        complete, _, _ = (self.session / "journal.jsonl").read_bytes().rpartition(b"\n")
        return [json.loads(line) for line in complete.splitlines()]

    def _wait_for(self, operator: Program, phase: str, earlier: set[Path]) -> bool:
        """Wait for the next journal event of a kind; false if the operator ends before."""
        if phase == "begin":
            return True
        event = f'"event":"{phase}"'.encode()
        before = self.complete_lines.count(event)
        while operator.wait(0.01):
            self._find_session(earlier)
            if self.session is not None:
                with suppress(FileNotFoundError):
                    if (self.session / "journal.jsonl").read_bytes().count(event) > before:
                        return True
        return False

    def _active_document(self) -> bytes | None:
        """Document of the active slot, from the files alone; None before the first upload."""
        slots = self.folder / "slots"
        if not (slots / "active").exists():
            return None
        stored = (slots / f"slot_{(slots / 'active').read_text().lower()}").read_bytes()
        header, _, document = stored.partition(b"\n")
        if header.split()[-1].decode() != hashlib.sha256(document).hexdigest():
            self._fault("the active slot has a wrong checksum")
        return document

    def _check_program(self, program: Program) -> None:
        output = program.output()
        if "Traceback" in output:
            self._fault(f"traceback: {output[-2500:]}")
        if program.peak_mb > MEMORY_MB:
            self._fault(f"{program.peak_mb:.0f} MB")

    def _check_files(self) -> None:
        if self.session is not None:
            try:
                self._check_journal((self.session / "journal.jsonl").read_bytes())
            except FileNotFoundError:
                if b'"event":"connected"' in self.complete_lines:
                    self._fault("the journal is missing")
                # A session without an arm is removed again.
                self.session, self.complete_lines = None, b""
        document = None if self.embedded else self._active_document()
        if document is not None and not document.endswith(b"\n"):
            self._fault("the active document is truncated")

    def _check_journal(self, journal: bytes) -> None:
        if not journal.startswith(self.complete_lines):
            self._fault("complete lines of the journal are missing or changed")
        self.complete_lines = journal[: journal.rfind(b"\n") + 1]

    def _fault(self, text: str) -> None:
        self.deaths.faults.append(f"{self.folder.name}, program {self._programs}: {text}")
