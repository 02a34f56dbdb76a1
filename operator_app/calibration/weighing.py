"""From a fit to its verdict: what was known before, what the tests say, what else would explain it.

Knows calibrations, files' objects and verdicts; no screen. Solves anew only when a test fires.
"""

from __future__ import annotations

from dataclasses import dataclass

from fixtures.base import Fixture, SetupCheck, Severity
from operator_app.calibration.causes import NamedCause
from operator_app.calibration.judgement import range_text
from operator_app.calibration.loop import pick
from operator_app.calibration.other_basins import other_basin
from operator_app.calibration.repeats import Repeat, Reread
from operator_app.calibration.rivals import named_rivals
from operator_app.calibration.verdict import (
    UNNAMED_SCALE,
    Judgement,
    causes_of,
    of_the_fit,
    paper_test,
    return_tests,
    too_few,
)
from solver.arrays import IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import Calibrated
from solver.judging.ranges import Fault, RangeFinding
from solver.judging.rvdt import RvdtVerdict, Soundness
from solver.judging.trial import Trial, judge
from solver.search.global_start import GlobalStart

FLIPPED_SHARE = 0.25
"""With more of the poses on the other branch nobody knows which branch is meant."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Known:
    """What was seen before and beside the fit.

    Attributes
    ----------
    out_of_range, flipped
        Readings the arm file does not allow, and poses with the hand upside down.
    checks
        The fixture's geometry as it was found.
    search
        The global start, where one was asked for.
    rvdt
        What the loops say of each RVDT.
    returned
        Poses that were read again, and what that says.
    """

    out_of_range: tuple[RangeFinding, ...] = ()
    flipped: tuple[int, ...] = ()
    checks: tuple[SetupCheck, ...] = ()
    search: GlobalStart | None = None
    rvdt: tuple[RvdtVerdict, ...] = ()
    returned: tuple[tuple[Reread, Repeat], ...] = ()


def weigh(
    found: Calibrated,
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    distinct: IntArray,
    *,
    judged: tuple[str, ...],
    known: Known,
    paper: Estimate | None = None,
) -> Judgement:
    """Judge a fit.

    Parameters
    ----------
    poses, distinct
        All poses, and the indices of those that the fit was made of, in the order they were taken.
    judged
        Names of the parameters whose sigmas have to hold.
    paper
        The paper's estimate, where that is to be judged.
    """
    judging = found.estimate if paper is None else paper
    used = pick(poses, distinct)
    trial = judge(found.linear, arm, taken=found.order)
    model = found.linear.design.model
    unsensed = model.unsensed_joints
    scale = trial.left.chi2 / max(trial.left.dof, 1)
    gross = _left(trial) > UNNAMED_SCALE
    by_tests = causes_of(trial, found.estimate, judged, _labels(used))
    rivals: tuple[NamedCause, ...] = ()
    if gross:
        # Linear explanations end where nothing is near the truth any more.
        rivals = named_rivals(
            arm, fixture, used, unsensed=unsensed, scale=scale, dof=trial.left.dof
        )
        by_tests = rivals or by_tests
    elif not by_tests:
        by_tests = _of_rvdts(known.rvdt)
    far = (
        other_basin(model, found.estimate, used.q_rad, judged)
        if known.search is None and not unsensed
        else ()
    )
    if far and not gross:
        # It fits, but is it the arm of the files? A mistake that fits as well and is near them is likelier.
        far = (
            *named_rivals(
                arm, fixture, used, unsensed=unsensed, scale=scale, dof=trial.left.dof, near=True
            ),
            *far,
        )
    of_returns, since = return_tests(known.returned, found.estimate)
    tests = (*trial.tests, *of_returns)
    of_paper: tuple[NamedCause, ...] = ()
    if paper is not None:
        test, of_paper = paper_test(paper, found.estimate)
        tests = (*tests, test)
    return Judgement(
        causes=(
            *_beforehand(poses, known),
            *too_few(judging),
            *(() if gross else (*_of_geometry(known.checks), *far)),
            *by_tests,
            *_not_yet_named(since, by_tests),
            *(far if gross and not rivals else ()),
            *of_paper,
            *of_the_fit(judging, judged),
        ),
        tests=tests,
        stated_chi2_per_dof=scale,
    )


def _labels(poses: PoseSet) -> tuple[str, ...]:
    """Labels of poses, with the placement where each of several has a pose 1."""
    if len(poses.placements) == 1:
        return poses.label
    return tuple(
        f"{label} of placement {number}"
        for label, number in zip(poses.label, poses.placement, strict=True)
    )


def _not_yet_named(
    since: tuple[NamedCause, ...], by_tests: tuple[NamedCause, ...]
) -> tuple[NamedCause, ...]:
    """What only a return shows: the poses themselves say when a joint or the fixture slipped."""
    subjects = tuple(cause.code.rsplit("_", 1)[-1] for cause in by_tests)
    fixture = any(cause.code in ("SLIP_FIXTURE", "FIXTURE_GIVES") for cause in by_tests)
    return tuple(
        cause
        for cause in since
        if not (fixture if cause.code == "RETURN_FIXTURE" else cause.code[-1] in subjects)
    )


def _left(trial: Trial) -> float:
    """chi2/dof that the best single explanation leaves."""
    if not trial.rounds or trial.rounds[0][0].evidence is None:
        return trial.left.chi2 / max(trial.left.dof, 1)
    found = trial.rounds[0][0].evidence
    return found.chi2 / max(found.dof, 1)


def _beforehand(poses: PoseSet, known: Known) -> tuple[NamedCause, ...]:
    """What needs no test: it was read off the file, or off the geometry."""
    found = []
    for f in known.out_of_range:
        saturated = f.fault is Fault.SATURATED
        text, remedy = range_text(f, poses.label)
        code = f"{'SATURATED' if saturated else 'RANGE'}_{f.joint}"
        found.append(_certain(code, text, remedy, refuses=saturated))
    if known.flipped:
        share = len(known.flipped) / len(poses)
        found.append(
            _certain(
                "FLIPPED_BRANCH",
                f"{len(known.flipped)} of {len(poses)} poses close only with the hand upside down "
                "on the hinge; they were left out",
                "take them again with the hand the right way up, or remove them",
                refuses=share > FLIPPED_SHARE,
            )
        )
    if known.search is not None and known.search.rivals:
        found.append(
            _certain(
                "SECOND_SOLUTION",
                f"{1 + len(known.search.rivals)} distinct solutions fit these poses equally well",
                "take more poses that differ, or give nominal values nearer the truth",
                refuses=True,
            )
        )
    return tuple(found)


def _of_geometry(checks: tuple[SetupCheck, ...]) -> tuple[NamedCause, ...]:
    """A fixture so mounted that its entries have hardly any unique values (Hayati)."""
    return tuple(
        _certain("PARALLEL_AXES", c.text, c.remedy, refuses=c.severity is Severity.REFUSED)
        for c in checks
        if c.code.startswith("AXIS_ANGLE") and c.severity is not Severity.OK
    )


def _of_rvdts(verdicts: tuple[RvdtVerdict, ...]) -> tuple[NamedCause, ...]:
    """RVDTs out of specification where nothing else is wrong: the sigmas count their curves in."""
    return tuple(
        NamedCause(
            code=f"RVDT_{v.joint}",
            probability=1.0,
            text=v.text,
            remedy=f"have it replaced or linearised, or calibrate with --unsensed {v.joint}",
            refuses=False,
        )
        for v in verdicts
        if v.verdict is Soundness.OUT_OF_SPECIFICATION
    )


def _certain(code: str, text: str, remedy: str, *, refuses: bool) -> NamedCause:
    return NamedCause(code=code, probability=1.0, text=text, remedy=remedy, refuses=refuses)
