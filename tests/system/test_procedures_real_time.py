"""The packaged procedures as programs in real time, each twice in a row on one controller, then verified."""

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


@contextmanager
def controller_on(folder: Path, procedure: str, channel: str) -> Iterator[list[str]]:
    """Run a controller and return the options of its bus and, for an open loop, of its tracker."""
    bus = ["-i", "loopback", "-c", channel]
    port = ["--tracker-port", "0"] if procedure == "open_loop" else []
    with controller(folder, "--procedure", procedure, *bus, *port) as (process, first_line):
        words = first_line.split()
        tracker = words.index("--tracker") if "--tracker" in words else len(words)
        yield [*bus, *words[tracker : tracker + 2]]
        process.send_signal(signal.SIGINT)
        finished(process, 130)


def assert_accepted(folder: Path, *arguments: str) -> None:
    answer = finished(start(folder, *arguments, "--json"), 0, patience_s=900.0)
    assert answer.json["verdict"] in {"accepted", "accepted_with_warnings", "holds", "agrees"}


def calibrate_twice_and_verify(procedure: str, folder: Path) -> None:
    channel, sessions = f"five-{os.getpid()}-{procedure}", ("--sessions", procedure)
    with controller_on(folder, procedure, channel) as bus:
        for _ in range(2):
            poses = str(POSES[procedure])
            assert_accepted(folder, "run", procedure, *bus, *sessions, "--poses", poses)
        # No bus options: the journal has them.
        assert_accepted(folder, "verify", "latest", *sessions, "--poses", "4")
    if procedure == "hinge":
        with controller_on(folder, "open_loop", f"{channel}-open") as bus:
            options = ("--open-loop", *bus, *sessions, "--poses", "12")
            assert_accepted(folder, "verify", "latest", *options)


@pytest.mark.campaign
@pytest.mark.real_time
def test_procedures_are_accepted_twice_in_a_row_and_verified(tmp_path):
    with ThreadPoolExecutor(len(POSES)) as pool:
        list(pool.map(lambda procedure: calibrate_twice_and_verify(procedure, tmp_path), POSES))
