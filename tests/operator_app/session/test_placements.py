"""Several placements of a fixture in one session: what the journal keeps of each, and what the operator confirms."""

import io
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hardware.control.canopen_arm import CanopenArm
from operator_app.commands.run import next_placement, remounting_lines, require_mounted
from operator_app.errors import DrivesNotOffError, GuardError, SessionError
from operator_app.exit_codes import exit_code
from operator_app.headless.console import ConsoleListener
from operator_app.session.store.journal import JOURNAL_NAME, read_journal
from operator_app.session.store.replay import replay, session_state
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.opening import Choices, Opening, begin, resume
from operator_app.session.workflow.remounting import next_due
from operator_app.session.workflow.session import Session
from tests.oracles.journals import POSE, Named, journal_event, sources, write_journal, written

Q = [0.1, -0.2, 0.3, 1.4, -0.5, 0.6, 0.7]
SETTINGS = {"poses": 12, "placements": 2, "interface": "loopback", "channel": "bench"}
READING = {"mean_rad": Q, "sd_rad": [0.0] * 7, "samples": 8}
REMOUNTED = ("remounted", {"placement": 2})


def first_placement(poses: int = 12) -> list[Named]:
    return [
        ("opened", {"sources": sources(), "settings": SETTINGS}),
        ("control", {"start_rad": Q, "home_rad": Q}),
        ("modes", {"modes": ["position"] * 7}),
        *(("pose", {**POSE, "number": k, "mean_rad": Q, "waypoint": k - 1}) for k in range(1, poses + 1)),
        ("reading", {"number": 1, "kind": "return", "of": 1, **READING}),
    ]  # fmt: skip


@pytest.fixture
def type_lines(monkeypatch):
    """Type this text, and nothing after it."""
    return lambda text: monkeypatch.setattr("sys.stdin", io.StringIO(text))


@pytest.fixture
def session(make_session):
    return make_session(begin("hinge", Choices(poses=3), root=Path()).procedure)


@pytest.fixture
def write_session(tmp_path):
    """Write a session folder with these events, by default of a complete first placement."""
    return lambda events=None, name="a": write_journal(
        tmp_path / name, written(events or first_placement())
    )


def resume_in(folder: Path, **choices: Any) -> Opening:
    return resume(str(folder), Choices(**choices), root=folder.parent)


def last_event(folder: Path) -> str:
    return read_journal(folder).events[-1].name


def state_after(events: list[Named]) -> SessionState:
    return replay(journal_event(*named) for named in events)


def test_new_placement_resets_the_arm_state_and_keeps_the_poses():
    before = state_after(first_placement())
    state = state_after([*first_placement(), REMOUNTED])
    assert (state.placement, len(state.used_poses), state.poses_here) == (2, 12, ())
    assert state.start_rad is None
    assert (state.modes, state.next_waypoint) == ((), 0)
    assert before.here is before
    # The first placement's poses and repeats do not apply to the arm's position in the second one.
    assert state.here.used_poses == ()
    assert state.here.repeats == ()
    procedure = begin("hinge", Choices(poses=12, placements=2), root=Path()).procedure
    assert before.required_poses(procedure.capture) == 12
    assert state.required_poses(procedure.capture) == 24


def test_poses_and_repeats_belong_to_their_placement():
    pose = {**POSE, "number": 13, "mean_rad": Q, "waypoint": 0, "placement": 2}
    repeat = {"number": 2, "kind": "return", "of": 13, "placement": 2, **READING}
    state = state_after([*first_placement(), REMOUNTED, ("pose", pose), ("reading", repeat)])
    assert state.pose_set().placements == (1, 2)
    assert [p.number for p in state.poses_here] == [13]
    assert state.next_waypoint == 1
    assert state.here.pose_set().placements == (1,)
    assert [r.first.number for r in state.here.repeats] == [13]
    assert len(state.repeats) == 2


@pytest.mark.parametrize(
    ("events", "placement", "due"),
    [
        (first_placement(), 1, True),
        (first_placement()[:-1], 1, False),
        (first_placement(11), 1, False),
        ([*first_placement(), REMOUNTED], 2, False),
    ],
    ids=["complete", "no repeat", "pose missing", "remounted"],
)
def test_next_placement_is_due_once_the_first_is_complete(write_session, events, placement, due):
    opening = resume_in(write_session(events))
    now_due = next_due(opening.state, opening.procedure)
    assert (opening.state.placement, now_due) == (placement, due)


def test_operator_must_confirm_the_next_placement(write_session, type_lines, approve):
    folder = write_session()
    opening = resume_in(folder)
    approve(" ".join(remounting_lines(opening, drives_off=True)))
    # The bus comes from the journal if not from the command line. Lines typed before the question do not count.
    for text, asked in (
        ("", opening),
        ("", replace(opening, choices=Choices())),
        ("\n\n", opening),
    ):
        type_lines(text)
        with pytest.raises(SessionError, match="was not confirmed") as error:
            next_placement(asked, ConsoleListener(), root=folder.parent)
        assert f"sarcal run --resume {folder}" in error.value.remedy
        again = resume_in(folder)
        assert next_due(again.state, again.procedure)
    type_lines("\nmounted\n")
    second = next_placement(opening, ConsoleListener(), root=folder.parent)
    assert (second.state.placement, second.procedure.placements) == (2, 2)
    assert not next_due(second.state, second.procedure)
    assert last_event(folder) == "remounted"


def test_options_of_a_resume_apply_to_the_next_placement(write_session, type_lines):
    folder = write_session()
    opening = resume_in(folder, placements=3, upload=False, channel="other")
    type_lines("mounted\n")
    second = next_placement(opening, ConsoleListener(), root=folder.parent)
    assert second.procedure.placements == 3
    assert not second.procedure.upload
    assert (second.choices.interface, second.choices.channel) == ("loopback", "other")


@pytest.mark.parametrize("last", ["remounting", "remounted"])
def test_unconfirmed_placement_is_confirmed_before_any_motion(write_session, type_lines, last):
    """Earlier versions wrote `remounted` before the operator had confirmed it."""
    folder = write_session([*first_placement(), (last, {"placement": 2})])
    opening = resume_in(folder)
    type_lines("\n")
    with pytest.raises(SessionError, match="was not confirmed"):
        require_mounted(opening, ConsoleListener())
    assert last_event(folder) == last
    type_lines("mounted\n")
    require_mounted(opening, ConsoleListener())
    assert last_event(folder) == "remounted"
    assert session_state(read_journal(folder)).mounted
    type_lines("")
    require_mounted(resume_in(write_session(name="b")), ConsoleListener())


class SignallingInput(io.StringIO):
    """A standard input at which a signal arrives instead of a line."""

    def __init__(self, number: signal.Signals) -> None:
        super().__init__()
        self._number = number

    def readline(self, size: int = -1, /) -> str:
        signal.raise_signal(self._number)
        return ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("more", [[], [REMOUNTED]], ids=["due", "unconfirmed"])
def test_signal_during_the_confirmation_changes_nothing(
    write_session, monkeypatch, run_command, number, more
):
    folder = write_session([*first_placement(), *more])
    before = (folder / JOURNAL_NAME).read_bytes()
    monkeypatch.setattr("sys.stdin", SignallingInput(number))
    # Without a handler of the program, the signal would end the tests.
    handler = signal.signal(number, lambda *_: None)
    try:
        text = run_command(130, "run", "--resume", folder, "--sessions", folder.parent).words
    finally:
        signal.signal(number, handler)
    assert "interrupted while the fixture was being mounted" in text
    assert f"Go on with: sarcal run --resume {folder}" in text
    assert (folder / JOURNAL_NAME).read_bytes() == before
    opening = resume_in(folder)
    assert next_due(opening.state, opening.procedure) is not bool(more)
    assert opening.state.unconfirmed_placement is bool(more)


@pytest.mark.parametrize(("held", "powered"), [(True, (2, 5)), (False, (2, 5)), (False, ())])
def test_powered_drives_or_a_silent_arm_prevent_remounting(session, held, powered):
    """Also if STOP holds the drives."""
    session.arm.left_powered = powered
    session.arm.close = lambda: held
    session.close("the fixture is remounted")
    assert session.held is held
    message = "drives of joints 2, 5 are still powered" if powered else "did not answer"
    with pytest.raises(SessionError, match=message) as error:
        session.require_drives_off()
    if powered:
        assert isinstance(error.value, DrivesNotOffError)
        assert "hardware stop" in error.value.remedy
        assert exit_code(error.value) == 3
    assert (session.not_held is None) is held


def test_drives_are_reported_off_only_if_checked(write_session, type_lines, run_command):
    folder = write_session()
    type_lines("")
    text = run_command(2, "run", "--resume", folder, "--sessions", folder.parent).words
    assert "its drives are off" not in text
    assert "make sure that they are off" in text


def test_powered_arm_is_not_reported_as_held(tmp_path, type_lines, monkeypatch, run_command):
    def leave_powered(arm):
        arm.left_powered = (1,)
        return False

    monkeypatch.setattr(CanopenArm, "close", leave_powered)
    type_lines("")
    stderr = run_command(3, "--plain", "--sessions", tmp_path).err
    assert "the drive of joint 1 is still powered" in stderr
    assert "arm is held" not in stderr


def record_pose_and(session: Session, event: str) -> Session:
    session.record("control", {"start_rad": Q, "home_rad": Q})
    session.record("pose", {**POSE, "number": 1, "mean_rad": Q, "waypoint": 0})
    session.record(event, {"placement": 2})
    return session


def test_unmounted_fixture_prevents_connecting(session):
    """Also for verify and export: somebody may be holding the arm."""
    state = record_pose_and(session, "remounting").state
    assert (state.placement, state.mounted, state.unconfirmed_placement) == (2, False, True)
    with pytest.raises(GuardError, match="its mounting for placement 2"):
        session.connect()
    assert session.identity is None
    session.mounted()
    assert session.connect() is session.identity


def test_undo_removes_no_pose_of_another_placement(session):
    with pytest.raises(GuardError, match="this placement has no pose"):
        record_pose_and(session, "remounted").undo()
