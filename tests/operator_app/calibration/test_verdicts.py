"""Faults are named and not accepted unnamed. One arm per case; tests/benchmarks/verdicts.py has twenty."""

import pytest

from tests.benchmarks.shop_floor_outcome import CRASHED
from tests.benchmarks.verdicts import one

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

pytestmark = pytest.mark.campaign
"""Cases whose cause must come first. The benchmark has the others."""


@pytest.mark.parametrize("name", SURE)
def test_fault_is_named_first_and_not_accepted_unnamed(name):
    verdict = one((name, 3100))
    assert verdict.outcome.verdict != CRASHED, verdict.outcome.said
    assert not verdict.accepted_wrong
    assert verdict.first, (verdict.outcome.causes, verdict.outcome.said)


def test_slip_within_tolerance_is_accepted():
    verdict = one(("joint slips 5 counts", 3100))
    assert verdict.outcome.accepted, verdict.outcome.said
    assert not verdict.wrong
