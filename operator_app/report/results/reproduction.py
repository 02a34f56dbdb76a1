"""The paper's experiment as tables and as JSON: this program's values beside the published values."""

from functools import partial
from typing import Any

from operator_app.planning.reproduction import (
    PUBLISHED_CONDITION,
    SIGMA_ORI_RAD,
    SIGMA_POS_M,
    Published,
)
from operator_app.report.parameter_tables import dh_table, values_of
from operator_app.report.table import Cell, FactTable, figures, keyed, words
from operator_app.report.text import paragraph, table_text
from operator_app.units import ANGLE, CLOSURE_ANGLE, CLOSURE_LENGTH, Figure, quantity_of


def published_text(reproduction: Published) -> str:
    """Return all tables in the paper's order."""
    table = dh_table(reproduction.solution)
    blocks = [
        paragraph(
            "Giugovaz and Hollerbach, Closed-Loop Kinematic Calibration of the Sarcos Dextrous Arm: a specimen "
            f"of their arm in {reproduction.poses} poses, by their estimator. The specimen is simulated with the "
            "errors that the authors suspect in their arm, so that the figures agree in size only."
        ),
        *([] if table is None else [table_text(table)]),
        *map(table_text, _tables(reproduction)),
    ]
    return "\n\n".join(blocks)


def published_json(reproduction: Published) -> dict[str, Any]:
    """Return the reproduced and the published figures as JSON; angles in deg, lengths in m, closure in mm and mrad."""
    numbers = keyed(_tables(reproduction))
    shares = zip(reproduction.shares, numbers["shares"], strict=True)
    remedies = zip(reproduction.remedies, numbers["remedies"], strict=True)
    return {
        "poses": reproduction.poses,
        **numbers,
        "shares": [{"source": share.source, **row} for share, row in shares],
        "remedies": [{"remedy": remedy.name, **row} for remedy, row in remedies],
    }


def _tables(reproduction: Published) -> list[FactTable]:
    return [make(reproduction) for make in (_identified, _quality, _shares, _remedies)]


def _identified(reproduction: Published) -> FactTable:
    estimate, rows = reproduction.solution.estimate, []
    titles = ("printed", "specimen", "difference", "its sigma")
    for p, value, sd in values_of(estimate):
        quantity, printed, key = quantity_of(p), reproduction.printed[p.name], ("table_2", p.name)
        figure = partial(Figure, quantity=quantity, places=1)
        both = figure(printed, key=(*key, "paper")), figure(value, key=(*key, "specimen"))
        difference, sigma = figure(value - printed, signed=True), Figure(sd, quantity, digits=2)
        rows.append((p.name, quantity.unit, *both, difference, sigma))
    return FactTable(
        ident="table-2",
        title="Table 2: identified",
        columns=(*words("parameter", "unit"), *figures(*titles)),
        rows=tuple(rows),
        note="The published values are the specimen's truth: the difference is the estimator's error due to the "
        f"three sources, up to {reproduction.farthest_sigmas:.0f} times its sigma, which includes none of them.",
    )


def _quality(reproduction: Published) -> FactTable:
    solution = reproduction.solution
    condition = solution.identifiability.scaled_condition_number
    shift, turn = solution.estimate.sigmas.position_m, solution.estimate.sigmas.orientation_rad
    published = Figure(PUBLISHED_CONDITION)
    ours = Figure(condition, key=("scaled_condition_number",))
    rows: list[tuple[Cell, ...]] = [("scaled condition number", "", published, ours, "")]
    for name, key, quantity, in_paper, both in (
        ("sigma_pos, eq. 14", "sigma_pos_mm", CLOSURE_LENGTH, SIGMA_POS_M, shift),
        ("sigma_ori, eq. 15", "sigma_ori_mrad", CLOSURE_ANGLE, SIGMA_ORI_RAD, turn),
    ):
        if both is not None:
            rms = Figure(both.rms, quantity, key=(key, "rms"))
            as_printed = Figure(both.as_printed, quantity, key=(key, "as_printed"))
            rows.append((name, quantity.unit, Figure(in_paper, quantity), rms, as_printed))
    return FactTable(
        ident="quality",
        title="How good the fit is",
        columns=(*words("figure", "unit"), *figures("paper", "rms", "as printed")),
        rows=tuple(rows),
        note="Equations 14 and 15 as printed divide by N outside the root; root mean squares are of the size "
        "that the paper reports.",
    )


def _shares(reproduction: Published) -> FactTable:
    return FactTable(
        ident="shares",
        title="Share of each source of error (section 4): each alone",
        columns=(*words("source"), *figures("sigma_pos [mm]", "sigma_ori [mrad]", "condition")),
        rows=tuple(
            (
                share.source,
                Figure(share.position_m, CLOSURE_LENGTH, key=("shares", k, "sigma_pos_mm")),
                Figure(share.orientation_rad, CLOSURE_ANGLE, key=("shares", k, "sigma_ori_mrad")),
                Figure(share.condition, key=("shares", k, "scaled_condition_number")),
            )
            for k, share in enumerate(reproduction.shares)
        ),
    )


def _remedies(reproduction: Published) -> FactTable:
    return FactTable(
        ident="remedies",
        title="Effect of each planned remedy (section 4): rms error against the truth",
        columns=(*words("remedy", "section"), *figures("offsets [deg]", "lengths [mm]")),
        rows=tuple(
            (
                remedy.name,
                remedy.paragraph,
                Figure(remedy.offsets_rad, ANGLE, 2, key=("remedies", k, "offsets_rms_deg")),
                Figure(remedy.lengths_m, CLOSURE_LENGTH, 2, key=("remedies", k, "lengths_rms_mm")),
            )
            for k, remedy in enumerate(reproduction.remedies)
        ),
        note="Offsets of the seven joints; lengths that calibration identifies. The true values of a real arm are "
        "not known: use the uncertainty budget of a solution in place of this table.",
    )
