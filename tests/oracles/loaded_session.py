"""`sarcal run` with `sarcal controller` on a loopback bus under load, observed from outside."""

import re
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from pathlib import Path

import numpy as np

from tests.oracles.bus_load import SyncRecord, backlog_bytes, loaded_bus
from tests.oracles.fault_session import MAX_CLOSURE_ERROR, loop_error
from tests.oracles.journal_events import event_data
from tests.oracles.machine_pauses import MachinePauses, machine_pauses
from tests.oracles.own_process import ROOT, SARCAL, controller, environment

DRIVES_TRIP_S = 0.25
"""Pause of one processor after which drives on another one, with its queue, miss the heartbeat for 0.5 s."""
END_S = 2.0
"""Longest time between a pause and the last SYNC of a session that it ended."""
PROCEDURE = ROOT / "operator_app" / "data" / "procedures" / "hinge.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedSession:
    """Outcome of a session.

    Exit code and output of the operator; number of accepted poses, numbers of wrong ones; longest receive queue (the
    kernel drops frames above 8 MB); foreign frames sent in `took_s`; pauses of the machine.
    """

    code: int
    output: str
    poses: int
    wrong: tuple[int, ...]
    backlog_bytes: int
    foreign: int
    took_s: float
    rhythm: SyncRecord
    pauses: MachinePauses

    def pauses_in_intervals_s(self) -> list[float]:
        """Pauses of the machine (s) in each interval between two SYNCs; 0 if unknown."""
        if not self.pauses.known:
            return [0.0] * max(len(self.rhythm.at_s) - 1, 0)
        gaps = zip(self.rhythm.at_s, self.rhythm.gaps_s(), strict=False)
        return [self.pauses.within_s(begin, begin + gap) for begin, gap in gaps]

    def machine_pause_message(self) -> str:
        """The pause of the machine that tripped the drives, as a message; "" if there was none."""
        if self.code != 3 or not self.pauses.known or not self.rhythm.at_s:
            return ""
        if not re.search(r"joint \d tripped: [^.]*\(8130h\)", " ".join(self.output.split())):
            return ""
        end = self.rhythm.at_s[-1]
        longest_s = self.pauses.longest_s(end - END_S, end)
        return (
            f"the machine itself stood still for {longest_s:.2f} s before the drives tripped"
            if longest_s > DRIVES_TRIP_S
            else ""
        )


def run_session_under_load(
    folder: Path,
    channel: str,
    *,
    poses: int,
    samples: int,
    rate: float,
    busy: int = 0,
    patience_s: float = 1200.0,
) -> LoadedSession:
    """Run a session while other nodes send `rate` frames a second and `busy` processes compute."""
    text = PROCEDURE.read_text(encoding="utf-8")
    for old, new in (("poses: 40", f"poses: {poses}"), ("pose: 32", f"pose: {samples}")):
        if old not in text:
            raise ValueError(f"{PROCEDURE} has no {old!r}")
        text = text.replace(old, new)
    (folder / "load.yaml").write_text(text, encoding="utf-8")
    bus = ("-i", "loopback", "-c", channel, "--scenario", "exact")
    with (
        controller(folder, *bus) as (_, first_line),
        machine_pauses() as pauses,
        loaded_bus(channel, rate=rate, busy=busy) as load,
        (folder / "output.txt").open("wb") as output,
    ):
        if channel not in first_line:
            raise RuntimeError("the controller did not start")
        start_s, foreign = time.monotonic(), load.sent.value
        operator = subprocess.Popen(
            [*SARCAL, "run", str(folder / "load.yaml"), *bus],
            cwd=folder, env=environment(), stdout=output, stderr=subprocess.STDOUT,
        )  # fmt: skip
        backlog = 0
        while operator.poll() is None:
            backlog = max(backlog, backlog_bytes(channel))
            with suppress(subprocess.TimeoutExpired):
                operator.wait(0.1)
            if time.monotonic() - start_s > patience_s:
                operator.kill()
        took_s, foreign = time.monotonic() - start_s, load.sent.value - foreign
    if load.rhythm is None:
        raise RuntimeError("the recorder of the bus did not report")
    pose_data = [
        pose
        for journal in (folder / "sessions").glob("*/journal.jsonl")
        for pose in event_data(journal.parent, "pose")
    ]
    errors = {p["number"]: loop_error(np.array(p["mean_rad"])) for p in pose_data}
    return LoadedSession(
        code=operator.returncode,
        output=(folder / "output.txt").read_text("utf-8", "replace"),
        poses=len(pose_data),
        wrong=tuple(number for number, error in errors.items() if error > MAX_CLOSURE_ERROR),
        backlog_bytes=backlog,
        foreign=foreign,
        took_s=took_s,
        rhythm=load.rhythm,
        pauses=pauses,
    )
