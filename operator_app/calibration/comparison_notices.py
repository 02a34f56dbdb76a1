"""What a reader should know before believing a comparison of two calibrations. Knows no statistics."""

from __future__ import annotations

from operator_app.calibration.notices import Notice
from operator_app.config.parameter_records import REFUSED
from operator_app.config.parameters import ParametersDocument
from operator_app.units.figure import ANGLE, CHI2, LENGTH, Figure
from solver.chain.parameters import DhEntry, DhKind, wrap_angle

SAME_NOMINAL = 1e-9
"""Entries that neither calibration identified differ when they differ by more (rad, m)."""

SCALE_TOLD = 1.1
"""Standard deviations that were multiplied by more than this are said to have been."""


def notices(
    a: ParametersDocument, b: ParametersDocument, scales: tuple[float, float]
) -> tuple[Notice, ...]:
    """Return how the documents differ beside their parameters.

    `scales` are the factors on their standard deviations.
    """
    found: list[tuple[str, str]] = []
    if a.utc > b.utc:
        found.append(("ORDER", "B is older than A: changes go backwards in time"))
    if a.pose_set_sha256 == b.pose_set_sha256:
        text = "both are of the same poses: any difference is the estimator's, its options' or the program's"
        found.append(("SAME_POSES", text))
    if a.fixture.kind != b.fixture.kind:
        found.append(("FIXTURE_KIND", f"A used a {a.fixture.kind} fixture, B a {b.fixture.kind}"))
    elif a.fixture.name != b.fixture.name:
        found.append(("FIXTURE", f"A used fixture {a.fixture.name}, B {b.fixture.name}"))
    if a.estimator != b.estimator:
        text = (
            f"A was estimated by {a.estimator}, B by {b.estimator}: systematic errors of the sensors "
            "enter the two differently"
        )
        found.append(("ESTIMATOR", text))
    if {e.entry for e in a.calibrated} != {e.entry for e in b.calibrated}:
        text = "A and B did not identify the same entries: what one took as known moves the others"
        found.append(("ENTRIES", text))
    found += [("TABLE", text) for text in _changed_constants(a, b)]
    for name, document in (("A", a), ("B", b)):
        refused = (w for w in document.warnings if w.code in REFUSED)
        found += [(w.code, f"{name} was {w.text}") for w in refused]
    for name, scale in zip("AB", scales, strict=True):
        if scale > SCALE_TOLD:
            ratio, factor = CHI2(scale**2).shown, CHI2(scale).shown
            text = f"chi2/dof of {name} is {ratio}: its standard deviations were multiplied by {factor}"
            found.append(("CHI2", text))
    return tuple(Notice(code=code, text=text) for code, text in found)


def _changed_constants(a: ParametersDocument, b: ParametersDocument) -> list[str]:
    """Entries that were taken as known in both, and as different."""
    identified = {e.entry for e in (*a.calibrated, *b.calibrated)}
    one, other = a.table.stacked(), b.table.stacked()
    texts = []
    for kind in DhKind:
        for row in range(len(a.dh)):
            entry = DhEntry(kind, row)
            first, second = float(one[kind, row]), float(other[kind, row])
            change = float(wrap_angle(second - first)) if kind.is_angle else second - first
            if entry.name in identified or abs(change) <= SAME_NOMINAL:
                continue
            shown = [
                Figure(v, ANGLE if kind.is_angle else LENGTH, places=4) for v in (first, second)
            ]
            texts.append(
                f"{entry.name} was taken as {shown[0].with_unit} in A and {shown[1].with_unit} in B: "
                "the other parameters make up for it"
            )
    return texts
