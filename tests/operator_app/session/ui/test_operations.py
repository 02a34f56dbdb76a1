"""A planned capture as the terminal app runs it: messages, progress, ended by a key and gone on with; its edits."""

import numpy as np
import pytest

from operator_app.errors import Cancelled, GuardError
from operator_app.session.ui.operations import Operations
from operator_app.session.ui.snapshot import Change, Level
from solver.design.actions import GoTo
from tests.oracles.journalled_sessions import Quiet, initial_snapshot
from tests.oracles.plant_sessions import short_procedure


class Publisher(Quiet):
    headings: tuple[GoTo | None, ...] = ()

    def publish(self, change: Change) -> None:
        before = self.shown.heading
        super().publish(change)
        if self.shown.heading is not before:
            self.headings += (self.shown.heading,)


@pytest.mark.campaign
def test_automatic_capture_follows_the_plan_and_can_be_cancelled(make_session):
    session = make_session(short_procedure(2, packaged="hinge_planned"))
    publisher = Publisher(session)
    work = Operations(session, publisher)
    work.connect()
    assert publisher.shown.ranked[0].drives == (1, 5)
    assert "reaches" in publisher.shown.ranked[0].reasons[0]
    assert session.state.modes == ()
    work.set_modes(session.state.drives)
    assert initial_snapshot(session).required_poses == 2

    session.cancelled = lambda: len(session.state.poses) >= 3
    with pytest.raises(Cancelled):
        work.automatic()
    assert len(session.state.poses) == 3
    assert initial_snapshot(session).required_poses == 5

    session.cancelled = lambda: False
    work.automatic()
    used = session.state.used_poses
    assert sum(p.planned for p in used) == 2
    assert initial_snapshot(session).required_poses == len(used)
    assert publisher.messages[-1][0] is Level.INFO
    assert any("Explored" in text for _, text in publisher.messages)

    # Every move was shown before it began, on the planned ones the poses on the way as well.
    *moves, last = publisher.headings
    assert last is None
    traced = [m.trace_rad for m in moves if m is not None and m.trace_rad is not None]
    assert len(traced) >= 2
    assert np.abs(traced[-1][-1] - used[-1].mean_rad).max() < np.deg2rad(1.0)

    # A pose that was undone is captured again.
    work.undo()
    assert initial_snapshot(session).required_poses == len(used)
    assert len(session.state.used_poses) == len(used) - 1
    work.automatic()
    assert sum(p.planned for p in session.state.used_poses) == 2


def test_edits_and_poses_are_undone_in_reverse_order_and_redone(make_session):
    session = make_session(short_procedure(3), connect=True)
    work = Operations(session, Quiet(session))
    work.set_modes((1, 5))
    work.automatic()
    states = [session.state.poses]
    work.note(1, "seen")
    states.append(session.state.poses)
    work.exclude(1)
    states = [states[0][:-1], *states, session.state.poses]
    assert (states[-1][0].note, states[-1][0].excluded != "") == ("seen", True)
    for poses in reversed(states[:-1]):
        work.undo()
        assert repr(session.state.poses) == repr(poses)
    for poses in states[1:]:
        work.redo()
        assert repr(session.state.poses) == repr(poses)
    with pytest.raises(GuardError, match="nothing to redo"):
        work.redo()


def test_capture_by_hand_warns_of_a_repeated_place_and_of_a_reading_outside_its_range(make_session):
    session = make_session(short_procedure(8))
    publisher = Publisher(session)
    work = Operations(session, publisher)
    work.connect()
    work.set_modes((1, 5))
    work.capture(0)
    work.capture(0)
    assert publisher.messages[-1][0] is Level.WARNING
    assert "Pose 2 is at the place of pose 1" in publisher.messages[-1][1]

    joint = session.model.joints[6]
    session.arm.off_rad[6] = joint.upper_rad + 0.1 - session.arm.snapshot().positions_rad[6]
    work.capture(0)
    warnings = [text for level, text in publisher.messages if level is Level.WARNING]
    assert "Pose 3: joint 7 reads" in warnings[1]
