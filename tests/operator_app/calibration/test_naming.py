"""What tests explain is named: once, in words as sure as it is likely, and never without what refuses."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.acceptance import causes_of, each_once
from operator_app.messages.finding import Finding, FindingKind
from solver.diagnostics.diagnosis import CauseRanking, Explanation, diagnose
from solver.diagnostics.fault_candidate import Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.model_selection import evidence, evidence_of_own
from tests.oracles.as_shipped import ARM, SEED, fit_of
from tests.oracles.shop_floor import session


def test_repeated_finding_is_kept_once_and_stays_blocking():
    first = Finding(kind=FindingKind.ENCODER_CYCLIC_ERROR, joint=1, sensor="ENCODER", size=0.064)
    other = Finding(kind=FindingKind.OUTLIERS, poses=("3",))
    again = replace(first, size=0.058, blocking=True)
    assert each_once([first, other, again]) == (replace(first, blocking=True), other)


LABELS = tuple(str(k) for k in range(40))


@pytest.fixture(scope="module")
def made():
    return fit_of(session(SEED))


@pytest.fixture(scope="module")
def trial(made):
    """What the tests say of the session."""
    return diagnose(made.linear, ARM, taken=made.order)


def test_unexplained_pattern_is_reported_without_blocking(trial, made):
    by_chance = replace(trial, tests=(HypothesisTest(code="STEP", statistic=9.0, threshold=8.0),))
    (cause,) = causes_of(by_chance, made.estimate, ("theta_off_2",), LABELS)
    assert cause.code == "UNNAMED"
    assert not cause.blocking
    assert cause.kind is FindingKind.UNEXPLAINED_PATTERN
    assert cause.names == ("STEP",)
    assert causes_of(trial, made.estimate, ("theta_off_2",), LABELS) == ()


def test_blocking_cause_is_named_after_many_slight_ones(sound, trial):
    """Five that move nothing compete in the first round; what is found in the second one moves joint 6 far."""
    some = [c for c in trial.faults.persistent_faults() if c.cause in (Cause.DRIFT, Cause.SCALE)]
    drifts = [c for c in some if c.cause is Cause.DRIFT]
    slight = [
        Explanation(candidate=c, evidence=weighed(trial, c, b=0.0), probability=0.15)
        for c in (*drifts[:5], *(c for c in some if c.cause is Cause.SCALE))
    ]
    gross = Explanation(
        candidate=drifts[5], evidence=weighed(trial, drifts[5], b=0.1), probability=0.9
    )

    def named(first):
        both = replace(
            trial,
            rankings=(
                CauseRanking(known=tuple(first), unknown=0.0),
                CauseRanking(known=(gross,), unknown=0.0),
            ),
        )
        found = causes_of(both, sound.estimate, ("theta_off_2",), LABELS)
        return [(cause.code, cause.blocking) for cause in found]

    five = [(f"DRIFT_JOINT_{j}", False) for j in (1, 2, 3, 4, 5)]
    assert named(slight[:4]) == [*five[:4], ("DRIFT_JOINT_6", True)]
    assert named(slight[:5]) == [*five, ("DRIFT_JOINT_6", True)]
    assert named(slight) == [*five, ("DRIFT_JOINT_6", True)]


@pytest.mark.parametrize(
    ("kind", "subject", "may", "does", "denied"),
    [
        (
            Cause.GIVES,
            "",
            "the fixture may move by about 0.0",
            "the fixture moves by about 0.0",
            "0.0 mm",
        ),
        (
            Cause.LENGTH,
            "s_2",
            "s_2 may differ from the arm file by",
            "s_2 differs from the arm file by",
            " 0.0 mm",
        ),
        (Cause.DRIFT, "2", "joint 2 may drift by about", "joint 2 drifts by about", "0.0000 deg"),
        (Cause.SCALE, "2", "encoder may be off by about", "encoder is off by about", "0.0 %"),
    ],
)
def test_cause_wording_follows_its_probability(
    sound, trial, kind, subject, may, does, denied
):
    chosen = next(
        c
        for c in trial.faults.persistent_faults()
        if c.cause is kind and (not subject or str(c.subject) == subject)
    )
    for chance, words in ((0.04, may), (0.96, does)):
        one = Explanation(
            candidate=chosen, evidence=weighed(trial, chosen, b=1e-7), probability=chance
        )
        ranked = replace(trial, rankings=(CauseRanking(known=(one,), unknown=0.0),))
        (cause,) = causes_of(ranked, sound.estimate, ("theta_off_2",), LABELS)
        assert words in cause.text, cause.text
        assert denied not in cause.text, cause.text


def weighed(trial, candidate, *, b):
    """Its evidence, had its coefficients come out as `b` and moved no parameter."""
    if candidate.own is None:
        found = evidence(trial.residuals, candidate.columns, candidate.expected_size)
    else:
        found = evidence_of_own(
            trial.residuals, candidate.own, candidate.columns, candidate.expected_size
        )
    return replace(found, b=np.full_like(found.b, b), moved=np.zeros_like(found.moved))
