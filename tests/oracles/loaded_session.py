"""`sarcal run` with `sarcal controller` on a loopback bus under load, observed from outside."""

import re
import subprocess
import time
from contextlib import suppress
from dataclasses import dataclass
from itertools import pairwise
from pathlib import Path

import numpy as np

from tests.oracles.bus_load import backlog_bytes, loaded_bus
from tests.oracles.fault_session import MAX_CLOSURE_ERROR, loop_error
from tests.oracles.journal_events import event_data
from tests.oracles.own_process import ROOT, SARCAL, controller, environment

DRIVES_TRIP_S = 0.25
"""Pause of one processor after which drives on another one, with its queue, miss the heartbeat for 0.5 s."""
END_S = 2.0
"""Longest time between a pause and the last SYNC of a session that it ended."""
TRIPPED = r"joint \d tripped: [^.]*\(8130h\)"
PROCEDURE = ROOT / "operator_app" / "data" / "procedures" / "hinge.yaml"


@dataclass(frozen=True, slots=True, kw_only=True)
class LoadedSession:
    """Outcome of a session.

    Exit code and output of the operator; number of accepted poses, numbers of wrong ones; longest receive queue (the
    kernel drops frames above 8 MB); foreign frames a second and the duration; intervals between SYNCs, with and without
    pauses of the machine (equal where these are not known); the pause that tripped the drives, or 0.
    """

    code: int
    output: str
    poses: int
    wrong: tuple[int, ...]
    backlog_bytes: int
    foreign_per_s: float
    took_s: float
    gaps_s: np.ndarray
    own_gaps_s: np.ndarray
    pauses_known: bool
    tripped_by_pause_s: float


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
    if not load.syncs_s:
        raise RuntimeError("the recorder of the bus did not report")
    gaps = list(pairwise(load.syncs_s))
    text = (folder / "output.txt").read_text("utf-8", "replace")
    pause_s, end = 0.0, load.syncs_s[-1]
    if operator.returncode == 3 and re.search(TRIPPED, " ".join(text.split())):
        pause_s = load.longest_pause_s(end - END_S, end)
    pose_data = [
        pose
        for journal in (folder / "sessions").glob("*/journal.jsonl")
        for pose in event_data(journal.parent, "pose")
    ]
    errors = {p["number"]: loop_error(np.array(p["mean_rad"])) for p in pose_data}
    return LoadedSession(
        code=operator.returncode,
        output=text,
        poses=len(pose_data),
        wrong=tuple(number for number, error in errors.items() if error > MAX_CLOSURE_ERROR),
        backlog_bytes=backlog,
        foreign_per_s=foreign / took_s,
        took_s=took_s,
        gaps_s=np.array([b - a for a, b in gaps]),
        own_gaps_s=np.array([b - a - load.paused_s(a, b) for a, b in gaps]),
        pauses_known=load.known,
        tripped_by_pause_s=pause_s if pause_s > DRIVES_TRIP_S else 0.0,
    )
