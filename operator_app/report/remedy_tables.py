"""Facts of what outlives a mounting and what corrects a sensor. Knows no renderer."""

from __future__ import annotations

from operator_app.calibration.calibrated_arm import side_of
from operator_app.calibration.remedies import reading_tables
from operator_app.calibration.result import Solution
from operator_app.report.table import Cell, FactTable, figures
from operator_app.units.figure import ANGLE, Figure

EVERY = 4
"""Rows of a table of corrections that are shown: so many apart."""


def side_note(solution: Solution) -> str:
    """Say whose each parameter is, arm, ground or hand: what outlives the mounting."""
    names: dict[str, list[str]] = {"arm": [], "ground": [], "hand": []}
    for parameter in solution.identified.parameters:
        names[side_of(solution.model, parameter.name)].append(parameter.name)
    said = [f"Arm: {', '.join(names['arm'])}." if names["arm"] else "Nothing is of the arm alone."]
    said += [
        f"{side.capitalize()}: {', '.join(names[side])}."
        for side in ("ground", "hand")
        if names[side]
    ]
    return " ".join([*said, "What is of the arm outlives the mounting."])


def remedy_table(solution: Solution) -> FactTable | None:
    """Offset, gain and corrections of every RVDT that the poses could judge; None without any."""
    rows: list[tuple[Cell, ...]] = []
    for found in reading_tables(solution):
        head: tuple[Cell, ...] = (
            str(found.joint),
            Figure(found.theta_off_rad, ANGLE, places=3),
            Figure(found.gain, places=4),
        )
        columns = (found.reading_rad, found.add_rad, found.sigma_rad)
        for reading, add, sigma in zip(*(c[::EVERY].tolist() for c in columns), strict=True):
            rows.append(
                (
                    *head,
                    Figure(reading, ANGLE, places=1),
                    Figure(add, ANGLE, places=3, signed=True),
                    Figure(sigma, ANGLE, places=3),
                )
            )
            head = ("", "", "")
    if not rows:
        return None
    return FactTable(
        ident="rvdt-remedy",
        title="Corrections of RVDT readings, from the closed loop",
        columns=(
            *figures("joint"),
            *figures("theta_off", unit="deg"),
            *figures("gain"),
            *figures("reading", "add", "sigma", unit="deg"),
        ),
        rows=tuple(rows),
        note="Corrected reading = reading + add, linear in between; theta_off belongs to corrected "
        "readings, gain (reading per angle) is in the corrections. The whole table is in the parameters "
        "file: solve --rvdt-table FILE applies it.",
    )
