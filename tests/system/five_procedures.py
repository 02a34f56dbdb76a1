"""The packaged procedures as an operator types them, each twice in a row on one controller in another process.

Then `verify`, and `verify --open-loop` of the hinge's session. Every program is one of its own, on the loopback
bus, in real time; this one imports nothing of what it judges, so that it can be pointed at any installation:

    python tests/system/five_procedures.py                      # as shipped, ten minutes
    python tests/system/five_procedures.py --few                # with few poses, three minutes
    python tests/system/five_procedures.py --sarcal PATH/sarcal # another installation's

A fixture of its own is another controller; these run side by side. Prints what was run, how it ended and how
long it took. Exit code 0: all accepted.
"""

from __future__ import annotations

import argparse
import json
import os
import subprocess
import sys
import tempfile
import time
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import dataclass
from pathlib import Path

ROOT = Path(__file__).resolve().parents[2]
PROCEDURES = ("hinge", "hinge_planned", "rigid", "ball", "open_loop")
FEW = {"hinge": 15, "hinge_planned": 4, "rigid": 24, "ball": 24, "open_loop": 12}
FEW_NEW, FEW_OPEN = 4, 12
TIMES = 2
ACCEPTED = {"accepted", "accepted_with_warnings", "holds", "agrees"}
LONGEST_S = 900.0


@dataclass(frozen=True, kw_only=True)
class Ran:
    """One command: what it said its verdict is, how it ended and how long it took."""

    command: str
    verdict: str
    code: int
    seconds: float
    said: str

    @property
    def sound(self) -> bool:
        """Whether it was accepted, by exit code and by word, and nobody printed a traceback."""
        return self.code == 0 and self.verdict in ACCEPTED and "Traceback" not in self.said


@dataclass(frozen=True, kw_only=True)
class Day:
    """One installation, a folder to work in, and whether few poses are enough."""

    sarcal: tuple[str, ...]
    folder: Path
    few: bool

    def start(self, *arguments: str) -> subprocess.Popen[str]:
        """Begin a program."""
        return subprocess.Popen(
            [*self.sarcal, *arguments],
            cwd=self.folder,
            env={"OPENBLAS_NUM_THREADS": "1", **os.environ},
            stdin=subprocess.DEVNULL,
            stdout=subprocess.PIPE,
            stderr=subprocess.PIPE,
            text=True,
        )

    def run(self, *arguments: str) -> Ran:
        """Run a command to its end."""
        began = time.monotonic()
        process = self.start(*arguments, "--json")
        try:
            out, said = process.communicate(timeout=LONGEST_S)
        finally:
            process.kill()
        try:
            verdict = str(json.loads(out)["verdict"])
        except (ValueError, KeyError):
            verdict = "none"
        return Ran(
            command=" ".join(arguments),
            verdict=verdict,
            code=process.returncode,
            seconds=time.monotonic() - began,
            said=out + said,
        )

    @contextmanager
    def controller(self, procedure: str, channel: str, *more: str) -> Iterator[tuple[str, ...]]:
        """Run a controller; its bus, and the port of its tracker if it has one, as options."""
        bus = ("-i", "loopback", "-c", channel)
        process = self.start("controller", "--procedure", procedure, *bus, *more)
        try:
            assert process.stderr is not None
            told = process.stderr.readline().split()
            if channel not in told:
                raise RuntimeError(f"controller: {' '.join(told)} {process.communicate()[1]}")
            tracker = told.index("--tracker") if "--tracker" in told else len(told)
            yield (*bus, *told[tracker : tracker + 2])
        finally:
            process.terminate()
            process.communicate(timeout=60)

    def of(self, procedure: str) -> list[Ran]:
        """Run a procedure twice in a row on one controller, then its verifications."""
        own = f"five-{os.getpid()}-{procedure}"
        sessions = ("--sessions", procedure)
        tracker = ("--tracker-port", "0") if procedure == "open_loop" else ()
        poses = ("--poses", str(FEW[procedure])) if self.few else ()
        new = ("--poses", str(FEW_NEW)) if self.few else ()
        with self.controller(procedure, own, *tracker) as bus:
            ran = [self.run("run", procedure, *bus, *sessions, *poses) for _ in range(TIMES)]
            # The session knows its bus.
            ran.append(self.run("verify", "latest", *sessions, *new))
        if procedure == "hinge":
            new = ("--poses", str(FEW_OPEN)) if self.few else ()
            with self.controller("open_loop", f"{own}-open", "--tracker-port", "0") as bus:
                ran.append(self.run("verify", "latest", "--open-loop", *bus, *sessions, *new))
        return ran


def main() -> int:
    """Run the day and print its table."""
    parser = argparse.ArgumentParser(description=__doc__.splitlines()[0] if __doc__ else "")
    parser.add_argument("--few", action="store_true", help="as few poses as are accepted")
    parser.add_argument("--sarcal", type=Path, help="the program; default: this clone's")
    parser.add_argument("--only", choices=PROCEDURES, action="append", help="of all five")
    chosen = parser.parse_args()
    program = (
        (sys.executable, "-m", "operator_app.cli")
        if chosen.sarcal is None
        else (str(chosen.sarcal.resolve()),)
    )
    if chosen.sarcal is None:
        os.environ["PYTHONPATH"] = str(ROOT)
    with tempfile.TemporaryDirectory() as folder, ThreadPoolExecutor(len(PROCEDURES)) as side:
        day = Day(sarcal=program, folder=Path(folder), few=chosen.few)
        found = [ran for one in side.map(day.of, chosen.only or PROCEDURES) for ran in one]
    width = max(len(ran.command) for ran in found)
    print(f"{'sarcal':{width}}  {'verdict':22}  exit  seconds")
    for ran in found:
        print(f"{ran.command:{width}}  {ran.verdict:22}  {ran.code:4}  {ran.seconds:7.1f}")
    wrong = [ran for ran in found if not ran.sound]
    for ran in wrong:
        print(f"\nsarcal {ran.command}\n{ran.said[-4000:]}")
    print(f"\n{len(found) - len(wrong)} of {len(found)} accepted")
    return 1 if wrong else 0


if __name__ == "__main__":
    sys.exit(main())
