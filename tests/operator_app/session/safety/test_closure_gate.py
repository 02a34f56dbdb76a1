"""The closure gate of a session: before a drive is enabled, the loop must be able to close with the joint readings."""

from collections.abc import Callable
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from fixtures.base import Tolerance
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import GuardError
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.workflow.capture import take_poses
from operator_app.session.workflow.listener import Listener
from tests.oracles.journal_events import event_data
from tests.oracles.plant_sessions import MakeSession, left_session, short_procedure
from tests.oracles.wrong_zero import ShiftedCounterArm

PROCEDURE = replace(load_procedure("hinge"), capture=short_procedure(40).capture)


def refuse(
    make_session: MakeSession, arm: ShiftedCounterArm, *, homing: bool, resume: bool = False
) -> tuple[str, dict[str, Any]]:
    """The error of a session that is refused before any drive is enabled, and its journal entry."""
    session = make_session(PROCEDURE, arm=arm, resume=resume, connect=True)
    arm.enabled = 0
    arm.moves.clear()
    with pytest.raises(GuardError) as error:
        take_poses(session, Listener(), (1, 5), homing=homing)
    assert (arm.enabled, arm.moves) == (0, [])
    # The plant enables its drives as it is closed.
    session.close("refused")
    event = event_data(session, "standing")[-1]
    assert event["refused"] is True
    assert event["told"] in str(error.value)
    return str(error.value), event


def shift(joint: int, degrees: float) -> Callable[[ShiftedCounterArm], None]:
    return lambda arm: arm.off_rad.__setitem__(joint - 1, np.deg2rad(degrees))


def reset_counter(joint: int) -> Callable[[ShiftedCounterArm], None]:
    return lambda arm: arm.reset_counter(joint)


def reverse_direction(arm: ShiftedCounterArm) -> None:
    arm.off_rad[1] = -2.0 * arm.snapshot().positions_rad[1]


def exchange_joints(arm: ShiftedCounterArm) -> None:
    q_rad = arm.snapshot().positions_rad
    arm.off_rad[[1, 2]] = q_rad[[2, 1]] - q_rad[[1, 2]]


OPEN_LOOP = "the loop cannot close with the present joint readings"


@pytest.mark.parametrize("homing", [False, True])
@pytest.mark.parametrize(
    ("fault", "parts"),
    [
        (reset_counter(1), ("the counter of joint 1 is at zero", "Home joint 1")),
        (reset_counter(2), ("joint 2 reads 0.000 deg, outside its range", "Home the joint")),
        (shift(1, -60.0), (OPEN_LOOP, "it closes with joint 1 near")),
        (shift(2, 60.0), (OPEN_LOOP, "it closes with joint 2 near")),
        (shift(3, 60.0), (OPEN_LOOP, "it closes with joint 3 near")),
        (shift(4, -60.0), (OPEN_LOOP, "it closes with joint 4 near")),
        (reverse_direction, ("it closes with joint 2 near", "direction")),
        (
            exchange_joints,
            ("ignoring any one joint's reading does not help", "order of the joints"),
        ),
    ],
    ids=["reset 1", "reset 2", "shift 1", "shift 2", "shift 3", "shift 4", "direction", "order"],
)
def test_impossible_reading_is_refused_even_with_homing(make_session, fault, parts, homing):
    arm = ShiftedCounterArm(PROCEDURE)
    fault(arm)
    message, event = refuse(make_session, arm, homing=homing)
    assert all(part in message for part in parts), message
    assert "go-home" not in message
    assert (event["probability"] is None) is ("outside its range" in parts[0])


def arm_after(folder: Path, poses: int) -> ShiftedCounterArm:
    """The arm of a session that was closed after so many poses, at rest at the last one."""
    arm = ShiftedCounterArm(PROCEDURE)
    left_session(folder, arm, PROCEDURE, poses)
    arm.capture(500)
    return arm


FAULTS = [
    *(
        pytest.param(shift(joint, degrees), OPEN_LOOP, id=f"shift {joint} by {degrees:+.0f} deg")
        for joint in (1, 2, 3, 4)
        for degrees in (-60.0, 60.0)
    ),
    pytest.param(reset_counter(1), "the counter of joint 1 is at zero", id="reset 1"),
]


@pytest.mark.sample(5)
@pytest.mark.parametrize(("poses", "entries"), [(0, 1), (1, 2), (2, 2), (20, 1)])
@pytest.mark.parametrize(("fault", "message"), FAULTS)
def test_impossible_reading_is_refused_after_any_number_of_poses(
    make_session, tmp_path, poses, entries, fault, message
):
    """After one or two poses, the first entry is that they are too few for a check; then follows that by the files."""
    folder = tmp_path / "session"
    arm = arm_after(folder, poses)
    before = event_data(folder, "standing")
    if poses:
        # The first check, by the files alone, passed.
        (passed,) = before
        assert passed["refused"] is False
        assert 1e-12 < passed["probability"] <= 1.0
        assert "within the tolerances of the files" in passed["told"]
    fault(arm)
    text, refused = refuse(make_session, arm, homing=True, resume=True)
    assert message in text or (poses == 20 and message == OPEN_LOOP)
    assert len(event_data(folder, "standing")) == len(before) + entries
    assert refused["probability"] < 1e-4
    assert session_state(read_journal(folder)).captured == poses


def test_counter_at_zero_outside_the_box_is_refused_if_tolerances_are_wide(make_session):
    """The loop closes with any reading then, but the procedure's box excludes zero."""
    wide = Tolerance(position_m=1.0, orientation_rad=np.deg2rad(120.0))
    nominal: Any = PROCEDURE.fixture
    fixture = replace(nominal, fixture=replace(nominal.fixture, tolerance=wide))
    procedure: Procedure = replace(PROCEDURE, fixture=fixture)
    arm = ShiftedCounterArm(procedure)
    arm.reset_counter(1)
    session = make_session(procedure, arm=arm, connect=True)
    with pytest.raises(GuardError, match="joint 1 reads zero, outside the box") as error:
        take_poses(session, Listener(), (1, 5), homing=True)
    assert "go-home" not in str(error.value)
    assert arm.moves == []
