"""Innovation of one more reading: sound ones, also of arms worse than stated, and shifted ones."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import innovation
from operator_app.config.procedure_file import load_procedure
from tests.oracles.as_shipped import poses_of
from tests.oracles.shop_floor import SOURCES, Sizes, session

PROCEDURE = load_procedure("hinge")
ARM, FIXTURE = PROCEDURE.arm, PROCEDURE.fixture.fixture


def poses(taken, first, last):
    return replace(poses_of(taken), utc=None).at_poses(np.arange(first, last))


def experiment(poses):
    return Experiment(arm=ARM, fixture=FIXTURE, poses=poses)


@pytest.mark.parametrize("times", [1.0, 3.0])
def test_sound_reading_has_usual_chi2(times):
    taken = session(3, Sizes.only(*SOURCES, times=times), poses=13)
    result = innovation(experiment(poses(taken, 0, 12)), poses(taken, 12, 13))
    assert result.chi2 < max(25.0, 2.0 * result.usual)
    assert result.dof == 5


def test_shift_that_would_be_seen_depends_on_its_size():
    taken = session(3, poses=13)
    sound = innovation(experiment(poses(taken, 0, 12)), poses(taken, 12, 13))
    assert not {5, 6, 7} & {*sound.unseen(np.deg2rad(2.0), 50.0)}
    assert {5, 6, 7} <= {*sound.unseen(np.deg2rad(0.01), 50.0)}


def test_two_poses_give_no_innovation():
    taken = session(3, poses=3)
    assert innovation(experiment(poses(taken, 0, 2)), poses(taken, 2, 3)) is None
