"""Pose sets of hundreds and thousands: sound ones keep the arm's scale, faults keep their names."""

from dataclasses import replace
from functools import partial

import numpy as np
import pytest

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.multistart import SCREENING_POSES
from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.shop_floor_large import large, longer_elbow, odd, shaken, slip_of_a_fifth

pytestmark = pytest.mark.campaign


def test_thousand_sound_poses_are_accepted():
    """The fit made the arm smaller and smaller: with 1,000 poses it was refused, s_3 and s_5 exchanged."""
    found = outcome(large(1, 1000))
    assert found.verdict == Verdict.ACCEPTED.value, found.said
    assert np.abs(found.z).max() < 4.0


def test_scatter_is_named_with_many_poses():
    """Asked of 85 poses it explained no more than those: an encoder was blamed, and an RVDT that errs by 37 deg."""
    assert outcome(shaken(large(1, 150))).causes == ("SCATTER",)


def test_length_error_is_named_with_many_poses():
    """Upper arm and forearm were said to be exchanged where one of them was 30 mm longer."""
    found = outcome(longer_elbow(large(1, 2 * SCREENING_POSES + 1)))
    assert found.causes[0] in ("LENGTH_s_3", "LENGTH_s_5"), found.said


def test_non_convergence_is_named_with_many_poses():
    """Accepted: what ended were the rounds of all poses, whose variances are those of a selection."""
    found = large(1, 2 * SCREENING_POSES + 1)
    spread = found.spread.copy()
    spread[:, 5:] = np.deg2rad(50.0)
    said = outcome(replace(found, spread=spread))
    assert said.verdict == Verdict.NOT_ACCEPTED.value
    assert "NOT_CONVERGED" in said.causes


@pytest.mark.parametrize("seed", [1, 2])
def test_ten_thousand_sound_poses_keep_the_scale(seed):
    """Accepted with every length of the hinge 3 to 12 mm short: 11 and 18 sigma."""
    found = outcome(large(seed, 10_000))
    assert found.verdict in (Verdict.ACCEPTED.value, Verdict.WITH_WARNINGS.value), found.said
    lengths = found.error[[7, 8, 10, 11, 12]]
    assert np.abs(lengths).max() < 1.5e-3
    assert np.abs(found.z).max() < 6.0


@pytest.mark.parametrize("poses", [1000, 3000])
@pytest.mark.parametrize(
    "fault",
    [slip_of_a_fifth, partial(odd, share=0.01), partial(odd, share=0.3)],
    ids=["slip of a fifth", "1 % odd", "30 % odd"],
)
def test_outliers_of_a_large_set_are_named(fault, poses):
    """Of 1,000 poses it was said that theta_off_1 cannot be seen."""
    found = outcome(fault(large(1, poses)))
    assert found.causes[0] in ("OUTLIERS", "ENCODER_2"), found.said
