"""Several mountings in one journal: what each says of where the arm stands, what is asked between them."""

import io
import signal
from dataclasses import replace
from pathlib import Path
from typing import Any

import pytest

from hardware.control.canopen_arm import CanopenArm
from operator_app.errors import DrivesNotOffError, GuardError, SessionError
from operator_app.exit_codes import exit_code
from operator_app.headless.console import ConsoleListener
from operator_app.headless.procedure_run import next_placement, require_mounted, words
from operator_app.session.store.journal import Journal, read_journal
from operator_app.session.store.replay import replay, session_state
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.opening import Choices, begin, resume
from operator_app.session.workflow.session import Session
from tests.oracles.journals import POSE, an_event, sources

Q = [0.1, -0.2, 0.3, 1.4, -0.5, 0.6, 0.7]
SETTINGS = {"poses": 12, "placements": 2, "interface": "loopback", "channel": "bench"}
READING = {"mean_rad": Q, "sd_rad": [0.0] * 7, "samples": 8}
Named = tuple[str, dict[str, Any]]


def first_placement(poses: int = 12) -> list[Named]:
    return [
        ("opened", {"sources": sources(), "settings": SETTINGS}),
        ("control", {"start_rad": Q, "home_rad": Q}),
        ("modes", {"modes": ["position"] * 7}),
        *(("pose", {**POSE, "number": k, "mean_rad": Q, "waypoint": k - 1}) for k in range(1, poses + 1)),
        ("reading", {"number": 1, "kind": "return", "of": 1, **READING}),
    ]  # fmt: skip


@pytest.fixture
def types(monkeypatch):
    """Type this, and nothing after it."""
    return lambda text: monkeypatch.setattr("sys.stdin", io.StringIO(text))


@pytest.fixture
def session(make_session):
    return make_session(begin("hinge", Choices(poses=3), root=Path()).procedure)


def of(events: list[Named]) -> SessionState:
    return replay(an_event(*named) for named in events)


def written(folder: Path, events: list[Named]) -> Path:
    journal = Journal.create(folder)
    for name, data in events:
        journal.append(name, data)
    journal.close()
    return folder


def test_a_new_mounting_begins_anew_and_keeps_the_poses():
    before = of(first_placement())
    state = of([*first_placement(), ("remounted", {"placement": 2})])
    assert (state.placement, len(state.used_poses), state.poses_here) == (2, 12, ())
    assert state.start_rad is None
    assert (state.modes, state.next_waypoint) == ((), 0)
    assert before.here is before
    # Of where the arm stands in the new one, the others' poses and solution say nothing.
    assert state.here.used_poses == ()
    assert state.here.repeats == ()
    procedure = begin("hinge", Choices(poses=12, placements=2), root=Path()).procedure
    assert before.required_poses(procedure.capture) == 12
    assert state.required_poses(procedure.capture) == 24


def test_poses_of_the_second_mounting_are_told_apart():
    second = {**POSE, "number": 13, "mean_rad": Q, "waypoint": 0, "placement": 2}
    again = {"number": 2, "kind": "return", "of": 13, "placement": 2, **READING}
    events = [
        *first_placement(),
        ("remounted", {"placement": 2}),
        ("pose", second),
        ("reading", again),
    ]
    state = of(events)
    assert state.pose_set().placements == (1, 2)
    assert [p.number for p in state.poses_here] == [13]
    assert state.next_waypoint == 1
    here = state.here
    assert here.pose_set().placements == (1,)
    assert [r.first.number for r in here.repeats] == [13]
    assert len(state.repeats) == 2


def test_the_next_is_due_once_the_first_has_all_its_poses(tmp_path):
    unread, short = first_placement()[:-1], first_placement(11)
    for k, (events, due) in enumerate(((first_placement(), True), (unread, False), (short, False))):
        folder = written(tmp_path / str(k), events)
        opening = resume(str(folder), Choices(), root=tmp_path)
        assert (opening.placement, opening.next_due) == (1, due)
    more = [*first_placement(), ("remounted", {"placement": 2})]
    opening = resume(str(written(tmp_path / "second", more)), Choices(), root=tmp_path)
    assert (opening.placement, opening.next_due) == (2, False)


def test_the_operator_is_told_what_to_do_and_has_to_confirm(tmp_path, types, approve):
    folder = written(tmp_path / "a", first_placement())
    opening = resume(str(folder), Choices(), root=tmp_path)
    approve(" ".join(words(opening, drives_off=True)))
    # Nobody named the bus on the command line: what it was, the journal knows.
    # Lines that were typed before it was asked for are no answer.
    for typed, asked in (
        ("", opening),
        ("", replace(opening, choices=Choices())),
        ("\n\n", opening),
    ):
        types(typed)
        with pytest.raises(SessionError, match="was not confirmed") as refused:
            next_placement(asked, ConsoleListener(), root=tmp_path)
        assert f"sarcal run --resume {folder}" in refused.value.remedy
        assert resume(str(folder), Choices(), root=tmp_path).next_due
    types("\nmounted\n")
    going_on = next_placement(opening, ConsoleListener(), root=tmp_path)
    assert (going_on.placement, going_on.next_due, going_on.procedure.placements) == (2, False, 2)
    assert read_journal(folder).events[-1].name == "remounted"


@pytest.mark.parametrize(
    ("arguments", "words_said"),
    [
        (["hinge_planned", "--placements", "2"], "one placement"),
        (["open_loop", "--placements", "2"], "no fixture to remount"),
        (["hinge", "--placements", "21"], "Request 1 to 20"),
        (["hinge", "--placements", "0"], "not a whole number"),
    ],
)
def test_what_cannot_be_mounted_so_often_is_refused_before_anything(
    arguments, words_said, tmp_path, ends_with
):
    assert words_said in ends_with(2, "run", *arguments, "--sessions", tmp_path).err
    assert list(tmp_path.iterdir()) == []


def test_what_was_chosen_on_resuming_holds_in_the_next_placement(tmp_path, types):
    """Else the third placement was forgotten, and what should not be uploaded was."""
    folder = written(tmp_path / "a", first_placement())
    chosen = Choices(placements=3, upload=False, channel="other")
    opening = resume(str(folder), chosen, root=tmp_path)
    types("mounted\n")
    going_on = next_placement(opening, ConsoleListener(), root=tmp_path)
    assert going_on.procedure.placements == 3
    assert not going_on.procedure.upload
    assert (going_on.choices.interface, going_on.choices.channel) == ("loopback", "other")


@pytest.mark.parametrize("left", ["remounting", "remounted"])
def test_a_placement_that_nobody_confirmed_is_asked_for_before_anything_moves(
    tmp_path, types, left
):
    """In a journal of an earlier version `remounted` may be what somebody was still to do."""
    folder = written(tmp_path / "a", [*first_placement(), (left, {"placement": 2})])
    opening = resume(str(folder), Choices(), root=tmp_path)
    types("\n")
    with pytest.raises(SessionError, match="was not confirmed"):
        require_mounted(opening, ConsoleListener())
    assert read_journal(folder).events[-1].name == left
    types("mounted\n")
    require_mounted(opening, ConsoleListener())
    assert read_journal(folder).events[-1].name == "remounted"
    assert session_state(read_journal(folder)).mounted
    types("")
    require_mounted(resume(str(written(tmp_path / "b", first_placement())), Choices(), root=tmp_path),
                    ConsoleListener())  # fmt: skip


class Signalled(io.StringIO):
    """A keyboard at which nobody types: a signal comes instead."""

    def __init__(self, number: signal.Signals) -> None:
        super().__init__()
        self._number = number

    def readline(self, size: int = -1, /) -> str:
        signal.raise_signal(self._number)
        return ""


@pytest.mark.parametrize("number", [signal.SIGINT, signal.SIGTERM, signal.SIGHUP])
@pytest.mark.parametrize("more", [[], [("remounted", {"placement": 2})]])
def test_a_signal_while_the_fixture_is_being_mounted_ends_in_words(
    tmp_path, monkeypatch, ends_with, number, more
):
    folder = written(tmp_path / "a", [*first_placement(), *more])
    before = (folder / "journal.jsonl").read_bytes()
    monkeypatch.setattr("sys.stdin", Signalled(number))
    # Where nobody heeds it, it is noted and passes.
    passed = signal.signal(number, lambda *_: None)
    try:
        said = ends_with(130, "run", "--resume", folder, "--sessions", tmp_path).words
    finally:
        signal.signal(number, passed)
    assert "interrupted while the fixture was being mounted" in said
    assert f"Go on with: sarcal run --resume {folder}" in said
    assert (folder / "journal.jsonl").read_bytes() == before
    opening = resume(str(folder), Choices(), root=tmp_path)
    assert (opening.next_due, opening.unconfirmed_placement) == (not more, bool(more))


def test_nobody_is_sent_to_an_arm_that_did_not_answer(session):
    session.arm.close = lambda: False
    session.close("the fixture is mounted anew")
    with pytest.raises(SessionError, match="did not answer"):
        session.require_drives_off()


@pytest.mark.parametrize("held", [True, False])
def test_nobody_is_sent_to_an_arm_with_power_in_it(session, held):
    """Where STOP holds its drives as well."""
    session.arm.left_powered = (2, 5)
    session.arm.close = lambda: held
    assert session.close("the fixture is mounted anew") is held
    with pytest.raises(
        DrivesNotOffError, match="drives of joints 2, 5 are still powered"
    ) as refused:
        session.require_drives_off()
    assert "hardware stop" in refused.value.remedy
    assert exit_code(refused.value) == 3
    assert (session.not_held is None) is held


def test_that_drives_are_off_is_said_only_where_somebody_has_looked(tmp_path, types, ends_with):
    folder = written(tmp_path / "a", first_placement())
    types("")
    said = ends_with(2, "run", "--resume", folder, "--sessions", tmp_path).words
    assert "its drives are off" not in said
    assert "make sure that they are off" in said


def test_the_app_does_not_call_an_arm_held_that_is_not(tmp_path, types, monkeypatch, ends_with):
    def powered(arm):
        arm.left_powered = (1,)
        return False

    monkeypatch.setattr(CanopenArm, "close", powered)
    types("")
    said = ends_with(3, "--plain", "--sessions", tmp_path).err
    assert "the drive of joint 1 is still powered" in said
    assert "arm is held" not in said


def one_pose_then(session: Session, event: str) -> Session:
    session.record("control", {"start_rad": Q, "home_rad": Q})
    session.record("pose", {**POSE, "number": 1, "mean_rad": Q, "waypoint": 0})
    session.record(event, {"placement": 2})
    return session


def test_nothing_connects_while_the_fixture_is_off(session):
    """For verify and export as well: somebody may be holding the arm."""
    state = one_pose_then(session, "remounting").state
    assert (state.placement, state.mounted, state.unconfirmed_placement) == (2, False, True)
    with pytest.raises(GuardError, match="its mounting for placement 2"):
        session.connect()
    assert session.identity is None
    session.mounted()
    assert session.connect() is session.identity


def test_undo_takes_back_no_pose_of_another_placement(session):
    with pytest.raises(GuardError, match="this placement has no pose"):
        one_pose_then(session, "remounted").undo()
