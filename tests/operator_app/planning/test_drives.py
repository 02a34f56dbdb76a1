"""The choice of drive joints: the best usable set of sensed joints, with a reason."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.config.procedure_file import load_procedure
from operator_app.errors import SessionError
from operator_app.planning.drives import choose_drives, predict_drives, usable_sets
from solver.chain.parameters import nominal_vector
from solver.design.drive_joints import DriveTrial


@pytest.fixture(scope="module")
def prediction():
    return predict_drives(*planned_loop())


def planned_loop():
    """Arm, model, nominal parameters and home of a procedure."""
    procedure = load_procedure("hinge_planned")
    arm = procedure.arm
    model = procedure.fixture.fixture.model(arm)
    return arm, model, nominal_vector(model.parameters), arm.home_rad


def trial(drives: tuple[int, ...], *, follows: float = 1.0, stopped: str = "") -> DriveTrial:
    """Wiggles of two drives by 0.02 rad, followed by all other joints by 0.01 rad."""
    commanded = 0.02 * np.eye(2)
    moved = np.full((2, 7), 0.01)
    for k, joint in enumerate(drives):
        moved[:, joint - 1] = 0.0
        moved[k, joint - 1] = 0.02 * follows
    return DriveTrial(drives=drives, commanded_rad=commanded, moved_rad=moved, stopped=stopped)


def test_inexact_and_unsensed_joints_do_not_drive(prediction):
    assert prediction.inexact == {6, 7}
    assert not any({6, 7} & set(drives) for drives in choose_drives(prediction).sets)
    assert all(1 not in r.drives for r in usable_sets(prediction, (1,)))
    assert all(1 not in d for d in choose_drives(prediction, unsensed_joints=(1,)).sets)


def test_failed_drive_trial_overrules_the_prediction(prediction):
    sets = [r.drives for r in usable_sets(prediction)]
    assert sets[0] == (1, 5)
    trials = [trial(d, stopped="joint 3 needed 90 N m" if d == (1, 5) else "") for d in sets]
    choice = choose_drives(prediction, trials=trials)
    assert choice.drives in sets[1:]
    assert any(reason.startswith("on the arm:") for reason in choice.reasons)


def test_no_drive_set_that_moves_or_at_a_fold_is_an_error(prediction):
    trials = [trial(r.drives, follows=0.1) for r in usable_sets(prediction)]
    with pytest.raises(SessionError, match="only 10% of its commanded angle"):
        choose_drives(prediction, trials=trials)
    folded = tuple(
        replace(r, usable=False, reasons=("at a fold", *r.reasons)) for r in prediction.here
    )
    message = r"no joints can drive the chain from the present pose.*fold"
    with pytest.raises(SessionError, match=message):
        choose_drives(replace(prediction, here=folded))


def test_start_beyond_a_joint_range_is_an_error():
    arm, model, x, home = planned_loop()
    joints = list(arm.joints)
    joints[3] = replace(joints[3], lower_rad=home[3] + 0.5)
    with pytest.raises(SessionError, match=r"joint 4 .* deg beyond its range"):
        predict_drives(replace(arm, joints=tuple(joints)), model, x, home)
