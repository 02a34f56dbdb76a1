"""A planned capture as the terminal app runs it: messages, progress, ended by a key and gone on with."""

import numpy as np
import pytest

from operator_app.errors import Cancelled, GuardError
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Change, Level
from operator_app.session.workflow.session import Session
from solver.design.actions import GoTo
from tests.oracles.journalled_sessions import Quiet, initial_snapshot
from tests.oracles.plant_sessions import short_procedure


class Publisher(Quiet):
    """Keeps what is headed for as well, and asks to end after so many poses."""

    def __init__(self, session: Session) -> None:
        super().__init__(session)
        self.headings: list[GoTo | None] = []
        self.end_after: int | None = None

    def publish(self, change: Change) -> None:
        before = self.shown.heading
        super().publish(change)
        if self.shown.heading is not before:
            self.headings.append(self.shown.heading)

    def cancelled(self) -> bool:
        return self.end_after is not None and len(self.shown.state.poses) >= self.end_after


@pytest.fixture
def session(make_session):
    return make_session(short_procedure(2, packaged="hinge_planned"))


def required_poses(session: Session) -> int:
    return initial_snapshot(session).required_poses


@pytest.mark.campaign
def test_automatic_capture_follows_the_plan_and_can_be_cancelled(session):
    publisher = Publisher(session)
    work = Operations(session, publisher)
    work.connect()
    assert publisher.shown.ranked[0].drives == (1, 5)
    assert "reaches" in publisher.shown.ranked[0].reasons[0]
    assert session.state.modes == ()
    work.set_modes(session.state.drives)
    assert required_poses(session) == 2

    publisher.end_after = 3
    with pytest.raises(Cancelled):
        work.automatic()
    assert len(session.state.poses) == 3
    assert required_poses(session) == 5

    publisher.end_after = None
    work.automatic()
    used = session.state.used_poses
    assert sum(p.planned for p in used) == 2
    assert required_poses(session) == len(used)
    assert publisher.said[-1][0] is Level.INFO
    assert any("Explored" in text for _, text in publisher.said)

    # Every move was shown before it began, on the planned ones the poses on the way as well.
    *moves, last = publisher.headings
    assert last is None
    traced = [m.trace_rad for m in moves if m is not None and m.trace_rad is not None]
    assert len(traced) >= 2
    assert np.abs(traced[-1][-1] - used[-1].mean_rad).max() < np.deg2rad(1.0)

    # What was done last is taken back, an edit of a pose before the pose itself.
    first, last = used[0].number, used[-1].number
    work.note(first, "seen")
    work.exclude(first)
    work.undo()
    assert (session.state.poses[0].excluded, session.state.poses[0].note) == ("", "seen")
    work.undo()
    assert session.state.poses[0].note == ""
    assert session.state.poses[-1].number == last

    # And done again, until something else is done.
    before = session.state.poses
    work.redo()
    work.redo()
    assert session.state.poses[0].excluded
    assert session.state.poses[0].note == "seen"
    with pytest.raises(GuardError, match="nothing to redo"):
        work.redo()
    work.undo()
    work.undo()
    work.undo()
    assert session.state.poses[-1].number < last
    work.redo()
    assert session.state.poses == before

    # A pose taken back is wanted again.
    work.undo()
    assert required_poses(session) == len(used)
    assert len(session.state.used_poses) == len(used) - 1
    work.automatic()
    assert sum(p.planned for p in session.state.used_poses) == 2
