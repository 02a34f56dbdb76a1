"""Choosing drive joints: the best usable set, never one that is not sensed, and always with a reason."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.config.procedure_file import load_procedure
from operator_app.errors import SessionError
from operator_app.planning.drives import choose_drives, predict_drives, sets_to_try
from solver.chain.parameters import nominal_vector
from solver.design.drive_joints import DriveTrial


@pytest.fixture(scope="module")
def prediction():
    own = load_procedure("hinge_planned")
    model = own.fixture.fixture.model(own.arm)
    return predict_drives(own.arm, model, nominal_vector(model.parameters), own.arm.home_rad)


def trial(drives: tuple[int, ...], *, follows: float = 1.0, stopped: str = "") -> DriveTrial:
    """Wiggles of two drives by 0.02 rad that all joints follow at the same rate."""
    commanded = 0.02 * np.eye(2)
    moved = np.full((2, 7), 0.01)
    for k, joint in enumerate(drives):
        moved[:, joint - 1] = 0.0
        moved[k, joint - 1] = 0.02 * follows
    return DriveTrial(drives=drives, commanded_rad=commanded, moved_rad=moved, stopped=stopped)


def test_drive_set_with_most_reach_is_chosen(prediction):
    choice = choose_drives(prediction)
    assert choice.drives == (1, 5) == choice.sets[0]
    assert 1 < len(choice.sets) <= 3
    assert "reaches" in choice.reasons[0]
    assert "at the present pose" in choice.reasons[-1]
    assert choice.ranked[0].drives == choice.drives


def test_inexact_and_unsensed_joints_do_not_drive(prediction):
    assert prediction.inexact == {6, 7}
    for drives in choose_drives(prediction).sets:
        assert not set(drives) & {6, 7}


def test_joints_that_are_not_used_never_drive(prediction):
    choice = choose_drives(prediction, unsensed_joints=(1,))
    assert all(1 not in drives for drives in choice.sets)
    assert all(1 not in drives for drives in sets_to_try(prediction, (1,)))


def test_failed_drive_trial_overrules_the_prediction(prediction):
    tried = sets_to_try(prediction)
    assert tried[0] == (1, 5)
    trials = [trial(d, stopped="joint 3 needed 90 N m" if d == (1, 5) else "") for d in tried]
    choice = choose_drives(prediction, trials=trials)
    assert choice.drives in tried[1:]
    assert any(reason.startswith("on the arm:") for reason in choice.reasons)


def test_no_moving_drive_set_is_an_error(prediction):
    trials = [trial(d, follows=0.1) for d in sets_to_try(prediction)]
    with pytest.raises(SessionError, match="only 10% of its commanded angle"):
        choose_drives(prediction, trials=trials)


def test_no_drive_set_at_a_fold_is_an_error(prediction):
    folded = tuple(
        replace(r, usable=False, reasons=("at a fold", *r.reasons)) for r in prediction.here
    )
    with pytest.raises(
        SessionError, match=r"no joints can drive the chain from the present pose.*fold"
    ):
        choose_drives(replace(prediction, here=folded))


def test_start_beyond_a_joint_range_is_an_error():
    own = load_procedure("hinge_planned")
    model = own.fixture.fixture.model(own.arm)
    home = own.arm.home_rad
    joints = list(own.arm.joints)
    joints[3] = replace(joints[3], lower_rad=home[3] + 0.5)
    arm = replace(own.arm, joints=tuple(joints))
    with pytest.raises(SessionError, match=r"joint 4 .* deg beyond its range"):
        predict_drives(arm, model, nominal_vector(model.parameters), home)
