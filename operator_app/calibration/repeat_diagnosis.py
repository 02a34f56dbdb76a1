"""Tests of repeated poses against the stated error model, and the cause that each supports."""

from __future__ import annotations

from dataclasses import replace

from operator_app.calibration.repeat_measurement import Repeat, Reread
from operator_app.messages.finding import Finding, FindingKind
from solver.diagnostics.diagnosis import PRIORS
from solver.diagnostics.fault_candidate import Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.limits import (
    REFUSING_SHIFT_SIGMAS,
    REPEAT_REFUSAL_PROBABILITY,
)
from solver.estimators.estimate import Estimate

READING_KINDS = {
    FindingKind.READING_STEP,
    FindingKind.READING_JUMP,
    FindingKind.READING_DRIFT,
    FindingKind.READING_FROZEN,
}
"""Causes that concern one joint's reading, other than those of its sensor."""


def return_tests(
    returned: tuple[tuple[Reread, Repeat], ...], estimate: Estimate
) -> tuple[tuple[HypothesisTest, ...], tuple[Finding, ...]]:
    """Test every repeated pose against the stated errors; return what slipped."""
    tests, causes = [], []
    for read, found in returned:
        test = HypothesisTest.of_chi2(
            f"RETURN_{read.after}", found.chi2, found.dof, among=len(returned)
        )
        tests.append(test)
        if test.fires:
            causes.append(_slipped_since(read, found, estimate))
    # A slip shows in every later repeat: it is reported once.
    once = {cause.code: cause for cause in reversed(causes)}
    return tuple(tests), tuple(reversed(once.values()))


def proven_by_return(
    since: tuple[Finding, ...], by_tests: tuple[Finding, ...]
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Return the causes proven by repeated poses, and the tests' other causes; a cause named by both blocks.

    From the poses alone a slip may not exceed the sigmas, because it has widened them.
    """
    proven: list[Finding] = []
    for returned in since:
        if not returned.blocking:
            continue
        same = [c for c in by_tests if not not_yet_named((returned,), (c,))]
        proven += [replace(c, blocking=True) for c in same] or [returned]
    codes = {cause.code for cause in proven}
    return tuple(proven), tuple(c for c in by_tests if c.code not in codes)


def not_yet_named(since: tuple[Finding, ...], by_tests: tuple[Finding, ...]) -> tuple[Finding, ...]:
    """Return causes that only a repeated pose shows, without slips that the tests have found already.

    A compliant fixture or a wrong length is no slip.
    """
    slipped = any(cause.kind is FindingKind.FIXTURE_SLIPPED for cause in by_tests)
    joints = {c.joint for c in by_tests if c.sensor or c.kind in READING_KINDS}
    return tuple(
        cause
        for cause in since
        if not (
            slipped if cause.kind is FindingKind.REPEAT_FIXTURE_MOVED else cause.joint in joints
        )
    )


def _slipped_since(read: Reread, found: Repeat, estimate: Estimate) -> Finding:
    """Return what slipped between two readings of a pose."""
    from scipy.special import chdtri

    # A slip may be in any joint; a fixture can slip on two sides, and may deflect.
    of_joint = PRIORS[Cause.LOST_COUNTS] / len(found.difference_rad)
    odds = found.joint_odds * of_joint / (PRIORS[Cause.SLIPPED] + PRIORS[Cause.GIVES])
    share = odds / (1.0 + odds)
    if share < 0.5:
        return Finding(
            kind=FindingKind.REPEAT_FIXTURE_MOVED,
            poses=(read.label,),
            figures={
                "after": read.after,
                "turn_rad": found.turned_rad or 0.0,
                "shift_m": found.shifted_m,
            },
            probability=1.0 - share,
            blocking=True,
        )
    names = [p.name for p in estimate.parameters]
    name = f"theta_off_{found.joint}"
    sd = float(estimate.standard_deviation[names.index(name)]) if name in names else 0.0
    return Finding(
        kind=FindingKind.REPEAT_READING_STEP,
        joint=found.joint,
        poses=(read.label,),
        size=found.size_rad,
        sigma=found.sigma_rad,
        unit="rad",
        figures={"after": read.after},
        probability=share,
        blocking=abs(found.size_rad) > REFUSING_SHIFT_SIGMAS * sd
        or found.chi2 > float(chdtri(found.dof, REPEAT_REFUSAL_PROBABILITY)),
    )
