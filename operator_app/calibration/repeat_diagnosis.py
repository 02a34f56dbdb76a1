"""Tests of repeated poses against the stated error model, and the cause that each supports."""

from __future__ import annotations

from dataclasses import replace

from operator_app.calibration.causes import NamedCause
from operator_app.calibration.repeat_measurement import Repeat, Reread
from operator_app.units.figure import POSITION, SHIFTED, SLIP_SIGMA, TURNED
from solver.diagnostics.diagnosis import PRIORS
from solver.diagnostics.fault_candidate import Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.limits import (
    REFUSING_SHIFT_SIGMAS,
    REPEAT_REFUSAL_PROBABILITY,
)
from solver.estimators.estimate import Estimate

OF_A_READING = ("STEP_JOINT_", "DRIFT_JOINT_", "FROZEN_JOINT_", "ENCODER_", "RVDT_")
"""Codes of causes that are one joint's reading."""


def return_tests(
    returned: tuple[tuple[Reread, Repeat], ...], estimate: Estimate
) -> tuple[tuple[HypothesisTest, ...], tuple[NamedCause, ...]]:
    """Test every pose that was read again, by what the files state; name what slipped."""
    tests, causes = [], []
    for read, found in returned:
        test = HypothesisTest.of_chi2(
            f"RETURN_{read.after}", found.chi2, found.dof, among=len(returned)
        )
        tests.append(test)
        if test.fires:
            causes.append(_slipped_since(read, found, estimate))
    # What slipped once is off in every return since: once is enough.
    once = {cause.code: cause for cause in reversed(causes)}
    return tuple(tests), tuple(reversed(once.values()))


def proven_by_return(
    since: tuple[NamedCause, ...], by_tests: tuple[NamedCause, ...]
) -> tuple[tuple[NamedCause, ...], tuple[NamedCause, ...]]:
    """Take out what a return proves, and what is left of the tests' causes: what was named refuses then.

    By the poses alone a slip may move no parameter by more than its sigmas, which are as wide as it made them.
    """
    proven: list[NamedCause] = []
    for returned in since:
        if not returned.refuses:
            continue
        same = [c for c in by_tests if not not_yet_named((returned,), (c,))]
        proven += [replace(c, refuses=True) for c in same] or [returned]
    codes = {cause.code for cause in proven}
    return tuple(proven), tuple(c for c in by_tests if c.code not in codes)


def not_yet_named(
    since: tuple[NamedCause, ...], by_tests: tuple[NamedCause, ...]
) -> tuple[NamedCause, ...]:
    """What only a return shows: the poses themselves say when a joint or the fixture slipped.

    That a fixture gives in every pose, or that a length is off, says nothing of a slip.
    """
    named = [cause.code for cause in by_tests]
    joints = {code.rpartition("_")[2] for code in named if code.startswith(OF_A_READING)}
    return tuple(
        cause
        for cause in since
        if not (
            "SLIP_FIXTURE" in named
            if cause.code == "RETURN_FIXTURE"
            else cause.code.rpartition("_")[2] in joints
        )
    )


def _slipped_since(read: Reread, found: Repeat, estimate: Estimate) -> NamedCause:
    """Say what slipped between two readings of a pose."""
    from scipy.special import chdtri

    where = f"between pose {read.label} and its second reading after {read.after} poses"
    # A slip may be any joint's; a fixture has two sides to slip on, and may give.
    of_joint = PRIORS[Cause.LOST_COUNTS] / len(found.difference_rad)
    odds = found.joint_odds * of_joint / (PRIORS[Cause.SLIPPED] + PRIORS[Cause.GIVES])
    share = odds / (1.0 + odds)
    if share < 0.5:
        turn = f" and {TURNED(found.turned_rad).with_unit}" if found.turned_rad else ""
        return NamedCause(
            code="RETURN_FIXTURE",
            probability=1.0 - share,
            text=f"the fixture moved by about {SHIFTED(found.shifted_m).with_unit}{turn} {where}, more than "
            "its file states that it gives",
            remedy="tighten its bolts and look for play, then take all poses again; else state its "
            "give in the fixture file",
            refuses=True,
        )
    names = [p.name for p in estimate.parameters]
    name = f"theta_off_{found.joint}"
    sd = float(estimate.standard_deviation[names.index(name)]) if name in names else 0.0
    return NamedCause(
        code=f"RETURN_JOINT_{found.joint}",
        probability=share,
        text=f"the reading of joint {found.joint} shifted by {POSITION(found.size_rad).with_unit} "
        f"(sigma {SLIP_SIGMA(found.sigma_rad).with_unit}) {where}",
        remedy=f"check the coupling and cable of joint {found.joint}'s sensor (lost counts, a slipped "
        "coupling), home the joint and take all poses again",
        refuses=abs(found.size_rad) > REFUSING_SHIFT_SIGMAS * sd
        or found.chi2 > float(chdtri(found.dof, REPEAT_REFUSAL_PROBABILITY)),
    )
