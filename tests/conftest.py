"""Fixtures and markers of all tests: optional programs, reference data, approved messages, sampled parameters."""

import fcntl
import gc
import itertools
import json
import os
import shutil
import signal
import sys
import tempfile
from collections.abc import Generator
from pathlib import Path

import hypothesis
import pytest

REPOSITORY = Path(__file__).resolve().parents[1]
DATA = REPOSITORY / "tests" / "data"
APPROVED = DATA.with_name("approved_words.json")

PROGRAMS = {
    "candump": "Debian package can-utils",
    "cansend": "Debian package can-utils",
    "dcfchk": "extra 'test'",
    "ip": "Debian package iproute2",
    "linux.uml": "Debian package user-mode-linux",
    "node": "Debian package nodejs",
    "tmux": "Debian package tmux",
    "tshark": "Debian package tshark",
}
"""Optional programs and their sources."""

SEARCH_PATH = os.pathsep.join(
    [str(Path(sys.executable).parent), os.environ.get("PATH", os.defpath), "/usr/sbin", "/sbin"]
)

# A shell starts a program with `&` so that it ignores Ctrl-C; programs started by tests would inherit that.
if signal.getsignal(signal.SIGINT) is signal.SIG_IGN:
    signal.signal(signal.SIGINT, signal.default_int_handler)

# One linear algebra thread per process, as in `sarcal`. numpy reads it once, when it is imported.
for _library in ("OPENBLAS", "OMP", "MKL"):
    os.environ.setdefault(f"{_library}_NUM_THREADS", "1")

# The tests do not read the settings of the user who runs them.
os.environ["XDG_CONFIG_HOME"] = f"{tempfile.gettempdir()}/sarcal-no-settings-{os.getpid()}"

# Tests take 14 s to compile: byte code is written for them and the programs that they start.
os.environ.pop("PYTHONDONTWRITEBYTECODE", None)
sys.dont_write_bytecode = False

# No time limit for an example. Under CI, hypothesis has a profile of its own.
if "CI" not in os.environ:
    hypothesis.settings.register_profile("local", deadline=None)
    hypothesis.settings.load_profile("local")


def pytest_addoption(parser: pytest.Parser) -> None:
    parser.addoption(
        "--approve",
        action="store_true",
        help="write the present messages to tests/approved_words.json",
    )


@pytest.fixture
def approve(request, tmp_path):
    """Compare messages with those in tests/approved_words.json, by the test's name and number of the call.

    The test's temporary folder is written as `$TMP`; line breaks are ignored.
    """
    name = request.node.nodeid.removeprefix("tests/")
    write, calls = request.config.getoption("--approve"), itertools.count(1)

    def compare(text: str) -> None:
        text = " ".join(text.replace(str(tmp_path), "$TMP").split())
        call = next(calls)
        key = name if call == 1 else f"{name} #{call}"
        with APPROVED.open("r+" if write else "r", encoding="utf-8") as file:
            fcntl.flock(file, fcntl.LOCK_EX if write else fcntl.LOCK_SH)
            approved: dict[str, str] = json.load(file)
            if write and approved.get(key) != text:
                approved[key] = text
                file.seek(0)
                file.truncate()
                json.dump(approved, file, indent=1, sort_keys=True, ensure_ascii=False)
                file.write("\n")
        assert text == approved.get(key), "not as approved: run pytest --approve, and check"

    return compare


def pytest_configure(config: pytest.Config) -> None:
    config.addinivalue_line(
        "markers",
        f"needs(*programs): skips without them and names their packages; known: {sorted(PROGRAMS)}",
    )


@pytest.hookimpl(tryfirst=True)
def pytest_collection_modifyitems(items: list[pytest.Item]) -> None:
    """Put real-time tests first."""
    _mark_unsampled_as_campaign(items)
    # The first worker then has all of them, and no other worker waits.
    items.sort(key=lambda item: item.get_closest_marker("real_time") is None)


def pytest_collection_finish() -> None:
    """Exclude the loaded modules of all tests from garbage collection."""
    gc.freeze()


def _mark_unsampled_as_campaign(items: list[pytest.Item]) -> None:
    """Leave evenly spaced parameters of a sampled test in the default run."""
    sampled: dict[tuple[Path, str], list[pytest.Item]] = {}
    for item in items:
        if item.get_closest_marker("sample") and not item.get_closest_marker("campaign"):
            assert isinstance(item, pytest.Function)
            sampled.setdefault((item.path, item.originalname), []).append(item)
    for cases in sampled.values():
        marker = cases[0].get_closest_marker("sample")
        assert marker is not None
        count = min(marker.args[0], len(cases))
        default_run = {k * len(cases) // count for k in range(count)}
        for k, item in enumerate(cases):
            if k not in default_run:
                item.add_marker("campaign")


@pytest.hookimpl(wrapper=True, tryfirst=True)
def pytest_runtest_protocol(item: pytest.Item) -> Generator[None, object, object]:
    """Run one real-time test at a time on this machine; its timeout does not include the wait."""
    if item.get_closest_marker("real_time") is None:
        return (yield)
    with Path(tempfile.gettempdir(), f"sarcal-real-time-{os.getuid()}").open("w") as lock:
        fcntl.flock(lock, fcntl.LOCK_EX)
        return (yield)


def pytest_runtest_setup(item: pytest.Item) -> None:
    for marker in item.iter_markers("needs"):
        for program in marker.args:
            if shutil.which(program, path=SEARCH_PATH) is None:
                pytest.skip(f"needs {program} ({PROGRAMS[program]})")


@pytest.fixture(scope="session")
def reference_data():
    """Folder of the reference data sets."""
    return DATA
