"""A session folder that is taken away in mid-capture: the arm is held, the faces say so, nothing is lost."""

import shutil
import threading
from pathlib import Path

import pytest

from hardware.arm import JointMode
from operator_app.calibration.result import Solution
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import JournalLostError
from operator_app.headless.console import ConsoleListener
from operator_app.headless.procedure_run import run
from operator_app.session.store.folders import find_session
from operator_app.session.store.journal import read_journal
from operator_app.session.store.state import SessionState
from operator_app.session.ui.snapshot import Level, TaskKind
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.hearing import Hearing
from tests.oracles.live_source import FakeSource
from tests.oracles.opened import opened
from tests.oracles.short_procedure import short_procedure

PATIENCE_S = 60.0


def held(session: Session) -> bool:
    return all(joint.mode is JointMode.POSITION for joint in session.arm.snapshot().joints)


def test_the_arm_is_held_and_the_rescued_session_goes_on(make_session):
    session = make_session(load_procedure("hinge"), "datasheet")
    folder = session.journal.path.parent
    with pytest.raises(JournalLostError, match="deleted") as lost:
        run(session, Hearing(lambda count: count == 3 and shutil.rmtree(folder)))
    assert held(session)
    # What was not written does not count.
    assert len(session.state.used_poses) == 3
    session.close("failed")
    assert not session.journal.path.exists()
    rescued = lost.value.rescued
    assert rescued is not None
    assert sum(e.name == "pose" for e in read_journal(rescued).events) == 3
    again = opened(rescued, session.arm, session.procedure, resumed=True)
    assert len(again.state.used_poses) == 3
    again.close("end of the test")


def one_bit(path: Path) -> None:
    raw = path.read_bytes()
    path.write_bytes(raw[:40] + bytes([raw[40] ^ 1]) + raw[41:])


@pytest.mark.parametrize(
    "harm", [lambda path: shutil.rmtree(path.parent), one_bit], ids=["gone", "changed"]
)
def test_what_became_of_a_journal_is_noticed_as_it_is_closed(make_session, harm):
    session = make_session(short_procedure(8), connect=True)
    harm(session.journal.path)
    session.close("done")
    assert session.journal.loss is not None
    assert read_journal(session.journal.kept_folder).events[-1].name == "closed"


class Overwriter(Listener):
    """Changes one digit of the journal in place: after the poses, or after the verdict."""

    def __init__(self, session: Session, when: str) -> None:
        self._path, self._when = session.journal.path, when
        self.solutions = 0

    def pose_captured(self, state: SessionState, total: int) -> None:
        if self._when == "pose" and len(state.used_poses) == total:
            self._overwrite()

    def solved(self, solution: Solution) -> None:
        self.solutions += 1
        if self._when == "verdict":
            self._overwrite()

    def _overwrite(self) -> None:
        raw = self._path.read_bytes()
        here = raw.index(b'"mean_rad":[') + len(b'"mean_rad":[-0.')
        with self._path.open("r+b") as file:
            file.seek(here)
            file.write(b"1" if raw[here : here + 1] != b"1" else b"2")


@pytest.mark.sample(1)
@pytest.mark.parametrize("when", ["pose", "verdict"])
def test_a_changed_journal_gets_no_verdict_and_no_upload(make_session, when):
    procedure = short_procedure(8)
    session = make_session(procedure)
    before = session.arm.active_parameters()
    listener = Overwriter(session, when)
    with pytest.raises(JournalLostError, match="was changed in line") as lost:
        run(session, listener, forced="a test of the journal")
    assert listener.solutions == (when == "verdict")
    assert session.arm.active_parameters() == before
    assert not (session.journal.path.parent / "parameters.yaml").exists()
    assert held(session)
    session.close("failed")
    rescued = lost.value.rescued
    assert rescued is not None
    again = opened(rescued, session.arm, procedure, resumed=True)
    assert len(again.state.used_poses) == 8
    again.close("end of the test")


@pytest.mark.campaign
def test_run_says_what_happened_and_where_everything_is(tmp_path, ends_with, monkeypatch):
    root = tmp_path / "sessions"
    before = ConsoleListener.pose_captured

    def taken_away(self: ConsoleListener, state: SessionState, wanted: int) -> None:
        before(self, state, wanted)
        if len(state.used_poses) == 3:
            (folder,) = root.iterdir()
            folder.rename(tmp_path / "elsewhere")

    monkeypatch.setattr(ConsoleListener, "pose_captured", taken_away)
    words = ["run", "hinge", "--scenario", "exact", "--poses", "8", "--sessions", str(root)]
    said = ends_with(2, *words).err
    (rescued,) = root.glob("*-rescued")
    assert "the arm is held" in said
    assert f"--resume {rescued}" in said
    assert "Traceback" not in said
    monkeypatch.setattr(ConsoleListener, "pose_captured", before)
    assert find_session(root, "latest") == rescued
    ends_with(0, "run", "--resume", rescued, "--poses", "8", "--sessions", root)


def test_the_app_and_plain_mode_say_it_hold_and_leave_in_order(tmp_path):
    source = FakeSource(tmp_path / "sessions")
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
    s = runner.snapshot()
    assert len(s.state.poses) == 1
    (alarm,) = [m.text for m in s.messages if m.level is Level.ALARM]
    rescued = folder.with_name(f"{folder.name}-rescued")
    assert "was deleted, moved or renamed" in alarm
    assert str(rescued) in alarm
    assert held(runner.session)
    assert runner.defect is None
    source.close("left")
    assert source.last == rescued
    assert source.lost is not None
