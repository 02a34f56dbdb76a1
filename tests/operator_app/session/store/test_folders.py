"""The session begun last is the latest, whatever was done to the clock."""

from dataclasses import replace
from datetime import UTC, datetime, timedelta
from itertools import cycle
from pathlib import Path

import numpy as np
import pytest

from operator_app.config.procedure_file import load_procedure
from operator_app.session.store.folders import find_session, list_sessions, new_folder
from operator_app.session.store.journal import read_journal
from operator_app.session.store.journal_format import format_line
from operator_app.session.store.replay import order_of
from operator_app.session.workflow.importing import ImportedSession
from operator_app.session.workflow.opening import SOURCE_KINDS
from solver.chain.poses import PoseSet
from tests.oracles.journals import POSE
from tests.oracles.plant_arm import PlantArm
from tests.oracles.plant_sessions import opened

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


def imported(root: Path, days: float) -> Path:
    sources = dict(zip(SOURCE_KINDS, load_procedure("hinge").sources, strict=True))
    session = ImportedSession(
        PoseSet(placement=np.array([1]), label=("1",), q_rad=np.zeros((1, 7))),
        arm=sources["arm"],
        fixture=sources["fixture"],
        file="poses.csv",
        name="imported",
        clock=lambda: RIGHT + timedelta(days=days),
    )
    return session.write(root=root)


# Days from right at each beginning: set back once, for good; twice; back and right again in between.
@pytest.mark.parametrize(
    ("days", "makes"),
    [
        ((0.0, 1.0, 2.0), (begun,)),
        ((0.0, 365.0, 1.0, 2.0), (begun,)),
        ((0.0, 365.0, 1.0, 0.5, 0.25), (begun,)),
        ((365.0, 1.0, 400.0, 2.0, 500.0), (begun,)),
        ((0.0, -20000.0, -19999.0, 1.0), (begun,)),
        ((0.0, 365.0, 1.0, 0.5), (begun, imported)),
    ],
)
def test_sessions_are_listed_in_order_of_creation(tmp_path, days, makes):
    folders = []
    for day, make in zip(days, cycle(makes), strict=False):
        folders.append(make(tmp_path, day))
        assert find_session(tmp_path, "latest") == folders[-1]
    assert [entry.folder for entry in list_sessions(tmp_path)] == folders


def test_deleted_or_damaged_sessions_keep_their_number(tmp_path):
    first, second, third = (begun(tmp_path, day) for day in (0.0, 365.0, 1.0))
    (second / "journal.jsonl").unlink()
    fourth = begun(tmp_path, -1.0)
    assert [entry.folder for entry in list_sessions(tmp_path)] == [first, third, fourth]
    with (fourth / "journal.jsonl").open("a") as journal:
        journal.write("damaged\n")
    fifth = begun(tmp_path, -2.0)
    assert read_journal(fifth).events[0].data["order"] == 5
    assert find_session(tmp_path, "latest") == fifth


def without_order(folder: Path) -> None:
    """Make a journal one of an earlier version."""
    path = folder / "journal.jsonl"
    opened, *others = read_journal(folder).events
    data = {key: value for key, value in opened.data.items() if key != "order"}
    lines, chain = list[bytes](), ""
    for event in (replace(opened, data=data), *others):
        line, chain = format_line(event, chain)
        lines.append(line)
    path.write_bytes(b"".join(lines))


def test_journals_of_earlier_versions_come_first_in_order(tmp_path):
    old = [begun(tmp_path, day) for day in (0.0, 1.0, 2.0, 365.0)]
    for folder in old:
        without_order(folder)
    assert [entry.folder for entry in list_sessions(tmp_path)] == old
    new = [begun(tmp_path, -1.0), begun(tmp_path, -2.0)]
    assert [entry.folder for entry in list_sessions(tmp_path)] == [*old, *new]


@pytest.mark.parametrize("order", [True, -1, 0, 2**60, "7", None, 1.5])
def test_an_invalid_order_number_is_ignored(order):
    assert order_of({"order": order}) == 0
