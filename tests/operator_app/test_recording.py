"""Recordings of the bus: on a full disk the session continues and the operator is warned."""

import resource
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import can
import pytest

from hardware.timing import Pace
from operator_app.cli import main
from operator_app.composition import open_arm
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.snapshot import Level, TaskKind
from operator_app.session.workflow.opening import Choices, Opening, Rig, begin, open_session


@contextmanager
def file_size_limit(size_bytes: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(("limit_bytes", "reported"), [(4096, True), (1 << 26, False)])
def test_incomplete_recording_is_reported_when_the_arm_is_closed(
    tmp_path, capsys, limit_bytes, reported
):
    record_to = tmp_path / "bus.log"
    opening = begin("hinge", Choices(interface="virtual"), root=tmp_path)
    with file_size_limit(limit_bytes), open_arm(opening, record_to=record_to) as rig:
        assert rig.arm.connect().serial_number
    messages = capsys.readouterr().err
    assert (f"{record_to}, ends early: " in messages) is reported
    assert ("Free some space" in messages) is reported


@pytest.mark.parametrize("words", [("monitor", "--seconds", "0.1"), ("probe",)])
def test_monitor_and_probe_report_an_incomplete_recording(tmp_path, capsys, monkeypatch, words):
    bus, other = (can.Bus(tmp_path, interface="virtual") for _ in range(2))
    other.send_periodic(can.Message(arbitration_id=0x80), 0.002)
    monkeypatch.setattr(f"operator_app.commands.{words[0]}.open_bus", lambda _: bus)
    monkeypatch.setattr("sys.dont_write_bytecode", True)  # such files would be cut too
    with file_size_limit(100):
        main([*words, "-i", "loopback", "--record", str(tmp_path / "bus.log")])
    assert "bus.log, ends early" in capsys.readouterr().err


def wait_until(condition: Callable[[], object]) -> None:
    end = time.monotonic() + 120.0
    while not condition():
        assert time.monotonic() < end
        threading.Event().wait(0.01)


def test_app_warns_of_an_incomplete_recording(tmp_path, capsys):
    record_to = tmp_path / "bus.log"
    join = partial(open_arm, pace=Pace.REAL_TIME, speed=10.0, record_to=record_to)
    choices = Choices(interface="virtual")
    source = Sessions("hinge", choices, root=tmp_path / "sessions", join=join)
    runner = source.new()

    def recording_messages() -> list[tuple[Level, str]]:
        messages = runner.snapshot().messages
        return [(m.level, m.text) for m in messages if "ends early" in m.text]

    # The journal stays below this limit.
    with file_size_limit(100_000):
        runner.submit(TaskKind.CONNECT, "connecting", runner.operations.connect)
        wait_until(lambda: recording_messages() and runner.snapshot().task is None)
        assert runner.snapshot().connected
        source.close("end of the test")
    ((level, text),) = recording_messages()
    assert level is Level.WARNING
    assert text.startswith(f"The recording of the bus, {record_to}, ends early: ")
    assert text.endswith("Free some space, or record to another disk")
    assert "ends early" in capsys.readouterr().err


def test_sessions_started_in_one_second_have_separate_recordings(tmp_path):
    """Both choose the same folder name before it exists."""
    opening = begin("hinge", Choices(interface="virtual"), root=tmp_path)
    for _ in range(2):
        with open_arm(opening, record_to=opening.folder / "bus.blf") as rig:
            session = open_session(rig)
            assert session.connect().serial_number
            session.close("end of the test")
    assert session.journal.path.parent != opening.folder
    folders = [opening.folder, opening.folder.with_name(f"{opening.folder.name}-2")]
    assert sorted(tmp_path.rglob("*.*")) == [
        folder / name for folder in folders for name in ("bus.blf", "journal.jsonl")
    ]


def test_error_at_session_end_is_reported_in_the_next_session(tmp_path):
    """The last part of a .blf file is written when the bus is closed."""
    recording_error = [""]

    @contextmanager
    def join(opening: Opening) -> Iterator[Rig]:
        with open_arm(opening) as rig:
            yield replace(rig, recording_ended=lambda: recording_error[0])

    source = Sessions("hinge", Choices(interface="virtual"), root=tmp_path, join=join)
    first = source.new()
    close = first.close

    def close_on_a_full_disk(reason: str) -> None:
        close(reason)
        recording_error[0] = "the recording ends early"

    first.close = close_on_a_full_disk
    second = source.new()
    assert "The recording ends early" in [m.text for m in second.snapshot().messages]
    recording_error[0] = ""
    source.close("end of the test")
