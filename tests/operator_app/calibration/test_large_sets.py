"""Pose sets of hundreds and thousands: sound ones keep the arm's scale, faults keep their names."""

from functools import partial

import numpy as np
import pytest

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.multistart import SCREENING_POSES
from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.as_shipped import spread_out
from tests.oracles.shop_floor_large import large, longer_elbow, odd, shaken, step_in_fifth_of_poses

pytestmark = pytest.mark.campaign


def test_thousand_sound_poses_are_accepted():
    result = outcome(large(1, 1000))
    assert result.verdict == Verdict.ACCEPTED.value, result.said
    assert np.abs(result.z).max() < 4.0


def test_non_convergence_is_named_with_many_poses():
    result = outcome(spread_out(large(1, 2 * SCREENING_POSES + 1), np.s_[:, 5:], 50.0))
    assert result.verdict == Verdict.NOT_ACCEPTED.value
    assert "NOT_CONVERGED" in result.causes


@pytest.mark.parametrize("seed", [1, 2])
def test_ten_thousand_sound_poses_keep_the_scale(seed):
    result = outcome(large(seed, 10_000))
    assert result.verdict in (Verdict.ACCEPTED.value, Verdict.WITH_WARNINGS.value), result.said
    lengths = result.error[[7, 8, 10, 11, 12]]
    assert np.abs(lengths).max() < 1.5e-3
    assert np.abs(result.z).max() < 6.0


OUTLIERS, LENGTHS = ("OUTLIERS", "ENCODER_2"), ("LENGTH_s_3", "LENGTH_s_5")


@pytest.mark.parametrize(
    ("fault", "poses", "codes"),
    [
        (shaken, 150, ("SCATTER",)),
        (longer_elbow, 2 * SCREENING_POSES + 1, LENGTHS),
        *((step_in_fifth_of_poses, poses, OUTLIERS) for poses in (1000, 3000)),
        *((partial(odd, share=s), poses, OUTLIERS) for s in (0.01, 0.3) for poses in (1000, 3000)),
    ],
)
def test_faults_of_a_large_set_are_named(fault, poses, codes):
    result = outcome(fault(large(1, poses)))
    assert result.causes[0] in codes, result.said
    assert fault is not shaken or len(result.causes) == 1
