"""A calibration judged by an open arm, as text and as JSON. Computes nothing, prints nothing."""

from __future__ import annotations

from typing import Any

from operator_app.calibration.open_loop import OpenLoopCheck, ParameterDifference
from operator_app.report.table import FactTable, figures, words
from operator_app.report.text import paragraph, table_lines
from operator_app.units.figure import ANGLE, CHI2, LENGTH, Figure, Quantity
from operator_app.units.numbers import places_to_show
from solver.diagnostics.limits import DRIFT_FALSE_ALARM_PROBABILITY

AGREES = "agrees"
DISAGREES = "disagrees"
UNSOUND = "open loop not accepted"


def open_loop_json(found: OpenLoopCheck) -> dict[str, Any]:
    """Return the object of `sarcal verify --open-loop --json`: deg and m."""
    return {
        "verdict": _verdict(found),
        "disagree": [d.name for d in found.disagree],
        "poses": found.solution.poses,
        "chi2_per_dof": found.chi2.per_dof,
        "chi2_band_99": [found.chi2.low, found.chi2.high],
        "parameters": {
            d.name: {
                "unit": "deg" if d.is_angle else "m",
                "closed_loop": _in_json(d, d.closed),
                "open_loop": _in_json(d, d.open),
                "change": _in_json(d, d.change),
                "sigma": _in_json(d, d.sigma),
                "significant": d.significant,
            }
            for d in found.differences
        },
        "not_compared": list(found.left_out),
        "reasons": list(found.solution.reasons),
    }


def open_loop_text(found: OpenLoopCheck, folder: str) -> str:
    """Return everything worth knowing, the verdict first, for a terminal of 80 columns."""
    poses, verdict = found.solution.poses, _verdict(found)
    if verdict == UNSOUND:
        head = (
            f"NOTHING IS PROVED: the {poses} measured poses give no sound calibration of the open arm "
            f"({'; '.join(found.solution.reasons)}). Look at the instrument, its target and how exact "
            "its file says it is."
        )
    elif verdict == AGREES:
        head = (
            f"AGREES: {poses} poses of the open arm, measured by another instrument, say the same of "
            f"the arm as the calibration of {folder}."
        )
    elif found.disagree:
        names = ", ".join(d.name for d in found.disagree)
        head = (
            f"DISAGREES: {poses} poses of the open arm say something else than the calibration of "
            f"{folder} of {names}. Did a joint slip between them? Is the hinge, or the target on the "
            "hand, loose? Calibrate once more; what stays is the arm's file or the instrument's."
        )
    else:
        head = (
            f"DISAGREES: {poses} poses of the open arm differ from the calibration of {folder} by more "
            "than its uncertainty allows, no parameter by itself."
        )
    chi2 = found.chi2
    return "\n".join(
        (
            paragraph(head),
            "",
            *table_lines(_table(found)),
            paragraph(
                f"Change is open less closed. * marks what chance gives to any of "
                f"{len(found.differences)} parameters in "
                f"{100.0 * DRIFT_FALSE_ALARM_PROBABILITY:g} % of checks. All together: "
                f"chi2/dof {CHI2(chi2.per_dof).shown}, in 99 % at most {CHI2(chi2.high).shown}."
            ),
            *(
                [paragraph(f"Not compared, mounted anew: {', '.join(found.left_out)}.")]
                if found.left_out
                else []
            ),
        )
    )


def _verdict(found: OpenLoopCheck) -> str:
    if not found.solution.accepted:
        return UNSOUND
    return AGREES if found.holds else DISAGREES


def _table(found: OpenLoopCheck) -> FactTable:
    places = {
        q: places_to_show(
            (q.per_si * d.sigma for d in found.differences if _quantity(d) is q), least=3
        )
        for q in (ANGLE, LENGTH)
    }
    rows = []
    for d in found.differences:
        quantity = _quantity(d)
        shown = (
            Figure(value, quantity, places=places[quantity], signed=value is d.change)
            for value in (d.closed, d.open, d.change, d.sigma)
        )
        rows.append((d.name, quantity.unit, *shown, "*" if d.significant else ""))
    return FactTable(
        ident="open_loop",
        title="",
        columns=(
            *words("parameter", "unit"),
            *figures("closed loop", "open loop", "change", "sigma"),
            *words(""),
        ),
        rows=tuple(rows),
    )


def _quantity(difference: ParameterDifference) -> Quantity:
    return ANGLE if difference.is_angle else LENGTH


def _in_json(difference: ParameterDifference, value: float) -> float | None:
    return Figure(value, _quantity(difference)).in_json
