"""A comparison of two calibrations as text and as JSON."""

import math
from collections.abc import Iterator, Sequence
from typing import Any

from operator_app.calibration.comparison import CalibrationComparison, ParameterChange, Side
from operator_app.config.parameters_file import ParametersDocument
from operator_app.report.calibration_json import notices_data
from operator_app.report.parameter_tables import formats_of
from operator_app.report.table import Cell, FactTable, figures, shown, words
from operator_app.report.text import paragraph, table_lines, warnings_text
from operator_app.units import Figure, in_json, quantity_of

CALCULATION_CODES = {"ESTIMATOR", "ENTRIES", "TABLE"}
"""Codes of notices about differences in the calculation, which change parameters even if the arm has not changed."""


def comparison_text(comparison: CalibrationComparison) -> str:
    """Return the comparison as text for a terminal of 80 columns, the verdict first."""
    table = _table(comparison)
    blocks = [
        _verdict(comparison, table),
        f"{_document_text('A', comparison.before)}\n{_document_text('B', comparison.after)}",
        "\n".join(table_lines(table)),
        paragraph(_reading(comparison)),
        _left_out(comparison),
        warnings_text(comparison.notices),
    ]
    return "\n\n".join(block for block in blocks if block)


def comparison_json(comparison: CalibrationComparison) -> dict[str, Any]:
    """Return the object that `sarcal compare --json` prints; angles in deg, lengths in m."""
    verdict = "drifted" if comparison.drifted else "no significant drift"
    if comparison.same_poses:
        verdict = "same poses: nothing follows for the arm"
    return {
        "verdict": verdict,
        "drifted": [d.name for d in comparison.drifted],
        "level": comparison.level,
        "threshold_sigmas": comparison.threshold_sigmas,
        "parameters": {
            d.name: {
                **change_data(d, "a", "b"),
                "sigmas": d.sigmas if math.isfinite(d.sigmas) else None,
                "significant": d.significant,
                "side": d.side.name.lower(),
            }
            for d in comparison.drifts
        },
        "left_out": dict(comparison.left_out),
        "a": _document_json(comparison.before, comparison.scale_before),
        "b": _document_json(comparison.after, comparison.scale_after),
        "warnings": notices_data(comparison.notices),
    }


def _reading(comparison: CalibrationComparison) -> str:
    change = "Change = B - A, angles the short way round."
    if comparison.same_poses:
        return f"{change} Sigma applies to new poses; it is not used for the verdict here."
    return (
        f"Significant: a change of more than {comparison.threshold_sigmas:.2f} sigmas. By noise alone, any "
        f"parameter exceeds this in {100.0 * comparison.level:g} % of comparisons (Bonferroni). {change}"
    )


def _verdict(comparison: CalibrationComparison, table: FactTable) -> str:
    if comparison.same_poses:
        return paragraph(
            "SAME POSES: no conclusion about the arm. A and B are two estimates from the same readings; "
            "only new poses show whether the arm has drifted."
        )
    if not comparison.drifted:
        return "NO SIGNIFICANT DRIFT."
    cells = {row[0]: [shown(cell) for cell in row] for row in table.rows}
    lines = []
    for d in comparison.drifted:
        _, unit, _, _, change, _, sigmas, _ = cells[d.name]
        text = f"- {d.name} by {change} {unit} ({sigmas} sigmas; {d.side.value})"
        lines.append(paragraph(text, indent=2))
    if Side.ARM not in {d.side for d in comparison.drifted}:
        advice = (
            "Only parameters of the fixture's mounting changed, none of the arm itself. If the fixture "
            "was taken off in between, compare with --remounted; if not, check whether it has moved."
        )
    elif CALCULATION_CODES & {n.code for n in comparison.notices}:
        advice = (
            "A and B were made in different ways (see below), which by itself changes parameters. Calibrate both in "
            "the same way and compare again before suspecting the arm."
        )
    else:
        advice = (
            "The arm itself changed. Calibrate again; if the change persists, check the encoders' home marks "
            "and couplings of the joints named, and export the new parameters."
        )
    return "\n".join(["DRIFTED:", *lines, paragraph(advice)])


def _document_text(name: str, document: ParametersDocument) -> str:
    return (
        f"{name}  {document.arm.model} {document.arm.serial}, fixture {document.fixture.name}, "
        f"{document.utc:%Y-%m-%d %H:%M} UTC\n   {document.estimator}, "
        f"{document.quality.poses} poses, sarcal {document.software_version}"
    )


def change_cells(
    changes: Sequence[ParameterChange],
) -> Iterator[tuple[ParameterChange, tuple[Cell, ...]]]:
    """Yield each change with its cells: name, unit, both values, their difference and the difference's sigma."""
    format_of = formats_of((d, d.sigma) for d in changes)
    for d in changes:
        figure = format_of(d)
        values = figure(d.before), figure(d.after), figure(d.change, signed=True), figure(d.sigma)
        yield d, (d.name, quantity_of(d).unit, *values)


def _table(comparison: CalibrationComparison) -> FactTable:
    titles = ("A", "B", "change", "sigma", "sigmas")
    rows: list[tuple[Cell, ...]] = []
    for d, cells in change_cells(comparison.drifts):
        sigmas = Figure(d.sigmas, places=1) if math.isfinite(d.sigmas) else "no sigma"
        rows.append((*cells, sigmas, "DRIFT" if d.significant else ""))
    columns = (*words("parameter", "unit"), *figures(*titles), *words(""))
    return FactTable(ident="drift", title="", columns=columns, rows=tuple(rows))


def change_data(change: ParameterChange, before: str, after: str) -> dict[str, Any]:
    """Return one parameter's change as JSON, in deg or m; `before` and `after` are the keys of the two values."""
    return {
        "unit": "deg" if change.is_angle else "m",
        before: in_json(change, change.before),
        after: in_json(change, change.after),
        "change": in_json(change, change.change),
        "sigma": in_json(change, change.sigma),
    }


def _left_out(comparison: CalibrationComparison) -> str:
    by_reason: dict[str, list[str]] = {}
    for name, reason in comparison.left_out:
        by_reason.setdefault(reason, []).append(name)
    texts = (f"Not compared ({why}): {', '.join(names)}" for why, names in by_reason.items())
    return "\n".join(paragraph(text, indent=2) for text in texts)


def _document_json(document: ParametersDocument, scale: float) -> dict[str, Any]:
    return {
        "arm_model": document.arm.model,
        "arm_serial": document.arm.serial,
        "fixture": document.fixture.name,
        "fixture_kind": document.fixture.kind,
        "utc": document.utc.isoformat().replace("+00:00", "Z"),
        "estimator": document.estimator,
        "poses": document.quality.poses,
        "chi2_per_dof": document.quality.chi2_per_dof,
        "sigma_scale": scale,
        "pose_set_sha256": document.pose_set_sha256,
        "software_version": document.software_version,
    }
