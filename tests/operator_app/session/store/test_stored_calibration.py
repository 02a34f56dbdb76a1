"""A session's calibration comes out of its journal; it is solved again only where it must be, and says so."""

import math
from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.cross_validation import Checks
from operator_app.errors import SessionError
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import replay
from operator_app.session.store.state import SessionState
from operator_app.session.store.stored_calibration import (
    journal_calibration,
    session_calibration,
    solution_data,
    with_checks,
)
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.session import Session
from tests.oracles.journals import journal_event
from tests.oracles.plant_sessions import short_procedure


@pytest.fixture
def procedure():
    return short_procedure(12)


@pytest.fixture
def session(make_session, procedure):
    made = make_session(procedure, connect=True)
    made.set_modes((1, 5))
    take_poses(made, Listener())
    return made


def from_the_file(session: Session) -> SessionState:
    session.close("done")
    return replay(read_journal(session.journal.path.parent).events)


def test_a_stored_calibration_is_read_back(session):
    solution = session.calibrate()
    checks = session.check(solution)
    state = from_the_file(session)
    stored = session_calibration(state, session.procedure)
    assert stored.recalculated_because == ""
    assert stored.solution.estimate.x.tobytes() == solution.estimate.x.tobytes()
    assert stored.solution.warnings == solution.warnings
    assert isinstance(stored.checks, Checks)
    assert np.array_equal(stored.checks.jackknife_sd, checks.jackknife_sd)
    assert with_checks(stored, state, session.procedure) is stored
    assert "record" not in state.solved


def test_an_infinite_condition_number_is_stored(session, procedure):
    stored = session.calibrate()
    stored = replace(
        stored, identifiability=replace(stored.identifiability, scaled_condition_number=math.inf)
    )
    data = solution_data(stored, session.state, session.procedure)
    session.journal.append("solved", data)
    again = session_calibration(from_the_file(session), procedure)
    assert again.recalculated_because == ""
    assert math.isinf(again.solution.identifiability.scaled_condition_number)


def test_other_options_and_old_journals_are_solved_again(session, procedure):
    session.calibrate(unsensed_joints=(7,))
    state = session.state
    assert session_calibration(state, procedure).solution.model.unsensed_joints == (7,)
    other = session_calibration(state, procedure, unsensed_joints=())
    assert other.solution.model.unsensed_joints == ()
    assert "by implicit without the readings of joint 7" in other.recalculated_because
    record = {k: v for k, v in state.solution.items() if k != "unsensed_offsets"}
    assert "earlier version" in journal_calibration(replace(state, solution=record))
    old = replace(state, solution={})
    again = session_calibration(old, procedure)
    assert "no calibration" in again.recalculated_because
    assert again.checks is None
    assert again.solution.model.unsensed_joints == (7,)
    newer = session_calibration(replace(state, solution={"version": 0}), procedure)
    assert "another version" in newer.recalculated_because
    paper = session_calibration(state, procedure, estimator="paper", unsensed_joints=())
    # What judged it stands beside it, and is what the other estimator gives.
    beside = paper.solution.beside
    assert beside.estimator == "implicit"
    np.testing.assert_array_equal(beside.x, other.solution.identified.x)
    assert paper.solution.estimate.x.tobytes() == other.solution.beside.x.tobytes()
    assert with_checks(paper, state, procedure).checks == Checks()
    assert with_checks(other, state, procedure).checks.held_out is not None
    with pytest.raises(SessionError, match="eliminates the hinge angle only"):
        session_calibration(state, procedure, estimator="paper")
    session.exclude(3, "bumped")
    assert isinstance(journal_calibration(session.state), str)


def test_a_session_without_poses_is_reported(procedure):
    with pytest.raises(SessionError, match="no pose of this session"):
        session_calibration(SessionState(), procedure)


def test_cross_checks_belong_to_their_solution():
    solved = journal_event("solved", {"record": {"version": 1}})
    checked = journal_event("checked", {"record": {"version": 1, "outliers": []}})
    assert replay([solved, checked]).checks
    assert replay([solved, checked, solved]).checks == {}


def test_an_inconsistent_stored_solution_is_solved_again(session, procedure):
    """As in a journal whose checksums are right and whose lines were put together by somebody else."""
    session.calibrate()
    state = session.state
    assert not isinstance(journal_calibration(state), str)
    fewer = replace(state, poses=state.poses[1:])
    assert journal_calibration(fewer) == "the solution in the journal is from other poses"
    together = "the solution in the journal is not consistent"
    old = {key: value for key, value in state.solved.items() if key != "poses"}
    assert journal_calibration(replace(fewer, solved=old)) == together
    for dropped in ([0], [-1], [99], list(range(12))):
        odd = replace(state, solution={**state.solution, "dropped_flipped": dropped})
        assert journal_calibration(odd) == together
    estimate = dict(state.solution["estimate"])
    estimate["x"] = {"shape": [13], "values": estimate["x"]["values"][:13]}
    short = replace(state, solution={**state.solution, "estimate": estimate})
    assert journal_calibration(short) == together
    again = session_calibration(fewer, procedure)
    assert again.solution.estimate.residual.shape[0] == len(fewer.used_poses)
