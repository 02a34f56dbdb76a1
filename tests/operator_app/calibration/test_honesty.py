"""Sigmas match errors and faults are named, in small; in full: tests/benchmarks/honesty.py and verdicts.py."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.acceptance import Verdict
from operator_app.calibration.multistart import SCREENING_POSES
from tests.benchmarks.shop_floor_files import read
from tests.benchmarks.shop_floor_outcome import CRASHED, NORMAL_95, outcome
from tests.benchmarks.verdicts import one
from tests.oracles.as_shipped import displaced, spread_out
from tests.oracles.shop_floor import PARAMETERS, SOURCES, Sizes, Stream, session, stream, walked
from tests.oracles.shop_floor_faults import slipped_link

pytestmark = pytest.mark.campaign

MANY = 2 * SCREENING_POSES + 1


def test_intervals_cover_the_truth_with_all_errors_as_stated():
    outcomes = [outcome(session(seed)) for seed in range(1100, 1106)]
    assert all(o.accepted for o in outcomes)
    z = np.array([o.z for o in outcomes])
    # 84 intervals of 6 arms, whose parameters correlate: a wide band.
    assert np.mean(np.abs(z) < NORMAL_95) >= 0.88
    assert 0.4 < np.sqrt(np.mean(z**2)) < 1.25


@pytest.mark.parametrize("source", SOURCES)
def test_intervals_cover_the_truth_with_one_error_source(source):
    sizes = Sizes.only(source)
    arm, fixture = read({}, sizes)
    z = [outcome(session(seed, sizes), arm=arm, fixture=fixture).z for seed in (1100, 1101, 1102)]
    assert np.mean(np.abs(z) < NORMAL_95) >= 0.85
    assert np.sqrt(np.mean(np.square(z))) < 1.6


CRAMER_RAO = (
    *(4.1e-5, 4.7e-5, 5.5e-5, 8.4e-5, 8.3e-5, 2.2e-3, 1.4e-3),
    *(2.1e-4, 2.2e-5, 3.0e-5, 2.8e-4, 1.04e-4, 4.0e-5, 6.7e-5),
)
"""Bounds of the standard deviations of `PARAMETERS` (rad, m), rms over these arms, by an independent calculation."""


def test_errors_are_near_the_bound():
    sizes = Sizes.only("lengths")
    arm, fixture = read({}, sizes)
    outcomes = [outcome(session(k, sizes), arm=arm, fixture=fixture) for k in range(1100, 1104)]
    ratios = [o.error / CRAMER_RAO for o in outcomes]
    assert 0.5 < np.sqrt(np.mean(np.square(ratios))) < 1.6


def test_sigmas_of_many_poses_are_not_too_small():
    z = np.array([outcome(session(seed, poses=160)).z for seed in (1100, 1101, 1102)])
    assert z.shape == (3, len(PARAMETERS))
    assert np.sqrt(np.mean(z**2)) < 1.5


SURE = (
    "3 poses",
    "motion 1 deg",
    "hinge turns 0.5 deg",
    "hinge slips 5 mm",
    "RVDT 5 %",
    "1 outlier 0.5 deg",
    "12 flipped",
    "RVDT stuck",
    "RVDT saturated",
    "joint slips 1 deg",
    "joint slips 50 counts",
    "encoder slips 500 counts",
    "frozen for half",
    "hinge 1 deg from joint 7",
    "radians",
    "columns exchanged",
    "a joint's sign",
    "elbow 30 mm",
    "elbow 5 mm",
)

"""Cases whose cause must come first. The benchmark has the others."""


@pytest.mark.parametrize("name", SURE)
def test_fault_is_named_first_and_not_accepted_unnamed(name):
    verdict = one((name, 3100))
    assert verdict.outcome.verdict != CRASHED, verdict.outcome.text
    assert not verdict.accepted_wrong
    assert verdict.first, (verdict.outcome.causes, verdict.outcome.text)


@pytest.mark.parametrize(("mm", "accepted"), [(0.5, True), (2.0, False)])
def test_a_change_of_a_length_must_be_within_its_stated_uncertainty(mm, accepted):
    result = outcome(slipped_link(3100, mm=mm).taken)
    assert (result.accepted, result.causes[0][:-1]) == (accepted, "STEP_LENGTH_s_")


def test_slip_within_tolerance_is_accepted():
    verdict = one(("joint slips 5 counts", 3100))
    assert verdict.outcome.accepted, verdict.outcome.text
    assert not verdict.wrong


def test_thousand_sound_poses_are_accepted():
    result = outcome(session(1, poses=1000))
    assert result.verdict == Verdict.ACCEPTED.value, result.text
    assert np.abs(result.z).max() < 4.0


def test_non_convergence_is_named_with_many_poses():
    result = outcome(spread_out(session(1, poses=MANY), np.s_[:, 5:], 50.0))
    assert result.verdict == Verdict.NOT_ACCEPTED.value
    assert "NOT_CONVERGED" in result.causes


@pytest.mark.parametrize("seed", [1, 2])
def test_ten_thousand_sound_poses_keep_the_scale(seed):
    result = outcome(session(seed, poses=10_000))
    assert result.verdict in (Verdict.ACCEPTED.value, Verdict.WITH_WARNINGS.value), result.text
    assert np.abs(result.error[[7, 8, 10, 11, 12]]).max() < 1.5e-3
    assert np.abs(result.z).max() < 6.0


def test_vibration_of_every_reading_is_the_only_cause():
    sound = session(1, poses=150)
    noise = stream(1, Stream.FAULTS).normal(size=sound.readings.shape)
    result = outcome(displaced(sound, ..., 0.15 * noise))
    assert result.causes == ("SCATTER",), result.text


def test_longer_forearm_is_named_in_a_large_set():
    specimen = session(1).specimen
    chain = specimen.chain.changed(s_5=specimen.chain.value("s_5") + 0.03)
    result = outcome(walked(replace(specimen, chain=chain), MANY))
    assert result.causes[0] in ("LENGTH_s_3", "LENGTH_s_5"), result.text


@pytest.mark.parametrize("poses", [1000, 3000])
@pytest.mark.parametrize("share", [0.01, 0.2, 0.3])
def test_outliers_of_a_large_set_are_named(share, poses):
    """Joint 2 reads 1 deg too much in a fifth of the poses, or a random joint is off by 0.5 deg in another share."""
    sound, rng = session(1, poses=poses), stream(1, Stream.FAULTS)
    affected = rng.choice(poses, round(share * poses), replace=False)
    joint, deg = 1, 1.0
    if share != 0.2:
        deg = 0.5 * rng.choice((-1.0, 1.0), len(affected))
        joint = rng.integers(7, size=len(affected))
    result = outcome(displaced(sound, (affected, joint), deg))
    assert result.causes[0] in ("OUTLIERS", "ENCODER_2"), result.text
