"""The paper's experiment as tables and as JSON: this program's values beside the published ones."""

from __future__ import annotations

from typing import Any

from operator_app.planning.reproduction import (
    PUBLISHED_CONDITION,
    SIGMA_ORI_RAD,
    SIGMA_POS_M,
    Published,
)
from operator_app.report.parameter_tables import dh_table
from operator_app.report.table import Cell, FactTable, figures, words
from operator_app.report.text import paragraph, table_text
from operator_app.units import (
    ANGLE,
    CLOSURE_ANGLE,
    CLOSURE_LENGTH,
    LENGTH,
    NUMBER,
    Figure,
    in_json,
    quantity_of,
)


def published_text(found: Published) -> str:
    """Return all tables in the paper's order."""
    table = dh_table(found.solution)
    blocks = [
        paragraph(
            "Giugovaz and Hollerbach, Closed-Loop Kinematic Calibration of the Sarcos Dextrous Arm: a specimen "
            f"of their arm in {found.poses} poses, by their estimator. The specimen has the errors they suspect in "
            "theirs; it is not their arm, and figures agree in size only."
        ),
        *([] if table is None else [table_text(table)]),
        table_text(_identified(found)),
        table_text(_quality(found)),
        table_text(_shares(found)),
        table_text(_remedies(found)),
    ]
    return "\n\n".join(blocks)


def published_json(found: Published) -> dict[str, Any]:
    """Return the figures of all tables; angles in deg, lengths in m, closure in mm and mrad."""
    estimate = found.solution.estimate
    sigmas = estimate.sigmas
    turned = sigmas.orientation_rad
    return {
        "poses": found.poses,
        "table_2": {
            p.name: {
                "paper": in_json(p, found.printed[p.name]),
                "specimen": in_json(p, float(x)),
            }
            for p, x in zip(estimate.parameters, estimate.x, strict=True)
        },
        "scaled_condition_number": found.solution.seen.scaled_condition_number,
        "sigma_pos_mm": {
            "rms": CLOSURE_LENGTH.per_si * sigmas.position_m.rms,
            "as_printed": CLOSURE_LENGTH.per_si * sigmas.position_m.as_printed,
        },
        "sigma_ori_mrad": None
        if turned is None
        else {
            "rms": CLOSURE_ANGLE.per_si * turned.rms,
            "as_printed": CLOSURE_ANGLE.per_si * turned.as_printed,
        },
        "shares": [
            {
                "source": share.source,
                "sigma_pos_mm": CLOSURE_LENGTH.per_si * share.position_m,
                "sigma_ori_mrad": CLOSURE_ANGLE.per_si * share.orientation_rad,
                "scaled_condition_number": share.condition,
            }
            for share in found.shares
        ],
        "remedies": [
            {
                "remedy": remedy.name,
                "offsets_rms_deg": ANGLE.per_si * remedy.offsets_rad,
                "lengths_rms_mm": LENGTH.per_si * remedy.lengths_m,
            }
            for remedy in found.remedies
        ],
    }


def _identified(found: Published) -> FactTable:
    """Table 2: the published values, and the paper's estimator on the simulated arm."""
    estimate, rows = found.solution.estimate, []
    for p, value, sd in zip(
        estimate.parameters, estimate.x.tolist(), estimate.standard_deviation.tolist(), strict=True
    ):
        quantity = quantity_of(p)
        rows.append(
            (
                p.name,
                quantity.unit,
                Figure(found.printed[p.name], quantity, places=1),
                Figure(value, quantity, places=1),
                Figure(value - found.printed[p.name], quantity, places=1, signed=True),
                Figure(sd, quantity, digits=2),
            )
        )
    return FactTable(
        ident="table-2",
        title="Table 2: identified",
        columns=(
            *words("parameter", "unit"),
            *figures("printed", "specimen", "difference", "its sigma"),
        ),
        rows=tuple(rows),
        note="The published values are the specimen's truth: the difference is the estimator's error due to the "
        f"three sources, up to {found.farthest_sigmas:.0f} times its sigma, which includes none of them.",
    )


def _quality(found: Published) -> FactTable:
    sigmas, seen = found.solution.estimate.sigmas, found.solution.seen
    turned = sigmas.orientation_rad
    rows: list[tuple[Cell, ...]] = [
        (
            "scaled condition number",
            "",
            Figure(PUBLISHED_CONDITION),
            Figure(seen.scaled_condition_number),
            "",
        ),
        (
            "sigma_pos, eq. 14",
            CLOSURE_LENGTH.unit,
            Figure(SIGMA_POS_M, CLOSURE_LENGTH),
            Figure(sigmas.position_m.rms, CLOSURE_LENGTH),
            Figure(sigmas.position_m.as_printed, CLOSURE_LENGTH),
        ),
    ]
    if turned is not None:
        rows.append(
            (
                "sigma_ori, eq. 15",
                CLOSURE_ANGLE.unit,
                Figure(SIGMA_ORI_RAD, CLOSURE_ANGLE),
                Figure(turned.rms, CLOSURE_ANGLE),
                Figure(turned.as_printed, CLOSURE_ANGLE),
            )
        )
    return FactTable(
        ident="quality",
        title="How good the fit is",
        columns=(*words("figure", "unit"), *figures("paper", "rms", "as printed")),
        rows=tuple(rows),
        note="Equations 14 and 15 as printed divide by N outside the root; root mean squares are of the size "
        "that the paper reports.",
    )


def _shares(found: Published) -> FactTable:
    return FactTable(
        ident="shares",
        title="Share of each source of error (section 4): each alone",
        columns=(
            *words("source"),
            *figures("sigma_pos [mm]", "sigma_ori [mrad]", "condition"),
        ),
        rows=tuple(
            (
                share.source,
                Figure(share.position_m, CLOSURE_LENGTH),
                Figure(share.orientation_rad, CLOSURE_ANGLE),
                Figure(share.condition, NUMBER),
            )
            for share in found.shares
        ),
    )


def _remedies(found: Published) -> FactTable:
    return FactTable(
        ident="remedies",
        title="Effect of each planned remedy (section 4): rms error against the truth",
        columns=(
            *words("remedy", "section"),
            *figures("offsets [deg]", "lengths [mm]"),
        ),
        rows=tuple(
            (
                remedy.name,
                remedy.paragraph,
                Figure(remedy.offsets_rad, ANGLE, places=2),
                Figure(remedy.lengths_m, LENGTH, places=2),
            )
            for remedy in found.remedies
        ),
        note="Offsets of the seven joints; lengths that calibration identifies. On a real arm nobody knows "
        "the truth: the uncertainty budget of a solution is what stands for this table.",
    )
