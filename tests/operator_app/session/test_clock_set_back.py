"""The session begun last is the latest, whatever was done to the clock."""

from __future__ import annotations

from datetime import UTC, datetime, timedelta
from pathlib import Path

import pytest

from operator_app.config.procedure_file import load_procedure
from operator_app.session.store.folders import find_session, list_sessions, new_folder
from operator_app.session.store.journal import read_journal
from tests.oracles.journals import POSE
from tests.oracles.opened import opened
from tests.oracles.plant_arm import PlantArm

RIGHT = datetime(2026, 11, 23, 12, tzinfo=UTC)


def begun(root: Path, days: float) -> Path:
    """Begin a session by a clock that is so many days from right, with a pose in it."""

    def clock() -> datetime:
        return RIGHT + timedelta(days=days)

    procedure = load_procedure("hinge")
    folder = new_folder(root, "hinge", clock())
    session = opened(folder, PlantArm(procedure, "exact"), procedure, clock=clock)
    session.connect()
    session.record("pose", {**POSE, "number": 1, "mean_rad": [0.0] * 7, "waypoint": 0})
    session.close("left")
    return folder


# Days from right at each beginning: set back once, for good; twice; back and right again in between.
@pytest.mark.parametrize(
    "days",
    [
        (0.0, 1.0, 2.0),
        (0.0, 365.0, 1.0, 2.0),
        (0.0, 365.0, 1.0, 0.5, 0.25),
        (365.0, 1.0, 400.0, 2.0, 500.0),
        (0.0, -20000.0, -19999.0, 1.0),
    ],
)
def test_they_are_listed_as_they_were_begun(tmp_path: Path, days: tuple[float, ...]) -> None:
    folders = []
    for day in days:
        folders.append(begun(tmp_path, day))
        assert find_session(tmp_path, "latest") == folders[-1]
    assert [entry.folder for entry in list_sessions(tmp_path)] == folders


def test_where_no_clock_was_set_back_a_journal_says_nothing_of_it(tmp_path: Path) -> None:
    for day in (0.0, 1.0):
        folder = begun(tmp_path, day)
        assert "after" not in read_journal(folder).events[0].data


def test_a_session_that_went_away_is_not_waited_for(tmp_path: Path) -> None:
    first, second, third = (begun(tmp_path, day) for day in (0.0, 365.0, 1.0))
    (second / "journal.jsonl").unlink()
    assert [entry.folder for entry in list_sessions(tmp_path)] == [first, third]
