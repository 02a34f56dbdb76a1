"""What a calibration learned beside its parameters: sizes of errors, distances, best table, corrections, shares."""

from __future__ import annotations

import math
from typing import Any

import numpy as np

from operator_app.calibration.distances import Distance
from operator_app.calibration.result import Solution
from operator_app.report.table import Cell, FactTable, figures, words
from operator_app.units.figure import ANGLE, LENGTH, NUMBER, Figure
from solver.chain.parameters import DhKind
from solver.posterior.corrections import ReadingCorrection


def scale_table(solution: Solution) -> FactTable | None:
    """Size of each family of errors, what the files state being 1."""
    if not solution.scales:
        return None
    rows: list[tuple[Cell, ...]] = [
        (
            s.family.replace("_", " "),
            Figure(s.value, NUMBER, places=2, role="found", key=("scales", s.family, "value")),
            Figure(s.low, NUMBER, places=2, key=("scales", s.family, "interval_95", 0)),
            Figure(s.high, NUMBER, places=2, key=("scales", s.family, "interval_95", 1)),
        )
        for s in solution.scales
    ]
    return FactTable(
        ident="scales",
        title="Errors against what the files state, stated = 1 (no unit)",
        columns=(*words("errors"), *figures("found", "95 % from", "to")),
        rows=tuple(rows),
        note="Learned from the poses where they tell it, from the statement where they do not.",
        detail=True,
    )


def distance_table(solution: Solution) -> FactTable | None:
    """Distances between the sockets of a ball."""
    if not solution.distances:
        return None
    known = any(d.measured for d in solution.distances)
    return FactTable(
        ident="distances",
        title="Distances between placements [mm]",
        columns=(
            *words("between"),
            *figures("distance", "sigma", *(("measured", "its sigma") if known else ())),
        ),
        rows=tuple(
            (
                f"{d.between[0]} and {d.between[1]}",
                Figure(d.value_m, LENGTH, places=3, role="found"),
                Figure(d.sigma_m, LENGTH, places=3),
                *(_measured(d) if known else ()),
            )
            for d in solution.distances
        ),
    )


def _measured(distance: Distance) -> tuple[Cell, ...]:
    """Cells of what was measured of a distance."""
    if distance.measured is None:
        return ("", "")
    stated = distance.measured
    return tuple(Figure(v, LENGTH, places=3) for v in (stated.value_m, stated.sigma_m))


def best_table_table(solution: Solution) -> FactTable | None:
    """D-H table that has the tool best where no corrections are applied."""
    best = solution.best
    if best is None:
        return None
    kinds = [DhKind.A, DhKind.S, DhKind.ALPHA, DhKind.THETA_OFF]
    if best.rows[DhKind.BETA].any():
        kinds.insert(3, DhKind.BETA)
    rows: list[tuple[Cell, ...]] = []
    for link in range(best.rows.shape[1]):
        cells: list[Cell] = [str(link + 1)]
        for kind in kinds:
            value = float(best.rows[kind, link])
            angle = kind.is_angle
            cells.append(Figure(value, ANGLE if angle else LENGTH, places=4 if angle else 3))
        rows.append(tuple(cells))
    return FactTable(
        ident="best_table",
        title="Best D-H table without corrections",
        columns=(
            *words("link"),
            *figures(*(f"{k.symbol} [{(ANGLE if k.is_angle else LENGTH).unit}]" for k in kinds)),
        ),
        rows=tuple(rows),
        note="Not the physical entries: what corrections of the readings would do is in it as far as a table can "
        "hold it. For URDF files, fk and controllers that apply no corrections.",
        detail=True,
    )


def posterior_data(solution: Solution) -> dict[str, Any]:
    """Return the JSON keys of these results; angles in deg, lengths in m or as the key says."""
    best = solution.best
    found: dict[str, Any] = {
        "shares": dict(solution.shares),
        "scales": {
            s.family: {"value": s.value, "interval_95": [s.low, s.high]} for s in solution.scales
        },
        "distances": [
            {
                "between": list(d.between),
                "mm": 1e3 * d.value_m,
                "sigma_mm": 1e3 * d.sigma_m,
                "interval_95": [
                    1e3 * (d.value_m - NORMAL_95 * d.sigma_m),
                    1e3 * (d.value_m + NORMAL_95 * d.sigma_m),
                ],
                "measured_mm": None if d.measured is None else 1e3 * d.measured.value_m,
                "measured_sigma_mm": None if d.measured is None else 1e3 * d.measured.sigma_m,
                "deviation_sigmas": None if d.measured is None else d.deviation,
            }
            for d in solution.distances
        ],
        "best_table": {},
        "best_table_tool_sigma_mm": None,
        "corrections": [],
    }
    if best is not None:
        for kind in DhKind:
            for link, value in enumerate(best.rows[kind].tolist(), 1):
                if kind is not DhKind.BETA or value:
                    shown = math.degrees(value) if kind.is_angle else value
                    found["best_table"][f"{kind.symbol}_{link}"] = shown
        found["best_table_tool_sigma_mm"] = 1e3 * best.sigma_m
    if solution.corrections is not None:
        found["corrections"] = [_correction_data(c) for c in solution.corrections.each]
        found["corrections_dh"] = [
            dict(zip(("theta_off_deg", "s_m", "a_m", "alpha_deg"), row[:4], strict=True))
            for row in (solution.corrections.rows * _PER_SI[:, None]).T.tolist()
        ]
    return found


NORMAL_95 = 1.959963984540054

_PER_SI = np.array([np.rad2deg(1.0) if kind.is_angle else 1.0 for kind in DhKind])


def _correction_data(c: ReadingCorrection) -> dict[str, Any]:
    """Return one correction; coefficients in deg, of gravity in deg per N m times kg and kg m."""
    found: dict[str, Any] = {
        "source": c.source,
        "joint": c.joint,
        "kind": c.kind,
        "coefficients": np.rad2deg(c.coefficients).tolist(),
        "unit": "deg" if c.kind != "gravity" else "deg/(N m) kg, deg/(N m) kg m",
    }
    if c.kind == "linearity":
        found |= {
            "middle_deg": math.degrees(c.middle_rad),
            "half_scale_deg": math.degrees(c.half_scale_rad),
        }
    if c.kind == "gravity":
        found["down"] = list(c.down)
    return found
