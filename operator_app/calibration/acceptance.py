"""What a calibration is worth: accepted, accepted with warnings, or not, and the causes in order.

Joins what the tests say (`solver.diagnostics.diagnosis`) with what was known before and what the fit itself
shows. Knows results and words; computes no estimate.
"""

from __future__ import annotations

from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum

import numpy as np

from operator_app.calibration.causes import NamedCause, in_words, rms_displacement
from operator_app.calibration.likely import as_likely, perhaps
from operator_app.units.figure import (
    ANGLE_TOLERANCE,
    LENGTH_TOLERANCE,
    MANY_TIMES,
    TIMES,
)
from operator_app.units.numbers import plural
from solver.arrays import FloatArray
from solver.chain.parameters import Parameter
from solver.diagnostics.diagnosis import Diagnosis
from solver.diagnostics.fault_candidate import Candidate, Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.limits import (
    CHI2_PER_DOF_GROSS,
    CHI2_PER_DOF_REFUSED,
    COARSE_SIGMA_M,
    COARSE_SIGMA_RAD,
    FEW_DOF,
    MOST_CAUSES_REPORTED,
    MOST_COMPLIANCE_M,
    MOST_COMPLIANCE_RAD,
    POSSIBLE_CAUSE_PROBABILITY,
    REFUSED_DOF,
    REFUSING_SHIFT_SIGMAS,
    USELESS_SIGMA_M,
    USELESS_SIGMA_RAD,
)
from solver.diagnostics.model_selection import Evidence
from solver.estimators.estimate import Estimate

NOTHING_KNOWN: Mapping[str, float] = {}


class Verdict(Enum):
    """The three verdicts; only the first two upload."""

    ACCEPTED = "accepted"
    WITH_WARNINGS = "accepted_with_warnings"
    NOT_ACCEPTED = "not_accepted"

    @property
    def words(self) -> str:
        """As it is read."""
        return self.value.replace("accepted_with", "accepted, with").replace("_", " ")


@dataclass(frozen=True, slots=True, kw_only=True)
class Judgement:
    """A verdict with its reasons.

    Attributes
    ----------
    causes
        The most probable first.
    tests
        Every test that was made.
    stated_chi2_per_dof
        chi2/dof with the variances that the files state; None where it was not asked.
    astray
        What refuses it has led the solution where no file would have it: nothing may be advised from there.
    """

    causes: tuple[NamedCause, ...] = ()
    tests: tuple[HypothesisTest, ...] = ()
    stated_chi2_per_dof: float | None = None
    diverged: bool = field(default=False, metadata={"record": "astray"})

    @property
    def verdict(self) -> Verdict:
        """Not accepted as soon as one cause refuses."""
        if any(cause.refuses for cause in self.causes):
            return Verdict.NOT_ACCEPTED
        return Verdict.WITH_WARNINGS if self.causes else Verdict.ACCEPTED

    @property
    def reasons(self) -> tuple[str, ...]:
        """Why it is not accepted; empty when it is."""
        return tuple(f"{c.text}: {c.remedy}" for c in self.causes if c.refuses)


def causes_of(
    diagnosis: Diagnosis, estimate: Estimate, judged: tuple[str, ...], labels: tuple[str, ...]
) -> tuple[NamedCause, ...]:
    """Name what the tests found.

    Parameters
    ----------
    judged
        Names of the parameters whose sigmas have to hold: not those that were only toleranced.
    labels
        Of the poses in the order in which they were taken.
    """
    if estimate.dof < REFUSED_DOF:
        # Refused for that, and whatever else is read into so few poses may be chance.
        return ()
    unnamed = tuple(_unnamed(diagnosis))
    if unnamed and _left(diagnosis) > CHI2_PER_DOF_GROSS:
        return unnamed
    names = [p.name for p in estimate.parameters]
    here = [names.index(name) for name in judged]
    sd = estimate.standard_deviation[here]
    moved = diagnosis.parameter_shift[here].copy()
    found: list[NamedCause] = []
    for competing in diagnosis.rounds:
        # What may well have happened counts, and not only what is likeliest: their truths differ.
        possible = [
            np.abs((moved + x.evidence.moved[here]) / np.where(sd > 0.0, sd, 1.0)).max(initial=0.0)
            for x in competing
            if x.evidence is not None and x.probability >= POSSIBLE_CAUSE_PROBABILITY
        ]
        impact = float(max(possible, default=0.0))
        best = competing[0]
        if best.evidence is not None:
            moved = moved + best.evidence.moved[here]
        for x in competing:
            if x.candidate is None or x.evidence is None:
                continue
            code, text, remedy = in_words(x.candidate, x.evidence, diagnosis.scene, labels)
            found.append(
                NamedCause(
                    code=code,
                    probability=x.probability,
                    text=as_likely(text, x.probability),
                    remedy=remedy,
                    refuses=_refuses(x.candidate, x.evidence, estimate, impact),
                )
            )
    found.extend(unnamed)
    found.extend(_suspected_entries(diagnosis, labels))
    once = each_once(found)
    return tuple(c for k, c in enumerate(once) if k < MOST_CAUSES_REPORTED or c.refuses)


def _suspected_entries(diagnosis: Diagnosis, labels: tuple[str, ...]) -> Iterable[NamedCause]:
    """Say which entries may be off their file; that they are is not sure enough to refuse anything."""
    for x in diagnosis.suspected_entries:
        if x.candidate is not None and x.evidence is not None:
            code, text, remedy = in_words(x.candidate, x.evidence, diagnosis.scene, labels)
            yield NamedCause(
                code=code,
                probability=x.probability,
                text=perhaps(text),
                remedy=remedy,
                refuses=False,
            )


def _refuses(cause: Candidate, found: Evidence, estimate: Estimate, impact: float) -> bool:
    """Whether parameters may be wrong by more than their sigmas say, if this is what happened."""
    if cause.cause is Cause.FROZEN or impact > REFUSING_SHIFT_SIGMAS:
        return True
    # What was one value before and is another after: both have to be within what is claimed.
    names = [p.name for p in estimate.parameters]
    of_reading = cause.cause in (Cause.LOST_COUNTS, Cause.DRIFT)
    changed = (f"theta_off_{cause.subject}",) if of_reading else cause.entries
    sd = [
        float(estimate.standard_deviation[names.index(n)]) if n in names else np.inf
        for n in changed
    ]
    return any(abs(b) > REFUSING_SHIFT_SIGMAS * s for b, s in zip(found.b, sd, strict=False))


def _unnamed(diagnosis: Diagnosis) -> Iterable[NamedCause]:
    """Something is wrong that nothing here explains."""
    if not diagnosis.fires:
        return
    ratio, probability = _left(diagnosis), 1.0
    if diagnosis.rounds:
        last = diagnosis.rounds[-1][0]
        probability = last.probability
        if last.evidence is not None:
            if ratio <= CHI2_PER_DOF_REFUSED:
                return
            probability = 1.0 - sum(x.probability for x in diagnosis.rounds[-1] if x.candidate)
    fired = ", ".join(test.code for test in diagnosis.tests if test.fires)
    times = TIMES(float(np.sqrt(ratio))).shown
    remedy = (
        "check that arm file, fixture file and poses belong together, and what was done "
        "between the poses; try --global-start"
    )
    if ratio > CHI2_PER_DOF_GROSS:
        text = (
            f"these poses do not fit this arm and fixture: the readings scatter {times} times as much as "
            "the files state, and no fault of a joint, a length or a pose explains it"
        )
        remedy = (
            f"they may be of another arm, of another fixture or of an arm changed since: {remedy}"
        )
    elif ratio > 1.0:
        text = (
            f"the readings scatter {times} times as much as the files state and no single fault "
            "explains it"
        )
    else:
        text = (
            f"the readings scatter no more than the files state, but not as they would by chance ({fired}), "
            "and no single fault explains it"
        )
    yield NamedCause(
        code="UNNAMED",
        probability=max(0.0, probability),
        text=text,
        remedy=remedy,
        refuses=ratio > CHI2_PER_DOF_REFUSED,
    )


def _left(diagnosis: Diagnosis) -> float:
    """chi2/dof that is left by the best explanation of the last round, if there is one."""
    last = diagnosis.rounds[-1][0].evidence if diagnosis.rounds else None
    if last is None or _impossible_compliance(diagnosis):
        return diagnosis.stated_chi2_per_dof
    return last.chi2 / max(last.dof, 1)


def _impossible_compliance(diagnosis: Diagnosis) -> bool:
    """Whether what explains it best is a fixture that gives as no metal does: that fits anything."""
    best = diagnosis.rounds[0][0]
    if best.candidate is None or best.evidence is None or best.candidate.cause is not Cause.GIVES:
        return False
    turn, shift = rms_displacement(best.candidate, best.evidence, diagnosis.scene)
    return shift > MOST_COMPLIANCE_M or turn > MOST_COMPLIANCE_RAD


def each_once(causes: Iterable[NamedCause]) -> tuple[NamedCause, ...]:
    """Every code once: what is found again after it was taken out was not all taken out.

    One that refuses goes on refusing.
    """
    found: dict[str, NamedCause] = {}
    for cause in causes:
        first = found.setdefault(cause.code, cause)
        if cause.refuses and not first.refuses:
            found[cause.code] = replace(first, refuses=True)
    return tuple(found.values())


def too_few_poses(estimate: Estimate) -> tuple[NamedCause, ...]:
    """Say that so few poses cannot show what is wrong: whatever else is said of them may be chance."""
    if estimate.dof >= FEW_DOF:
        return ()
    return (
        NamedCause(
            code="TOO_FEW_POSES",
            probability=1.0,
            text=f"{plural(estimate.dof, 'degree')} of freedom {'is' if estimate.dof == 1 else 'are'} too few to "
            "tell whether anything is wrong",
            remedy="take at least 20 poses",
            refuses=estimate.dof < REFUSED_DOF,
        ),
    )


def fit_causes(
    estimate: Estimate,
    judged: tuple[str, ...],
    known: Mapping[str, float] = NOTHING_KNOWN,
    narrows: Callable[[str], str] | None = None,
) -> tuple[NamedCause, ...]:
    """Name what the fit itself shows: that it did not converge, that its sigmas are of no use."""
    found = []
    if not estimate.converged:
        found.append(
            NamedCause(
                code="NOT_CONVERGED",
                probability=1.0,
                text=f"the iteration did not settle in {estimate.iterations} rounds",
                remedy="look at the warnings for what the readings have wrong, or try --global-start",
                refuses=True,
            )
        )
    return (
        *found,
        *little_motion(estimate.parameters, estimate.standard_deviation, judged, known, narrows),
    )


def little_motion(
    parameters: tuple[Parameter, ...],
    standard_deviation: FloatArray,
    judged: tuple[str, ...],
    known: Mapping[str, float] = NOTHING_KNOWN,
    narrows: Callable[[str], str] | None = None,
) -> tuple[NamedCause, ...]:
    """Name the parameters whose sigmas (P,) say little, because the poses differ little.

    Parameters
    ----------
    known
        How well (rad, m) files state some of the parameters, by name. A sigma beyond that is named; it
        refuses when it is of no use to anybody.
    narrows
        What to do about one parameter's sigma beside other poses; empty where nothing else makes it so wide.
    """
    wide, coarse, refuses = [], [], False
    worst, farthest = "", 0.0
    for p, sd in zip(parameters, standard_deviation, strict=True):
        if p.name not in judged:
            continue
        size = f"{p.name} ({_with_unit(float(sd), angle=p.is_angle)})"
        worthless = USELESS_SIGMA_RAD if p.is_angle else USELESS_SIGMA_M
        if not sd <= min(worthless, known.get(p.name, np.inf)):
            wide.append(size)
            refuses |= not sd <= worthless
        elif sd > (COARSE_SIGMA_RAD if p.is_angle else COARSE_SIGMA_M):
            coarse.append(size)
        else:
            continue
        over = sd / (COARSE_SIGMA_RAD if p.is_angle else COARSE_SIGMA_M)
        if not over <= farthest:
            worst, farthest = p.name, over
    if not wide and not coarse:
        return ()
    return (
        NamedCause(
            code="LITTLE_MOTION",
            probability=1.0,
            text=f"these poses tell {', '.join((*wide, *coarse)[:4])} "
            f"{'no better than was known before' if wide else 'only roughly'}: standard "
            "deviations in brackets",
            remedy=(narrows(worst) if narrows is not None else "")
            or "take more poses that differ more: every joint through a larger part of its range",
            refuses=refuses,
        ),
    )


def _with_unit(value: float, *, angle: bool) -> str:
    if not np.isfinite(value):
        return "unknown"
    return (ANGLE_TOLERANCE if angle else LENGTH_TOLERANCE)(value).with_unit


def paper_test(
    paper: Estimate, implicit: Estimate
) -> tuple[HypothesisTest, tuple[NamedCause, ...]]:
    """Test the paper's estimate by its distance from the implicit one, in sigmas of the difference."""
    z = distance_in_sigmas(paper, implicit)
    worst = int(np.argmax(z))
    test = HypothesisTest.of_sigmas("PAPER_DISTANCE", z)
    if not test.fires:
        return test, ()
    p = paper.parameters[worst]
    parameter_shift = abs(float(paper.x[worst]) - implicit.value(p.name))
    return test, (
        NamedCause(
            code="PAPER_OFF",
            probability=1.0,
            text=f"{p.name} by the paper's estimator is {_with_unit(parameter_shift, angle=p.is_angle)} "
            f"({MANY_TIMES(float(z[worst])).shown} sigmas) from what weighing every reading by its noise gives",
            remedy="use --estimator implicit",
            refuses=True,
        ),
    )


def distance_in_sigmas(one: Estimate, two: Estimate) -> FloatArray:
    """Distance of every parameter of `one` from `two`, in sigmas of the difference (P,)."""
    names = [p.name for p in two.parameters]
    here = [names.index(p.name) for p in one.parameters]
    parameter_shift = one.x - two.x[here]
    angles = np.array([p.is_angle for p in one.parameters])
    parameter_shift = np.where(
        angles, np.arctan2(np.sin(parameter_shift), np.cos(parameter_shift)), parameter_shift
    )
    sd = np.hypot(one.standard_deviation, two.standard_deviation[here])
    return np.asarray(np.abs(parameter_shift) / np.where(sd > 0.0, sd, 1e-300))
