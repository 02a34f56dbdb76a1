"""Naming of causes: once, in words that follow their probability, and always if they block."""

from dataclasses import replace

import numpy as np
import pytest

from operator_app.calibration.acceptance import causes_of, each_once
from operator_app.messages.finding import Finding, FindingKind
from solver.diagnostics.diagnosis import CauseRanking, Explanation, diagnose
from solver.diagnostics.fault_candidate import Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.model_selection import evidence
from tests.oracles.as_shipped import ARM, SEED, fit_of
from tests.oracles.shop_floor import session


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
    """The diagnosis of the session."""
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
        Explanation(candidate=c, evidence=evidence_with(diagnosis, c, b=0.0), probability=0.15)
        for c in (*drifts[:5], *(c for c in candidates if c.cause is Cause.SCALE))
    ]
    gross = Explanation(
        candidate=drifts[5], evidence=evidence_with(diagnosis, drifts[5], b=0.1), probability=0.9
    )

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


@pytest.mark.parametrize(
    ("kind", "subject", "unlikely", "likely", "denied"),
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
    sound, diagnosis, kind, subject, unlikely, likely, denied
):
    chosen = next(
        c
        for c in diagnosis.faults.persistent_faults()
        if c.cause is kind and (not subject or str(c.subject) == subject)
    )
    for probability, words in ((0.04, unlikely), (0.96, likely)):
        explanation = Explanation(
            candidate=chosen,
            evidence=evidence_with(diagnosis, chosen, b=1e-7),
            probability=probability,
        )
        diagnosed = replace(diagnosis, rankings=(CauseRanking(known=(explanation,), unknown=0.0),))
        (cause,) = causes_of(diagnosed, sound.estimate, ("theta_off_2",), LABELS)
        assert words in cause.text, cause.text
        assert denied not in cause.text, cause.text


def evidence_with(diagnosis, candidate, *, b):
    """The evidence of a candidate, had its coefficients been `b` and moved no parameter."""
    result = evidence(
        diagnosis.residuals, candidate.columns, candidate.expected_size, own=candidate.own
    )
    return replace(result, b=np.full_like(result.b, b), moved=np.zeros_like(result.moved))
