"""`sarcal run` against `sarcal controller` on a loopback bus that others fill: what came of it, by outsiders.

Three programs besides this one: the operator, the controller, the flood; and the kernel's clock.
"""

from __future__ import annotations

import os
import subprocess
import sys
import time
from contextlib import suppress
from dataclasses import dataclass
from datetime import datetime
from pathlib import Path

import numpy as np

from operator_app.session.journal import read_journal
from oracles.busy_bus import Rhythm, backlog_bytes, busy_bus
from oracles.fault_session import CLOSES, loop_error
from oracles.machine_pauses import Pauses, machine_pauses

ROOT = Path(__file__).resolve().parents[2]
SARCAL = [sys.executable, "-m", "operator_app.cli"]
PROCEDURE = ROOT / "operator_app" / "data" / "procedures" / "hinge.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class Came:
    """What came of a session.

    `code` and `said` of the operator; poses accepted, and the numbers of those that are not right;
    the longest queue that waited at any of the programs (the kernel keeps 8 MB before it drops a frame); how
    many frames others sent in how many seconds; when the machine itself stood still; what the journal has,
    with the second it was written in.
    """

    code: int
    said: str
    poses: int
    wrong: tuple[int, ...]
    backlog_bytes: int
    foreign: int
    took_s: float
    rhythm: Rhythm
    pauses: Pauses
    events: tuple[tuple[str, float], ...]

    def away_s(self) -> list[float]:
        """Of each gap between two SYNCs the seconds in which the machine itself stood still."""
        gaps = zip(self.rhythm.at_s, self.rhythm.gaps_s(), strict=False)
        return [self.pauses.within_s(begin, begin + gap) for begin, gap in gaps]


def session_under_load(
    folder: Path,
    channel: str,
    *,
    poses: int,
    samples: int,
    rate: float,
    busy: int = 0,
    patience_s: float = 1200.0,
) -> Came:
    """Run a session of so many poses while others send `rate` frames a second and `busy` processes compute."""
    text = PROCEDURE.read_text(encoding="utf-8")
    for old, new in (("poses: 40", f"poses: {poses}"), ("pose: 32", f"pose: {samples}")):
        if old not in text:
            raise ValueError(f"{PROCEDURE} has no {old!r}")
        text = text.replace(old, new)
    (folder / "load.yaml").write_text(text, encoding="utf-8")
    bus = ("-i", "loopback", "-c", channel, "--scenario", "exact")
    environment = {**os.environ, "PYTHONPATH": str(ROOT)}
    with subprocess.Popen(
        [*SARCAL, "controller", *bus],
        cwd=folder, env=environment, stderr=subprocess.PIPE, text=True,
    ) as controller:  # fmt: skip
        try:
            if controller.stderr is None or channel not in controller.stderr.readline():
                raise RuntimeError("the controller did not begin")
            with (
                machine_pauses() as pauses,
                busy_bus(channel, rate=rate, busy=busy) as watched,
                (folder / "said.txt").open("wb") as output,
            ):
                begun, foreign = time.monotonic(), watched.sent
                operator = subprocess.Popen(
                    [*SARCAL, "run", str(folder / "load.yaml"), *bus],
                    cwd=folder, env=environment, stdout=output, stderr=subprocess.STDOUT,
                )  # fmt: skip
                backlog = 0
                while operator.poll() is None:
                    backlog = max(backlog, backlog_bytes(channel))
                    with suppress(subprocess.TimeoutExpired):
                        operator.wait(0.1)
                    if time.monotonic() - begun > patience_s:
                        operator.kill()
                took_s, foreign = time.monotonic() - begun, watched.sent - foreign
        finally:
            controller.kill()
    if watched.rhythm is None:
        raise RuntimeError("the watcher of the bus did not report")
    events = [
        event
        for journal in (folder / "sessions").glob("*/journal.jsonl")
        for event in read_journal(journal.parent).events
    ]
    found = [event.data for event in events if event.name == "pose"]
    return Came(
        code=operator.returncode,
        said=(folder / "said.txt").read_text("utf-8", "replace"),
        poses=len(found),
        wrong=tuple(p["number"] for p in found if loop_error(np.array(p["mean_rad"])) > CLOSES),
        backlog_bytes=backlog,
        foreign=foreign,
        took_s=took_s,
        rhythm=watched.rhythm,
        pauses=pauses,
        events=tuple((e.name, datetime.fromisoformat(e.utc).timestamp()) for e in events),
    )
