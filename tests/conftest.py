"""What all tests may ask for: programs that a machine may lack, and reference data. Knows nothing of sarcal."""

import fcntl
import gc
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path

import hypothesis
import pytest

from tests.oracles.approved import Approve

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = REPOSITORY / "tests" / "data"

# Program: where it comes from.
PROGRAMS = {
    "busybox": "Debian package busybox-static",
    "candump": "Debian package can-utils",
    "cansend": "Debian package can-utils",
    "dcfchk": "extra 'test'",
    "ip": "Debian package iproute2",
    "linux.uml": "Debian package user-mode-linux",
    "node": "Debian package nodejs",
    "qemu-system-x86_64": "Debian package qemu-system-x86",
    "tmux": "Debian package tmux",
    "tshark": "Debian package tshark",
}
SEARCH_PATH = os.pathsep.join(
    [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"]
)

# A shell that starts a program with `&` has it ignore Ctrl-C, and so would every program that a test starts.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# One linear algebra thread each, as `sarcal` itself does it: on matrices this small more of them wait for
# each other. Must come before numpy is imported, which reads it once.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

# Whoever runs the tests may have settings of their own; they are not the tests'.
os.environ["XDG_CONFIG_HOME"] = f"{tempfile.gettempdir()}/sarcal-no-settings-{os.getpid()}"

# Tests, which take 14 s to compile, and the programs that they start compile themselves once.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# How long an example takes is the machine's affair. Under CI, hypothesis has a profile of its own.
if "CI" not in os.environ:
    hypothesis.settings.register_profile("local", deadline=None)
    hypothesis.settings.load_profile("local")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--approve",
        action="store_true",
        help="write tests/approved_words.json anew: what is said now",
    )


@pytest.fixture
def approve(request, tmp_path):
    """Hold the product's words to those in tests/approved_words.json."""
    name = request.node.nodeid.removeprefix("tests/")
    return Approve(name, folder=tmp_path, write=request.config.getoption("--approve"))


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        f"needs(*programs): skips without them, saying what to install; knows {sorted(PROGRAMS)}",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put what must run alone first, and give a campaign the patience a busy machine needs."""
    _put_into_the_campaign_what_is_no_sample(items)
    for item in items:
        if item.get_closest_marker("campaign") and not item.get_closest_marker("timeout"):
            item.add_marker(pytest.mark.timeout(1200))
    # The first worker has them all then, and no other one waits for its turn.
    items.sort(key=lambda item: item.get_closest_marker("real_time") is None)


def pytest_collection_finish() -> None:
    """Spare the garbage collector what 5,000 tests and their modules have loaded: it is there to stay."""
    gc.freeze()


def _put_into_the_campaign_what_is_no_sample(items: list[pytest.Item]) -> None:
    """Leave evenly spaced ones of a test's parameters to the default run."""
    sampled: dict[tuple[Path, str], list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sample") and not item.get_closest_marker("campaign"):
            assert isinstance(item, pytest.Function)
            sampled.setdefault((item.path, item.originalname), []).append(item)
    for found in sampled.values():
        marker = found[0].get_closest_marker("sample")
        assert marker is not None
        count = min(marker.args[0], len(found))
        kept = {k * len(found) // count for k in range(count)}
        for k, item in enumerate(found):
            if k not in kept:
                item.add_marker("campaign")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run one test in real time at a time on this machine; to wait for its turn is not part of its time."""
    if item.get_closest_marker("real_time") is None:
        return (yield)
    with Path(tempfile.gettempdir(), f"sarcal-real-time-{os.getuid()}").open("w") as turn:
        fcntl.flock(turn, fcntl.LOCK_EX)
        return (yield)


def pytest_runtest_setup(item: pytest.Item) -> None:
    for marker in item.iter_markers("needs"):
        for program in marker.args:
            origin = PROGRAMS[program]
            if shutil.which(program, path=SEARCH_PATH) is None:
                pytest.skip(f"needs {program} ({origin})")


@pytest.fixture(scope="session")
def reference_data():
    """Folder of the reference data sets."""
    return DATA
