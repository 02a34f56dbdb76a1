"""A recording of the bus that a full disk ended: the arm goes on, and the operator is told."""

import resource
import threading
import time
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from functools import partial

import pytest

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.session.ui.sessions import Sessions
from operator_app.session.ui.snapshot import Level, TaskKind
from operator_app.session.workflow.opening import Choices, Opening, Rig, begin, open_session


@contextmanager
def files_end_after(size_bytes: int) -> Iterator[None]:
    before = resource.getrlimit(resource.RLIMIT_FSIZE)
    resource.setrlimit(resource.RLIMIT_FSIZE, (size_bytes, before[1]))
    try:
        yield
    finally:
        resource.setrlimit(resource.RLIMIT_FSIZE, before)


@pytest.mark.parametrize(("room_bytes", "told"), [(4096, True), (1 << 26, False)])
def test_a_recording_that_ended_early_is_told_when_the_arm_is_closed(
    tmp_path, capsys, room_bytes, told
):
    record_to = tmp_path / "bus.log"
    opening = begin("hinge", Choices(interface="virtual"), root=tmp_path)
    with files_end_after(room_bytes), open_arm(opening, record_to=record_to) as rig:
        assert rig.arm.connect().serial_number
    said = capsys.readouterr().err
    assert (f"{record_to}, ends early: " in said) is told
    assert ("Free some space" in said) is told


def until(holds: Callable[[], object], seconds: float = 10.0) -> None:
    end = time.monotonic() + seconds
    while not holds():
        assert time.monotonic() < end
        threading.Event().wait(0.01)


def test_the_app_says_on_its_screen_that_a_recording_ended(tmp_path, capsys):
    record_to = tmp_path / "bus.log"
    join = partial(open_arm, pace=Pace.REAL_TIME, speed=10.0, record_to=record_to)
    choices = Choices(interface="virtual")
    source = Sessions("hinge", choices, root=tmp_path / "sessions", join=join)
    runner = source.new()

    def told() -> list[tuple[Level, str]]:
        messages = runner.snapshot().messages
        return [(m.level, m.text) for m in messages if "ends early" in m.text]

    # Beside it the journal still has room.
    with files_end_after(100_000):
        runner.submit(TaskKind.CONNECT, "connecting", runner.operations.connect)
        until(told)
        until(lambda: runner.snapshot().task is None)
        assert runner.snapshot().connected
        source.close("end of the test")
    ((level, text),) = told()
    assert level is Level.WARNING
    assert text.startswith(f"The recording of the bus, {record_to}, ends early: ")
    assert text.endswith("Free some space, or record to another disk")
    assert "ends early" in capsys.readouterr().err


def test_sessions_begun_in_one_second_record_into_a_folder_each(tmp_path):
    """Both have chosen the same name before either has a folder."""
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


def test_what_could_not_be_written_at_the_end_of_a_session_is_said_in_the_next(tmp_path):
    """A .blf is written in pieces, and the last one when the bus is closed."""
    fate = [""]

    @contextmanager
    def join(opening: Opening) -> Iterator[Rig]:
        with open_arm(opening) as rig:
            yield replace(rig, recording_ended=lambda: fate[0])

    source = Sessions("hinge", Choices(interface="virtual"), root=tmp_path, join=join)
    first = source.new()
    close = first.close

    def close_on_a_full_disk(reason: str) -> None:
        close(reason)
        fate[0] = "the recording ends early"

    first.close = close_on_a_full_disk
    second = source.new()
    assert "The recording ends early" in [m.text for m in second.snapshot().messages]
    fate[0] = ""
    source.close("end of the test")
