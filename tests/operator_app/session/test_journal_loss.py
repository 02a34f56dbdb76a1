"""A journal that is removed or changed while it is written: nothing is lost, the arm is held, and it is reported."""

import os
import shutil
import threading
from collections.abc import Callable, Mapping
from pathlib import Path

import pytest

from hardware.arm import HostLatency, JointMode
from operator_app.commands.run import run
from operator_app.errors import JournalLostError
from operator_app.session.store.journal import JOURNAL_NAME, Journal, read_journal
from operator_app.session.store.state import SessionState
from operator_app.session.ui.snapshot import Level, TaskKind
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.plant_sessions import RecordingListener, opened, short_procedure

PATIENCE_S = 60.0
EVENTS = (("opened", {"a": 1.25}), ("pose", {"number": 1}))


def lose_folder(path: Path) -> None:
    shutil.rmtree(path.parent)


def replace_file(path: Path) -> None:
    raw = path.read_bytes()
    path.unlink()
    path.write_bytes(raw)


def append_line(path: Path) -> None:
    with path.open("ab") as file:
        file.write(b"{}\n")


LOSSES: Mapping[str, tuple[Callable[[Path], object], str]] = {
    "folder deleted": (lose_folder, "deleted, moved or renamed"),
    "folder renamed": (lambda p: p.parent.rename(p.parent.with_name("x")), "deleted, moved or"),
    "deleted": (Path.unlink, "deleted, moved or renamed"),
    "renamed": (lambda p: p.rename(p.with_name("mine.jsonl")), "deleted, moved or renamed"),
    "truncated": (lambda p: os.truncate(p, 50), "was cut from"),
    "emptied": (lambda p: os.truncate(p, 0), "was cut from"),
    "replaced": (replace_file, "was replaced by another file"),
    "written to": (append_line, "was written to by another program"),
    "a folder instead": (lambda p: (p.unlink(), p.mkdir()), "was replaced"),
}


@pytest.mark.parametrize("kind", LOSSES)
def test_lost_journal_is_rescued_and_accepts_no_more_events(tmp_path, kind):
    folder = tmp_path / "20261122-hinge"
    journal = Journal.create(folder)
    for name, data in EVENTS:
        journal.append(name, data)
    lose, message = LOSSES[kind]
    lose(folder / JOURNAL_NAME)
    with pytest.raises(JournalLostError, match=message) as error:
        journal.append("pose", {"number": 2})
    rescued = tmp_path / "20261122-hinge-rescued"
    assert error.value.rescued == journal.kept_folder == rescued
    assert f"--resume {rescued}" in error.value.remedy
    events = [(e.name, e.data) for e in read_journal(rescued).events]
    assert events == [*EVENTS, ("pose", {"number": 2})]
    for refused in (lambda: journal.append("pose", {"number": 3}), journal.require_intact):
        with pytest.raises(JournalLostError, match=message):
            refused()
    journal.close()
    # It is rescued once only.
    assert len(list(tmp_path.glob("*rescued*"))) == 1
    resumed = Journal.resume(rescued)
    resumed.append("goes on", {})
    resumed.close()


def test_loss_of_the_parent_is_detected_without_writing(tmp_path, monkeypatch):
    """The arm moves only while the journal is intact. The rescue goes to the temporary folder."""
    temporary = tmp_path / "tmp"
    temporary.mkdir()
    monkeypatch.setattr("tempfile.tempdir", str(temporary))
    journal = Journal.create(tmp_path / "sessions" / "one")
    journal.append("opened", {})
    journal.require_intact()
    shutil.rmtree(tmp_path / "sessions")
    (tmp_path / "sessions").write_text("a file where the sessions were")
    with pytest.raises(JournalLostError, match="All entries are in"):
        journal.require_intact()
    journal.close()
    assert journal.kept_folder == temporary / "one-rescued"
    assert [e.name for e in read_journal(journal.kept_folder).events] == ["opened"]


def flip_bit(path: Path, line: int = 1) -> None:
    raw = path.read_bytes()
    position = sum(map(len, raw.splitlines(keepends=True)[: line - 1])) + 50
    with path.open("r+b") as file:
        file.seek(position)
        file.write(bytes([raw[position] ^ 1]))


@pytest.mark.parametrize("line", [1, 2, 3, 4])
@pytest.mark.parametrize("resumed", [False, True])
def test_flipped_bit_is_detected_when_read_back(tmp_path, line, resumed):
    folder = tmp_path / "session"
    journal = Journal.create(folder)
    for number in range(1, 4):
        journal.append("pose", {"number": number, "note": "x" * 40})
    if resumed:
        journal.close()
        journal = Journal.resume(folder)
    journal.append("solved", {"accepted": True, "note": "y" * 40})
    journal.require_intact(unchanged=True)
    flip_bit(folder / JOURNAL_NAME, line)
    with pytest.raises(JournalLostError, match=f"was changed in line {line} while") as error:
        journal.require_intact(unchanged=True)
    journal.close()
    rescued = error.value.rescued
    assert rescued is not None
    assert [e.name for e in read_journal(rescued).events] == [*["pose"] * 3, "solved"]


@pytest.mark.parametrize(
    ("lose", "late_times", "last"),
    [(lose_folder, 0, "closed"), (lose_folder, 1, "late"), (flip_bit, 0, "closed")],
)
def test_loss_is_detected_when_the_session_is_closed(make_session, lose, late_times, last):
    session = make_session(short_procedure(8), connect=True)
    session.arm.lateness = HostLatency(times=late_times, last_s=0.4, longest_s=0.4)
    lose(session.journal.path)
    session.close("done")
    assert session.held
    assert session.journal.loss is not None
    assert read_journal(session.journal.kept_folder).events[-1].name == last


def is_held(session: Session) -> bool:
    return all(joint.mode is JointMode.POSITION for joint in session.arm.snapshot().joints)


def close_and_resume(session: Session, error: JournalLostError) -> SessionState:
    """Close the session and return the state of the rescued one."""
    session.close("failed")
    assert error.rescued is not None
    resumed = opened(error.rescued, session.arm, session.procedure, resumed=True)
    resumed.close("end of the test")
    return resumed.state


def test_deleted_folder_holds_the_arm_and_keeps_the_written_poses(make_session):
    session = make_session(short_procedure(40, "datasheet"), "datasheet")
    folder = session.journal.path.parent
    with pytest.raises(JournalLostError, match="deleted") as error:
        run(session, RecordingListener(lambda count: count == 3 and shutil.rmtree(folder)))
    assert is_held(session)
    # A pose that was not written does not count.
    assert len(session.state.used_poses) == 3
    assert len(close_and_resume(session, error.value).used_poses) == 3
    assert not session.journal.path.exists()


class JournalChanger(Listener):
    """Changes one digit of the journal in place: after the last pose, or after the solution."""

    def __init__(self, session: Session, after: str) -> None:
        self._session, self._path, self._after = session, session.journal.path, after
        self.solutions = 0

    def pose_captured(self, state: SessionState, total: int) -> None:
        if self._after == "poses" and len(state.used_poses) == total:
            self._change()

    def report(self, text: str) -> None:
        if self._session.state.solved:
            self.solutions += 1
            if self._after == "solution":
                self._change()

    def _change(self) -> None:
        raw = self._path.read_bytes()
        k = raw.index(b'"mean_rad":[') + len(b'"mean_rad":[-0.')
        with self._path.open("r+b") as file:
            file.seek(k)
            file.write(b"1" if raw[k : k + 1] != b"1" else b"2")


@pytest.mark.sample(1)
@pytest.mark.parametrize("after", ["poses", "solution"])
def test_changed_journal_prevents_solution_and_upload(make_session, after):
    session = make_session(short_procedure(8))
    before = session.arm.active_parameters()
    listener = JournalChanger(session, after)
    with pytest.raises(JournalLostError, match="was changed in line") as error:
        run(session, listener, forced="a test of the journal")
    assert listener.solutions == (after == "solution")
    assert session.arm.active_parameters() == before
    assert not (session.journal.path.parent / "parameters.yaml").exists()
    assert is_held(session)
    assert len(close_and_resume(session, error.value).used_poses) == 8


def test_app_raises_an_alarm_and_holds_the_arm(source):
    runner = source.new()
    folder = runner.session.journal.path.parent
    runner.operations.connect()
    runner.operations.set_modes((1, 5))
    runner.operations.capture(0)
    shutil.rmtree(folder)
    done = threading.Event()
    runner.submit(TaskKind.CAPTURE, "capturing", lambda: runner.operations.capture(1))
    runner.submit(TaskKind.NOTE, "the last", done.set)
    assert done.wait(PATIENCE_S)
    snapshot = runner.snapshot()
    assert len(snapshot.state.poses) == 1
    (alarm,) = [m.text for m in snapshot.messages if m.level is Level.ALARM]
    rescued = folder.with_name(f"{folder.name}-rescued")
    assert "was deleted, moved or renamed" in alarm
    assert str(rescued) in alarm
    assert is_held(runner.session)
    assert runner.defect is None
    source.close("left")
    assert source.last == rescued
    assert source.lost is not None
