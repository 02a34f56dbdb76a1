"""Comparison of two calibrations of one arm: changes of parameters, and which of them exceed noise.

Up to eight parameter vectors describe the same hinge loop. So the second document's vector is first replaced by the
equivalent vector nearest to the first document's. A difference counts as drift if it is too large for the sigmas of
both documents, at a level corrected for the number of parameters (Bonferroni). The arm's lengths and twists are not
counted, because their sigma is mostly the tolerance. Two estimates from the same poses never show drift.
"""

import math
from collections.abc import Iterable, Mapping
from dataclasses import dataclass
from enum import Enum

import numpy as np

from operator_app.config.parameter_records import REFUSED
from operator_app.config.parameters_file import ParametersDocument
from operator_app.errors import SessionError
from operator_app.messages.finding import Finding, FindingKind
from solver.chain.parameters import DhEntry, DhKind, wrap_angle
from solver.diagnostics.limits import DRIFT_FALSE_ALARM_PROBABILITY
from solver.diagnostics.statistics import sigmas_at
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop


class IncomparableError(SessionError):
    """The documents are not from one arm or share no parameter, as `reasons` state."""

    def __init__(self, reasons: tuple[str, ...]) -> None:
        self.reasons = reasons
        super().__init__(
            f"these calibrations cannot be compared: {'; '.join(reasons)}",
            "compare two calibrations of one arm",
        )


class Side(Enum):
    """Part that a parameter describes: the arm, or the fixture on the table (`GROUND`) or on the tool (`HAND`).

    Parameters of the fixture change with every mounting. They include the offsets of the first and the last joint,
    which are measured from the fixture's axis.
    """

    ARM = "arm"
    GROUND = "ground side of the fixture"
    HAND = "tool side of the fixture"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParameterChange:
    """One parameter in two calibrations, SI units.

    `before`: value in the first calibration. `after`: value in the second, or the equivalent value nearest to `before`.
    `change`: after minus before, for angles at most half a turn. `sigma`: standard deviation of the change.
    `significant`: whether the change exceeds noise at the level of the comparison. It is false for two estimates from
    the same poses, because both contain the same noise.
    """

    name: str
    is_angle: bool
    side: Side = Side.ARM
    before: float
    after: float
    change: float
    sigma: float
    significant: bool

    @property
    def sigmas(self) -> float:
        """Magnitude of the change in standard deviations; infinite if the standard deviation is zero."""
        if self.sigma > 0.0:
            return abs(self.change) / self.sigma
        return 0.0 if self.change == 0.0 else math.inf


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibrationComparison:
    """Result of the comparison of two calibrations of one arm.

    `drifts`: one entry for each parameter that both calibrations identified and that can be compared.
    `level`: probability of any false alarm. `threshold_sigmas`: smallest significant change, in standard deviations.
    `scale_before`, `scale_after`: factor applied to each document's standard deviations: sqrt(chi2/dof), at least 1.
    `left_out`: parameters that were not compared, with the reason.
    """

    before: ParametersDocument
    after: ParametersDocument
    drifts: tuple[ParameterChange, ...]
    level: float
    threshold_sigmas: float
    scale_before: float
    scale_after: float
    left_out: tuple[tuple[str, str], ...]
    notices: tuple[Finding, ...]

    @property
    def same_poses(self) -> bool:
        """Whether both are estimates from the same poses, which cannot show a change of the arm."""
        return self.before.pose_set_sha256 == self.after.pose_set_sha256

    @property
    def drifted(self) -> tuple[ParameterChange, ...]:
        """Significant changes, largest first."""
        return significant_changes(self.drifts)


def significant_changes(changes: Iterable[ParameterChange]) -> tuple[ParameterChange, ...]:
    """Return the significant changes, the largest (in sigmas) first."""
    return tuple(sorted((d for d in changes if d.significant), key=lambda d: -d.sigmas))


def compare(
    before: ParametersDocument,
    after: ParametersDocument,
    *,
    level: float = DRIFT_FALSE_ALARM_PROBABILITY,
    remounted: bool = False,
) -> CalibrationComparison:
    """Compare two calibrations.

    `level`: probability (0 to 1, otherwise `ValueError`) of reporting a drift although nothing changed. `remounted`:
    the fixture was taken off in between, so that only the arm's own parameters are compared. Raises
    `IncomparableError` if the calibrations are not of the same arm, or have no parameter in common.
    """
    if not 0.0 < level < 1.0:
        raise ValueError("a level lies between 0 and 1")
    if reasons := _different_arms(before, after):
        raise IncomparableError(reasons)
    later = {e.entry: e.sigma for e in after.calibrated}
    values = nearest_values(before, after)
    sides = sides_of(before)
    left_out = _not_compared(before, after, sides, remounted=remounted)
    skipped = {name for name, _ in left_out}
    compared = [e for e in before.calibrated if e.entry not in skipped]
    if not compared:
        raise IncomparableError(("they have no parameter in common that could be compared",))
    # Lengths and twists of the arm itself are only known within the maker's tolerance.
    free = [
        e
        for e in compared
        if DhEntry.parse(e.entry).kind is DhKind.THETA_OFF or sides[e.entry] is not Side.ARM
    ]
    threshold = sigmas_at(level, len(free))
    scales = _scale(before), _scale(after)
    stacked, same = before.table.stacked(), before.pose_set_sha256 == after.pose_set_sha256
    drifts = []
    for item in compared:
        entry = DhEntry.parse(item.entry)
        angle = entry.kind.is_angle
        a, b = float(stacked[entry.kind, entry.row]), values[item.entry]
        sigma = math.hypot(scales[0] * item.sigma, scales[1] * later[item.entry])
        sigma = math.radians(sigma) if angle else sigma
        change = float(wrap_angle(b - a)) if angle else b - a
        # Where no noise is stated every difference is real, except for rounding.
        real = not same and abs(change) > max(threshold * sigma, 1e-12)
        drifts.append(
            ParameterChange(
                name=item.entry,
                is_angle=angle,
                side=sides[item.entry],
                before=a,
                after=b,
                change=change,
                sigma=sigma,
                significant=real,
            )
        )
    return CalibrationComparison(
        before=before,
        after=after,
        drifts=tuple(drifts),
        level=level,
        threshold_sigmas=threshold,
        scale_before=scales[0],
        scale_after=scales[1],
        left_out=tuple(left_out),
        notices=notices(before, after, scales),
    )


def _not_compared(
    before: ParametersDocument,
    after: ParametersDocument,
    sides: Mapping[str, Side],
    *,
    remounted: bool,
) -> list[tuple[str, str]]:
    first, second = ([e.entry for e in d.calibrated] for d in (before, after))
    listed = [(name, "identified in A only") for name in first if name not in second]
    listed += [(name, "identified in B only") for name in second if name not in first]
    other_fixture = before.fixture != after.fixture
    if other_fixture or remounted:
        reason = "another fixture" if other_fixture else "the fixture was remounted"
        listed += [(n, reason) for n in first if n in second and sides[n] is not Side.ARM]
    return listed


def _different_arms(a: ParametersDocument, b: ParametersDocument) -> tuple[str, ...]:
    reasons = []
    if a.arm.model != b.arm.model:
        reasons.append(f"A is from a {a.arm.model}, B from a {b.arm.model}")
    elif len(a.joints) != len(b.joints):
        reasons.append(f"A has {len(a.joints)} joints, B {len(b.joints)}")
    if a.arm.serial != b.arm.serial:
        reasons.append(
            f"A is from the arm with serial {a.arm.serial}, B from {b.arm.serial} (for "
            "imported poses, state the serial number with sarcal import --serial)"
        )
    return tuple(reasons)


def _loop(document: ParametersDocument) -> DhLoop:
    """Return the loop that a document describes.

    The first or last joint counts as unsensed if its offset was not identified. Otherwise, `DhLoop.equivalents` would
    omit the equivalent vectors that have opposite signs of a and alpha in the fixture's link and change this offset.
    """
    entries = tuple(DhEntry.parse(e.entry) for e in document.calibrated)
    known = {e.name for e in entries}
    n = len(document.joints)
    return DhLoop(
        table=document.table,
        entries=entries,
        hinge=document.fixture.kind == "hinge",
        unsensed_joints=tuple(j for j in sorted({1, n}) if f"theta_off_{j}" not in known),
    )


def nearest_values(a: ParametersDocument, b: ParametersDocument) -> dict[str, float]:
    """Return the identified entries of `b` (rad, m), by name, as the equivalent values nearest to those in `a`."""
    loop = _loop(b)
    rows_a, rows_b = a.table.stacked(), b.table.stacked()
    x = np.array([rows_b[e.kind, e.row] for e in loop.entries])
    reference = np.array([rows_a[e.kind, e.row] for e in loop.entries])
    nearest = nearest_equivalent(loop, x, reference)
    return {e.name: float(v) for e, v in zip(loop.entries, nearest, strict=True)}


def sides_of(document: ParametersDocument) -> dict[str, Side]:
    """Return the side of each calibrated entry, by name: arm, or ground or tool side of the fixture.

    Documents of version 1 state no sides: their sides are derived from the D-H loop that they describe.
    """
    loop = _loop(document)
    sides = {e.name: Side.ARM for e in loop.entries}
    sides |= dict.fromkeys(loop.ground_side, Side.GROUND)
    sides |= dict.fromkeys(loop.hand_side, Side.HAND)
    return sides | {e.entry: Side[e.side.upper()] for e in document.calibrated if e.side}


def _scale(document: ParametersDocument) -> float:
    """Return the factor, at least 1, by which the residuals exceed the noise model."""
    ratio = document.quality.chi2_per_dof
    return 1.0 if ratio is None else math.sqrt(max(1.0, ratio))


SAME_NOMINAL = 1e-9
"""Fixed entries of two calibrations count as different if they differ by more than this (rad, m)."""

REPORTED_SCALE = 1.1
"""A factor on standard deviations is reported if it exceeds this value."""


def notices(
    a: ParametersDocument, b: ParametersDocument, scales: tuple[float, float]
) -> tuple[Finding, ...]:
    """Return notices of what differs between the documents, apart from the identified parameters.

    `scales`: factors by which the comparison multiplies the standard deviations of `a` and `b`.
    """
    K, findings = FindingKind, []
    if a.utc > b.utc:
        findings.append(Finding(K.COMPARED_BACKWARDS))
    if a.pose_set_sha256 == b.pose_set_sha256:
        findings.append(Finding(K.COMPARED_SAME_POSES))
    for kind, one, other in (
        (K.COMPARED_FIXTURE_KINDS, a.fixture.kind, b.fixture.kind),
        (K.COMPARED_FIXTURES, a.fixture.name, b.fixture.name),
    ):
        if one != other:
            findings.append(Finding(kind, names=(one, other)))
            break
    if a.estimator != b.estimator:
        findings.append(Finding(K.COMPARED_ESTIMATORS, names=(a.estimator, b.estimator)))
    if {e.entry for e in a.calibrated} != {e.entry for e in b.calibrated}:
        findings.append(Finding(K.COMPARED_ENTRIES))
    findings += _changed_constants(a, b)
    findings += [
        Finding(K.COMPARED_REFUSED, names=(w.code, name), reported=(w.text,))
        for name, document in (("A", a), ("B", b))
        for w in document.warnings
        if w.code in REFUSED
    ]
    findings += [
        Finding(K.COMPARED_SCALED, names=(name,), size=scale, figures={"ratio": scale**2})
        for name, scale in zip("AB", scales, strict=True)
        if scale > REPORTED_SCALE
    ]
    return tuple(findings)


def _changed_constants(a: ParametersDocument, b: ParametersDocument) -> list[Finding]:
    identified = {e.entry for e in (*a.calibrated, *b.calibrated)}
    one, other = a.table.stacked(), b.table.stacked()
    findings = []
    for entry in (DhEntry(kind, row) for kind in DhKind for row in range(len(a.dh))):
        angle = entry.kind.is_angle
        first, second = (float(table[entry.kind, entry.row]) for table in (one, other))
        change = float(wrap_angle(second - first)) if angle else second - first
        if entry.name not in identified and abs(change) > SAME_NOMINAL:
            figures, unit = {"a": first, "b": second}, "rad" if angle else "m"
            kind = FindingKind.COMPARED_CONSTANT
            findings.append(Finding(kind, names=(entry.name,), unit=unit, figures=figures))
    return findings
