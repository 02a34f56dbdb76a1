"""Verdict of a calibration, and the causes that its tests, sigmas and repeated poses support."""

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace
from enum import Enum
from types import MappingProxyType

import numpy as np

from operator_app.calibration.findings import exceeded_source, finding_of, rms_displacement
from operator_app.calibration.repeat_measurement import Repeat
from operator_app.messages.finding import Finding, FindingKind, NamedSize
from solver.chain.parameters import wrap_angles
from solver.diagnostics import limits
from solver.diagnostics.diagnosis import Diagnosis
from solver.diagnostics.fault_models import Cause
from solver.diagnostics.hypothesis_tests import HypothesisTest
from solver.diagnostics.model_selection import Explanation
from solver.diagnostics.statistics import chi2_limit
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import Calibrated


class Verdict(Enum):
    """Verdict on a calibration; it allows an upload unless it is NOT_ACCEPTED."""

    ACCEPTED = "accepted"
    WITH_WARNINGS = "accepted_with_warnings"
    NOT_ACCEPTED = "not_accepted"

    @property
    def words(self) -> str:
        """The verdict as text."""
        return self.value.replace("accepted_with", "accepted, with").replace("_", " ")


@dataclass(frozen=True, slots=True, kw_only=True)
class Adjudication:
    """A verdict with its reasons.

    `causes`: causes of a misfit, the main cause first.
    `stated_chi2_per_dof`: chi2/dof with the variances that the files state; None if not computed.
    `diverged`: whether the solution has diverged far from the files' values, so that no advice can be based on it.
    """

    causes: tuple[Finding, ...] = ()
    tests: tuple[HypothesisTest, ...] = ()
    stated_chi2_per_dof: float | None = None
    diverged: bool = field(default=False, metadata={"record": "astray"})

    @property
    def verdict(self) -> Verdict:
        """The verdict: not accepted if any cause blocks."""
        if any(cause.blocking for cause in self.causes):
            return Verdict.NOT_ACCEPTED
        return Verdict.WITH_WARNINGS if self.causes else Verdict.ACCEPTED

    @property
    def reasons(self) -> tuple[str, ...]:
        """Texts of the causes that block acceptance; empty if none does."""
        return tuple(c.sentence for c in self.causes if c.blocking)


def causes_of(
    diagnosis: Diagnosis, estimate: Estimate, judged: tuple[str, ...], labels: tuple[str, ...]
) -> tuple[Finding, ...]:
    """Return the causes of a misfit that the tests support.

    `judged`: names of the parameters that decide on acceptance, i.e. all except those that are only corrected within
    tolerances. `labels`: labels of the poses in the order in which they were taken.
    """
    if estimate.dof < limits.REFUSED_DOF:
        # Too few poses already block acceptance; any other finding from them may be chance.
        return ()
    unnamed = tuple(_unnamed(diagnosis))
    if unnamed and _left(diagnosis) > limits.CHI2_PER_DOF_GROSS:
        return unnamed
    names = [p.name for p in estimate.parameters]
    columns = [names.index(name) for name in judged]
    sd = estimate.standard_deviation[columns]
    scale = np.where(sd > 0.0, sd, 1.0)
    shift = diagnosis.parameter_shift[columns].copy()
    findings: list[Finding] = []
    for compared in diagnosis.rankings:
        # Every possible cause counts, not only the most likely: each implies other true values.
        possible = [
            np.abs((shift + x.moved[columns]) / scale).max(initial=0.0)
            for x in compared.known
            if x.probability >= limits.POSSIBLE_CAUSE_PROBABILITY
        ]
        impact = float(max(possible, default=0.0))
        if compared.best is not None:
            shift = shift + compared.best.moved[columns]
        for x in compared.known:
            finding = finding_of(x, diagnosis.faults, labels)
            findings.append(replace(finding, blocking=_refuses(x, estimate, impact)))
    findings.extend(unnamed)
    # Entries that may be wrong in their file; the evidence is too weak to block acceptance.
    findings.extend(
        replace(finding_of(x, diagnosis.faults, labels), doubted=True)
        for x in diagnosis.suspected_entries
    )
    once = each_once(findings)
    return tuple(c for k, c in enumerate(once) if k < limits.MOST_CAUSES_REPORTED or c.blocking)


def _refuses(x: Explanation, estimate: Estimate, impact: float) -> bool:
    cause = x.candidate
    if cause.cause is Cause.FROZEN or impact > limits.REFUSING_SHIFT_SIGMAS:
        return True
    # If the cause changed a value, the old and the new value have to agree within the stated uncertainty.
    of_reading = cause.cause in (Cause.LOST_COUNTS, Cause.DRIFT)
    changed = (f"theta_off_{cause.subject}",) if of_reading else cause.entries
    sd = estimate.sd_by_name
    return any(
        abs(b) > limits.REFUSING_SHIFT_SIGMAS * sd.get(name, np.inf)
        for b, name in zip(x.b, changed, strict=False)
    )


def _unnamed(diagnosis: Diagnosis) -> Iterable[Finding]:
    """Yield the finding of an unexplained misfit, if a test fires but no known cause explains the misfit well."""
    if not diagnosis.fires:
        return
    ratio, probability = _left(diagnosis), 1.0
    # Causes that leave a gross misfit do not compete: none of them is right.
    if diagnosis.rankings and ratio <= limits.CHI2_PER_DOF_GROSS:
        last = diagnosis.rankings[-1]
        probability = last.unknown
        if last.best is not None:
            if ratio <= limits.CHI2_PER_DOF_REFUSED:
                return
            probability = 1.0 - sum(x.probability for x in last.known)
    kind = FindingKind.UNEXPLAINED_PATTERN
    if ratio > limits.CHI2_PER_DOF_GROSS:
        kind = FindingKind.POSES_DO_NOT_FIT
    elif ratio > 1.0:
        kind = FindingKind.UNEXPLAINED_SCATTER
    yield Finding(
        kind,
        names=tuple(test.code for test in diagnosis.tests if test.fires),
        figures={"times": float(np.sqrt(ratio))},
        probability=max(0.0, probability),
        blocking=ratio > limits.CHI2_PER_DOF_REFUSED,
    )


def _left(diagnosis: Diagnosis) -> float:
    """Return chi2/dof of the fit with the best causes added, or without any cause if none is credible."""
    last = diagnosis.rankings[-1].best if diagnosis.rankings else None
    if last is None or _impossible_compliance(diagnosis):
        return diagnosis.stated_chi2_per_dof
    return last.chi2_per_dof


def _impossible_compliance(diagnosis: Diagnosis) -> bool:
    """Whether the best explanation is a fixture more compliant than any metal, which would fit almost any data."""
    best = diagnosis.best
    if best is None or best.candidate.cause is not Cause.GIVES:
        return False
    size = rms_displacement(best, diagnosis.faults)
    return (
        size["shift_m"] > limits.MOST_COMPLIANCE_M or size["turn_rad"] > limits.MOST_COMPLIANCE_RAD
    )


def each_once(causes: Iterable[Finding]) -> tuple[Finding, ...]:
    """Return one finding for each code; it blocks if any finding of that code blocks.

    A code occurs twice if a cause also explains best the misfit that remains after it has been fitted.
    """
    by_code: dict[str, Finding] = {}
    for cause in causes:
        first = by_code.setdefault(cause.code, cause)
        if cause.blocking and not first.blocking:
            by_code[cause.code] = replace(first, blocking=True)
    return tuple(by_code.values())


def too_few_poses(estimate: Estimate) -> tuple[Finding, ...]:
    """Return the finding that the poses are too few for a diagnosis; empty if they suffice."""
    dof, kind = estimate.dof, FindingKind.TOO_FEW_POSES
    few = Finding(kind, size=dof, blocking=dof < limits.REFUSED_DOF)
    return (few,) if dof < limits.FEW_DOF else ()


def little_motion(
    estimate: Estimate,
    known: Mapping[str, float] = MappingProxyType({}),
    fit: Calibrated | None = None,
) -> tuple[Finding, ...]:
    """Return the finding that poses differ too little to determine some parameters; empty if all sigmas are small.

    The finding names each parameter of `estimate` whose sigma is large: above fixed limits, or above the sigma that a
    file states for it (`known`, by name). The finding blocks if a parameter is too uncertain for any use.
    `fit`: fit that shows which error source should be reduced; None if there is none.
    """
    wide, coarse, refuses = [], [], False
    worst, farthest = "", 0.0
    for p, sd in zip(estimate.parameters, estimate.standard_deviation, strict=True):
        size = NamedSize(name=p.name, size=float(sd), unit=p.unit)
        worthless = limits.USELESS_SIGMA_RAD if p.is_angle else limits.USELESS_SIGMA_M
        over = sd / (limits.COARSE_SIGMA_RAD if p.is_angle else limits.COARSE_SIGMA_M)
        if not sd <= min(worthless, known.get(p.name, np.inf)):
            wide.append(size)
            refuses |= not sd <= worthless
        elif over > 1.0:
            coarse.append(size)
        else:
            continue
        if not over <= farthest:
            worst, farthest = p.name, over
    if not wide and not coarse:
        return ()
    source = "" if fit is None else exceeded_source(fit, worst)
    names = (source,) if source else ()
    kind = FindingKind.SIGMAS_USELESS if wide else FindingKind.SIGMAS_WIDE
    return (Finding(kind, sizes=(*wide, *coarse), names=names, blocking=refuses),)


def paper_test(
    paper: Estimate, implicit: Estimate
) -> tuple[tuple[HypothesisTest, ...], tuple[Finding, ...]]:
    """Test the paper's estimate against the implicit one; return the test, and a finding if they disagree."""
    names = [p.name for p in implicit.parameters]
    columns = [names.index(p.name) for p in paper.parameters]
    apart = wrap_angles(paper.parameters, paper.x - implicit.x[columns])
    sd = np.hypot(paper.standard_deviation, implicit.standard_deviation[columns])
    z = np.abs(apart) / np.where(sd > 0.0, sd, 1e-300)
    worst = int(np.argmax(z))
    test = HypothesisTest.of_sigmas("PAPER_DISTANCE", z)
    p = paper.parameters[worst]
    finding = Finding(
        FindingKind.PAPER_OFF,
        names=(p.name,),
        size=abs(float(apart[worst])),
        unit=p.unit,
        figures={"sigmas": float(z[worst])},
        blocking=True,
    )
    return (test,), (finding,) if test.fires else ()


READING_KINDS = {
    FindingKind.READING_STEP,
    FindingKind.READING_JUMP,
    FindingKind.READING_OR_TARGET_STEP,
    FindingKind.READING_DRIFT,
    FindingKind.READING_FROZEN,
}
"""Kinds of findings about one joint's reading; they do not name the type of the joint's sensor."""


def return_tests(
    returned: tuple[Repeat, ...], estimate: Estimate
) -> tuple[tuple[HypothesisTest, ...], tuple[Finding, ...]]:
    """Test each repeated pose for a slip beyond the stated errors; return the tests, and one finding for each slip."""
    tests, causes = [], []
    for repeat in returned:
        code = f"RETURN_{repeat.read.after}"
        test = HypothesisTest.of_chi2(code, repeat.chi2, repeat.dof, among=len(returned))
        tests.append(test)
        if test.fires:
            causes.append(_slipped_since(repeat, estimate))
    # A slip shows in every later repeat: it is reported once.
    once = {cause.code: cause for cause in reversed(causes)}
    return tuple(tests), tuple(reversed(once.values()))


def proven_by_return(
    by_repeats: tuple[Finding, ...], by_tests: tuple[Finding, ...]
) -> tuple[tuple[Finding, ...], tuple[Finding, ...]]:
    """Return the proven causes, and the other causes that tests of the fit found (`by_tests`).

    `by_repeats`: causes that repeated poses found. Those of them that block acceptance are proven. If tests of the fit
    found the same cause, their finding is returned in its place. It then blocks acceptance however small the error is
    in sigmas, because the fault has widened the sigmas.
    """
    proven: list[Finding] = []
    for returned in (c for c in by_repeats if c.blocking):
        same = [c for c in by_tests if not not_yet_named((returned,), (c,))]
        proven += [replace(c, blocking=True) for c in same] or [returned]
    codes = {cause.code for cause in proven}
    return tuple(proven), tuple(c for c in by_tests if c.code not in codes)


SLIP_KINDS = frozenset(
    {FindingKind.FIXTURE_SLIPPED, FindingKind.INSTRUMENT_MOVED, FindingKind.TARGET_MOVED}
)
"""Steps of a fixture, an instrument or a target from one pose to the next."""


def not_yet_named(
    by_repeats: tuple[Finding, ...], by_tests: tuple[Finding, ...]
) -> tuple[Finding, ...]:
    """Return the causes that repeated poses found (`by_repeats`) and no test of the fit (`by_tests`) confirms.

    A movement of the fixture is confirmed by a slip of fixture, instrument or target, but not by compliance. A step of
    a joint's reading is confirmed by any error of this joint's sensor or reading, but not by a wrong length.
    """
    slipped = any(cause.kind in SLIP_KINDS for cause in by_tests)
    joints = {c.joint for c in by_tests if c.sensor or c.kind in READING_KINDS}
    return tuple(
        c
        for c in by_repeats
        if not (slipped if c.kind is FindingKind.REPEAT_FIXTURE_MOVED else c.joint in joints)
    )


def _slipped_since(repeat: Repeat, estimate: Estimate) -> Finding:
    read = repeat.read
    # Prior odds: a step in one of n joints, against a slip or a deflection of the fixture.
    of_joint = Cause.LOST_COUNTS.prior / len(repeat.difference_rad)
    odds = repeat.joint_odds * of_joint / (Cause.SLIPPED.prior + Cause.GIVES.prior)
    share = odds / (1.0 + odds)
    if share < 0.5:
        return Finding(
            FindingKind.REPEAT_FIXTURE_MOVED,
            poses=(read.label,),
            figures={
                "after": read.after,
                "turn_rad": repeat.turned_rad or 0.0,
                "shift_m": repeat.shifted_m,
            },
            probability=1.0 - share,
            blocking=True,
        )
    sd = estimate.sd_by_name.get(f"theta_off_{repeat.joint}", 0.0)
    return Finding(
        FindingKind.REPEAT_READING_STEP,
        joint=repeat.joint,
        poses=(read.label,),
        size=repeat.size_rad,
        sigma=repeat.sigma_rad,
        unit="rad",
        figures={"after": read.after},
        probability=share,
        blocking=abs(repeat.size_rad) > limits.REFUSING_SHIFT_SIGMAS * sd
        or bool(repeat.chi2 > chi2_limit(repeat.dof, limits.REPEAT_REFUSAL_PROBABILITY)),
    )
