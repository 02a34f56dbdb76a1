"""Differences between two parameter documents that qualify a comparison of them."""

from __future__ import annotations

from operator_app.config.parameter_records import REFUSED
from operator_app.config.parameters import ParametersDocument
from operator_app.messages.finding import Finding, FindingKind
from solver.chain.parameters import DhEntry, DhKind, wrap_angle

SAME_NOMINAL = 1e-9
"""Entries that neither calibration identified differ when they differ by more (rad, m)."""

REPORTED_SCALE = 1.1
"""Standard deviations that were multiplied by more than this are said to have been."""


def notices(
    a: ParametersDocument, b: ParametersDocument, scales: tuple[float, float]
) -> tuple[Finding, ...]:
    """Return how the documents differ beside their parameters.

    `scales` are the factors on their standard deviations.
    """
    K, found = FindingKind, []
    if a.utc > b.utc:
        found.append(Finding(kind=K.COMPARED_BACKWARDS))
    if a.pose_set_sha256 == b.pose_set_sha256:
        found.append(Finding(kind=K.COMPARED_SAME_POSES))
    for kind, one, other in (
        (K.COMPARED_FIXTURE_KINDS, a.fixture.kind, b.fixture.kind),
        (K.COMPARED_FIXTURES, a.fixture.name, b.fixture.name),
    ):
        if one != other:
            found.append(Finding(kind=kind, names=(one, other)))
            break
    if a.estimator != b.estimator:
        found.append(Finding(kind=K.COMPARED_ESTIMATORS, names=(a.estimator, b.estimator)))
    if {e.entry for e in a.calibrated} != {e.entry for e in b.calibrated}:
        found.append(Finding(kind=K.COMPARED_ENTRIES))
    found += _changed_constants(a, b)
    found += [
        Finding(kind=K.COMPARED_REFUSED, names=(w.code, name), reported=(w.text,))
        for name, document in (("A", a), ("B", b))
        for w in document.warnings
        if w.code in REFUSED
    ]
    found += [
        Finding(kind=K.COMPARED_SCALED, names=(name,), size=scale, figures={"ratio": scale**2})
        for name, scale in zip("AB", scales, strict=True)
        if scale > REPORTED_SCALE
    ]
    return tuple(found)


def _changed_constants(a: ParametersDocument, b: ParametersDocument) -> list[Finding]:
    """Entries that were taken as known in both, and as different."""
    identified = {e.entry for e in (*a.calibrated, *b.calibrated)}
    one, other = a.table.stacked(), b.table.stacked()
    found = []
    for kind in DhKind:
        for row in range(len(a.dh)):
            entry = DhEntry(kind, row)
            first, second = float(one[kind, row]), float(other[kind, row])
            change = float(wrap_angle(second - first)) if kind.is_angle else second - first
            if entry.name in identified or abs(change) <= SAME_NOMINAL:
                continue
            found.append(
                Finding(
                    kind=FindingKind.COMPARED_CONSTANT,
                    names=(entry.name,),
                    unit="rad" if kind.is_angle else "m",
                    figures={"a": first, "b": second},
                )
            )
    return found
