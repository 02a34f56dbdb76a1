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
    result = outcome(large(1, 1000))
    assert result.verdict == Verdict.ACCEPTED.value, result.said
    assert np.abs(result.z).max() < 4.0


def test_scatter_is_named_with_many_poses():
    assert outcome(shaken(large(1, 150))).causes == ("SCATTER",)


def test_length_error_is_named_with_many_poses():
    result = outcome(longer_elbow(large(1, 2 * SCREENING_POSES + 1)))
    assert result.causes[0] in ("LENGTH_s_3", "LENGTH_s_5"), result.said


def test_non_convergence_is_named_with_many_poses():
    taken = large(1, 2 * SCREENING_POSES + 1)
    spread = taken.spread.copy()
    spread[:, 5:] = np.deg2rad(50.0)
    result = outcome(replace(taken, spread=spread))
    assert result.verdict == Verdict.NOT_ACCEPTED.value
    assert "NOT_CONVERGED" in result.causes


@pytest.mark.parametrize("seed", [1, 2])
def test_ten_thousand_sound_poses_keep_the_scale(seed):
    result = outcome(large(seed, 10_000))
    assert result.verdict in (Verdict.ACCEPTED.value, Verdict.WITH_WARNINGS.value), result.said
    lengths = result.error[[7, 8, 10, 11, 12]]
    assert np.abs(lengths).max() < 1.5e-3
    assert np.abs(result.z).max() < 6.0


@pytest.mark.parametrize("poses", [1000, 3000])
@pytest.mark.parametrize(
    "fault",
    [slip_of_a_fifth, partial(odd, share=0.01), partial(odd, share=0.3)],
    ids=["slip of a fifth", "1 % outliers", "30 % outliers"],
)
def test_outliers_of_a_large_set_are_named(fault, poses):
    result = outcome(fault(large(1, poses)))
    assert result.causes[0] in ("OUTLIERS", "ENCODER_2"), result.said
