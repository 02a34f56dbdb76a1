"""Verdicts and causes: faults of the shop floor in sound sessions, and the names of their causes."""

import re
from dataclasses import replace

import numpy as np
import pytest

from fixtures.base import Tolerance
from operator_app.calibration.acceptance import Verdict, causes_of, each_once, paper_test
from operator_app.calibration.calibrate import calibrate
from operator_app.messages.finding import Finding, FindingKind
from operator_app.report.text import unidentifiable_text
from solver.diagnostics.diagnosis import CauseRanking, diagnose
from solver.diagnostics.fault_models import Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.model_selection import evidence
from solver.errors import UnidentifiableDirection, UnidentifiableError
from tests.oracles.as_shipped import ARM, HINGE, SEED, displaced, fit_of, poses_of, solved
from tests.oracles.shop_floor import Specimen, session, walked
from tests.oracles.shop_floor_faults import CASES


def test_sound_session_is_accepted_with_stated_false_alarm_rates(sound):
    assert sound.verdict is Verdict.ACCEPTED
    assert sound.causes == ()
    codes = [t.code for t in sound.adjudication.tests]
    assert {"CHI2_STATED", "STEP", "POSE", "PULL", "PULLS", "PREDICTION"} <= set(codes)
    for test in sound.adjudication.tests:
        assert not test.fires
        assert 0.0 < test.false_alarm < 0.01
    assert sound.adjudication.stated_chi2_per_dof is not None


def test_fixture_tolerances_bound_sigmas_that_poses_leave_wide(sound):
    lengths = ("a_0", "s_0", "s_1", "a_7", "s_7")
    before = sound.estimate.sd_by_name
    # Nominal values are those of this fixture, within the stated tolerance.
    nominal = {f"{n.replace('7', 'n')}_m": sound.estimate.value(n) for n in lengths}
    tolerance = Tolerance(position_m=0.5e-3, orientation_rad=np.deg2rad(5.0))
    fixture = replace(HINGE, **nominal, tolerance=tolerance)
    solution = calibrate(ARM, fixture, poses_of(session(SEED)))
    assert solution.verdict is Verdict.ACCEPTED
    wide = {n for n in lengths if before[n] > 0.5e-3}
    assert 0 < len(wide) < 5
    assert all(solution.estimate.sd_by_name[n] < 0.5e-3 for n in lengths)
    (notice,) = [n.text for n in solution.warnings if n.code == "AS_STATED"]
    named = {n for n in lengths if f"{n} (" in notice}
    assert named == {n for n in lengths if solution.shares[n] < 0.5}
    assert {n for n in wide if before[n] > 0.7e-3} <= named


def test_scatter_of_means_is_compared_with_stated_noise_of_means():
    """Joint 6 scatters ten times as much as the mean of 32 readings of 2 LSB."""
    stated = np.sqrt(ARM.joints[5].sensor.variance_of_mean_rad2(32))
    noise = 10.0 * np.rad2deg(stated) * np.random.default_rng(5).standard_normal(40)
    causes = solved(displaced(session(SEED, poses=40), np.s_[:, 5], noise)).causes
    (cause,) = [c for c in causes if c.kind is FindingKind.READING_NOISE]
    assert 6.0 <= cause.figures["times"] <= 14.5


def test_joint_slip_is_the_first_cause_with_size_and_remedy_if_poses_are_in_order():
    case = CASES["joint slips 1 deg"](SEED)
    solution = solved(case.taken)
    assert solution.verdict is not Verdict.ACCEPTED
    first = solution.causes[0]
    assert (first.code,) == case.causes
    assert abs(first.size) == pytest.approx(np.deg2rad(1.0), rel=0.1)
    ((name, offset_rad),) = case.either.items()
    assert case.taken.truth[name] - offset_rad == pytest.approx(first.size, rel=0.1)
    assert first.remedy
    assert first.probability > 0.5
    shuffled = case.taken.picked(np.random.default_rng(0).permutation(40))
    assert not solved(shuffled).causes[0].code.startswith("STEP")


def test_fixture_slip_is_located_between_two_poses():
    specimen = Specimen.drawn(SEED, session(SEED).specimen.sizes)
    slip = np.array([0.0, 0.0, 0.0, 2e-3, 2e-3, 1e-3])
    solution = solved(walked(specimen, slipped=(23, slip, np.zeros(6))))
    assert solution.causes[0].code == "SLIP_FIXTURE"
    assert solution.causes[0].poses == ("p023", "p024")


def test_uncertain_length_error_warns_without_blocking():
    solution = solved(CASES["elbow 5 mm"](3005).taken)
    assert not any(test.fires for test in solution.adjudication.tests)
    assert solution.verdict is Verdict.WITH_WARNINGS
    assert {c.code for c in solution.causes} == {"LENGTH_s_3", "LENGTH_s_5"}
    assert not any(c.certain for c in solution.causes)


def test_too_few_poses_are_refused_or_warned_of_and_blame_no_part():
    causes = solved(displaced(session(SEED, poses=3), (1, 3), 3.0)).causes
    assert {c.code for c in causes} <= {"TOO_FEW_POSES", "LITTLE_MOTION", "NOT_CONVERGED"}
    assert (causes[0].code, causes[0].size) == ("TOO_FEW_POSES", 1), "degrees of freedom"
    four, seven = (solved(session(3006, poses=n)) for n in (4, 7))
    assert four.verdict is Verdict.NOT_ACCEPTED
    assert four.causes[0].code == seven.causes[0].code == "TOO_FEW_POSES"
    assert not seven.causes[0].blocking


def test_stuck_sensor_is_distinguished_from_immobile_joint():
    case = CASES["RVDT stuck"](SEED)
    with pytest.raises(UnidentifiableError, match="its sensor is stuck") as error:
        solved(case.taken)
    assert any(re.fullmatch(pattern, error.value.code) for pattern in case.causes)


def test_paper_estimate_is_refused_if_its_distance_test_fires():
    solution = solved(session(SEED), estimator="paper")
    test = next(t for t in solution.adjudication.tests if t.code == "PAPER_DISTANCE")
    assert (solution.verdict is Verdict.NOT_ACCEPTED) == test.fires


def test_distance_of_the_paper_estimate_is_less_than_half_a_turn(sound):
    implicit = sound.estimate
    joint = [p.name for p in implicit.parameters].index("theta_off_3")
    paper = replace(implicit, x=implicit.x + np.deg2rad(359.0) * np.eye(len(implicit.x))[joint])
    _, (finding,) = paper_test(paper, implicit)
    assert finding.size == pytest.approx(np.deg2rad(1.0))


def test_gross_outlier_is_refused_though_variances_grow():
    """One reading of 13 poses is off by 3 degrees."""
    adjudication = solved(displaced(session(SEED, poses=13), (3, 3), 3.0)).adjudication
    assert adjudication.stated_chi2_per_dof > 20.0
    assert adjudication.causes[0].code == "OUTLIERS"
    assert adjudication.verdict is Verdict.NOT_ACCEPTED


@pytest.mark.parametrize(("joints", "remedy"), [((4,), "leave it out"), ((4, 5), "leave them out")])
def test_immobile_joints_are_reported_with_the_drop_option(joints, remedy):
    directions = tuple(
        UnidentifiableDirection(
            parameters=(f"theta_off_{j}",), weights=(1.0,), immobile_joints=(j,)
        )
        for j in joints
    )
    text = " ".join(unidentifiable_text(UnidentifiableError(directions)).split())
    assert "--drop-unidentifiable of solve and import" in text
    assert remedy in text


def test_repeated_finding_is_kept_once_and_stays_blocking():
    first = Finding(kind=FindingKind.ENCODER_CYCLIC_ERROR, joint=1, sensor="ENCODER", size=0.064)
    other = Finding(kind=FindingKind.OUTLIERS, poses=("3",))
    repeated = replace(first, size=0.058, blocking=True)
    assert each_once([first, other, repeated]) == (replace(first, blocking=True), other)


LABELS = tuple(str(k) for k in range(40))


@pytest.fixture(scope="module")
def fit():
    return fit_of(session(SEED))


@pytest.fixture(scope="module")
def diagnosis(fit):
    return diagnose(fit.linear, ARM, taken=fit.order)


def test_unexplained_pattern_is_reported_without_blocking(diagnosis, fit):
    unexplained = replace(
        diagnosis, tests=(HypothesisTest(code="STEP", statistic=9.0, threshold=8.0),)
    )
    (cause,) = causes_of(unexplained, fit.estimate, ("theta_off_2",), LABELS)
    assert cause.code == "UNNAMED"
    assert not cause.blocking
    assert cause.kind is FindingKind.UNEXPLAINED_PATTERN
    assert cause.names == ("STEP",)
    assert causes_of(diagnosis, fit.estimate, ("theta_off_2",), LABELS) == ()


def test_blocking_cause_is_named_after_many_slight_ones(sound, diagnosis):
    """Five slight causes compete in the first round; joint 6 drifts far in the second."""
    candidates = [
        c for c in diagnosis.faults.persistent_faults() if c.cause in (Cause.DRIFT, Cause.SCALE)
    ]
    drifts = [c for c in candidates if c.cause is Cause.DRIFT]
    slight = [
        explanation(diagnosis, c, b=0.0, probability=0.15)
        for c in (*drifts[:5], *(c for c in candidates if c.cause is Cause.SCALE))
    ]
    gross = explanation(diagnosis, drifts[5], b=0.1, probability=0.9)

    def names_after(first):
        both = replace(
            diagnosis,
            rankings=(
                CauseRanking(known=tuple(first), unknown=0.0),
                CauseRanking(known=(gross,), unknown=0.0),
            ),
        )
        causes = causes_of(both, sound.estimate, ("theta_off_2",), LABELS)
        return [(cause.code, cause.blocking) for cause in causes]

    five = [(f"DRIFT_JOINT_{j}", False) for j in (1, 2, 3, 4, 5)]
    assert names_after(slight[:4]) == [*five[:4], ("DRIFT_JOINT_6", True)]
    assert names_after(slight[:5]) == [*five, ("DRIFT_JOINT_6", True)]
    assert names_after(slight) == [*five, ("DRIFT_JOINT_6", True)]


def explanation(diagnosis, candidate, *, b, probability):
    """By a candidate, had its coefficients been `b` and moved no parameter."""
    x = evidence(diagnosis.residuals, candidate)
    b, moved = np.full_like(x.b, b), np.zeros_like(x.moved)
    return replace(x, b=b, moved=moved, probability=probability)
