"""The packaged procedures as programs of their own in real time, each twice in a row on one controller, verified."""

import os
import signal
from collections.abc import Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from pathlib import Path

import pytest

from tests.oracles.own_process import controller, finished, start

POSES = {"hinge": 15, "hinge_planned": 4, "rigid": 24, "ball": 24, "open_loop": 12}
"""As few as are accepted."""
ACCEPTED = {"accepted", "accepted_with_warnings", "holds", "agrees"}
PATIENCE_S = 900.0


@contextmanager
def controller_on(folder: Path, procedure: str, channel: str, *more: str) -> Iterator[list[str]]:
    """Run a controller; its bus, and the port of its tracker if it has one, as options."""
    bus = ["-i", "loopback", "-c", channel]
    with controller(folder, "--procedure", procedure, *bus, *more) as (process, line):
        told = line.split()
        tracker = told.index("--tracker") if "--tracker" in told else len(told)
        yield [*bus, *told[tracker : tracker + 2]]
        process.send_signal(signal.SIGINT)
        finished(process, 130)


def accepted(folder: Path, *arguments: str) -> None:
    """Run a command; it is accepted by exit code and by verdict."""
    done = finished(start(folder, *arguments, "--json"), 0, patience_s=PATIENCE_S)
    assert done.json["verdict"] in ACCEPTED


def of(procedure: str, folder: Path) -> None:
    own, sessions = f"five-{os.getpid()}-{procedure}", ("--sessions", procedure)
    port = ("--tracker-port", "0")
    with controller_on(folder, procedure, own, *(port if procedure == "open_loop" else ())) as bus:
        for _ in range(2):
            accepted(folder, "run", procedure, *bus, *sessions, "--poses", str(POSES[procedure]))
        # The session knows its bus.
        accepted(folder, "verify", "latest", *sessions, "--poses", "4")
    if procedure == "hinge":
        with controller_on(folder, "open_loop", f"{own}-open", *port) as bus:
            few = ("--poses", "12")
            accepted(folder, "verify", "latest", "--open-loop", *bus, *sessions, *few)


@pytest.mark.campaign
@pytest.mark.real_time
def test_each_is_accepted_twice_in_a_row_and_verified(tmp_path):
    with ThreadPoolExecutor(len(POSES)) as side:
        list(side.map(lambda procedure: of(procedure, tmp_path), POSES))
