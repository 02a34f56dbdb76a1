"""Tables of error sources, sensitivities, distances and the best D-H table."""

import math
from typing import Any

import numpy as np

from operator_app import units
from operator_app.calibration.result import Solution
from operator_app.calibration.sensitivity import source_sensitivities
from operator_app.report.parameter_tables import shown_kinds
from operator_app.report.table import Cell, Column, FactTable, figures, words
from operator_app.units import Figure, Key, Kind, names, quantity_of, significant
from solver.arrays import FloatArray
from solver.chain.parameters import DhKind
from solver.estimators.variance_components import NORMAL_95
from solver.posterior.corrections import ReadingCorrection

SMALLEST_P = 1e-12
SOURCES_NAMED = 3


def components_table(solution: Solution) -> FactTable | None:
    """Return the table of the error sources' estimated standard deviations, with intervals; None if there are none.

    If the solution diverged, the table has no note on the fixture's compliance.
    """
    components = solution.components
    if components is None or (not components.components and components.compliance is None):
        return None
    rows: list[tuple[Cell, ...]] = []
    for c in components.components:
        quantity = units.CLOSURE_LENGTH if c.unit == "m" else units.CLOSURE_ANGLE
        name = "fixture" if c.name.startswith("fixture") else c.name
        key = f"{name}_{quantity.unit}"
        sd = Figure(c.sd, quantity, role="found", key=("variance_components", key))
        low, high = (
            Figure(end, quantity, key=("variance_components_interval", key, k))
            for k, end in enumerate((c.low, c.high))
        )
        stated = Figure(c.stated, quantity)
        rows.append((_component_words(c.name), quantity.unit, stated, sd, low, high))
    note = ""
    if components.compliance is not None and not solution.adjudication.diverged:
        p = components.compliance.p_value
        chance = f"= {significant(p, 2)}" if p > SMALLEST_P else f"< {SMALLEST_P:.0e}"
        show = "show" if components.compliance.deflects else "do not show"
        note = f"The data {show} that the fixture is more compliant than stated (score test, p {chance})."
    return FactTable(
        ident="noise",
        title="Sources of error, estimated from the poses",
        columns=(*words("source", "unit"), *figures("stated", "found", "95 % from", "to")),
        rows=tuple(rows),
        note=note,
    )


def _component_words(name: str) -> str:
    kind, _, which = name.partition("_")
    known = {
        "rvdt": f"reading of joint {which} (RVDT)",
        "curve": f"curve of joint {which} (RVDT)",
        "fixture": "fixture, turning" if which == "rad" else "fixture, shifting",
    }
    return known.get(kind, name)


def budget_table(solution: Solution) -> FactTable | None:
    """Return the table of each source's share in every parameter's variance; None if not computed."""
    if solution.components is None:
        return None
    estimate, budget = solution.estimate, solution.components.budget
    rows: list[tuple[Cell, ...]] = []
    variances = np.diagonal(estimate.covariance).tolist()
    for k, (p, total) in enumerate(zip(estimate.parameters, variances, strict=True)):
        if p.name not in solution.tolerated:
            shares = {s: float(v[k] / total) if total > 0.0 else 0.0 for s, v in budget.items()}
            cells = {s: units.PERCENT(v, key=("budget", p.name, s)) for s, v in shares.items()}
            largest = sorted(shares, key=lambda source: -shares[source])[:SOURCES_NAMED]
            listed = ", ".join(f"{source_words(s)} {cells[s].with_unit}" for s in largest)
            rows.append((p.name, listed, *cells.values()))
    assumed = ", ".join(solution.assumed)
    return FactTable(
        ident="budget",
        title="Uncertainty budget: share of each variance by source [%]",
        columns=(
            *words("parameter"),
            Column("largest", words=True, summary=True),
            *figures(*map(source_words, budget), detail=True),
        ),
        rows=tuple(rows),
        note=f"Assumed, since no file states them: {assumed}." if assumed else "",
    )


def sensitivity_table(solution: Solution) -> FactTable | None:
    """Return the table of the largest sigmas, as they are and with half their main error; None if not computed."""
    sensitivities = source_sensitivities(solution)
    rows: list[tuple[Cell, ...]] = []
    for h in sensitivities:
        name, quantity = h.parameter.name, quantity_of(h.parameter)
        sigma = Figure(h.sigma, quantity, digits=2)
        source = f"{source_words(h.source)} {units.PERCENT(h.share).with_unit}"
        then = Figure(h.then, quantity, digits=2, key=("halved", name, "sigma"))
        rows.append((name, quantity.unit, sigma, source, then))
    done = dict.fromkeys(f"{source_words(h.source)}: {h.remedy}" for h in sensitivities)
    return None if not rows else FactTable(
        ident="halving",
        title="What narrows the widest sigmas: half of their largest source",
        columns=(
            *words("parameter", "unit"),
            *figures("sigma"),
            *words("largest source"),
            *figures("with half of it"),
        ),
        rows=tuple(rows),
        note=f"To halve a source: {'; '.join(done)}.",
    )  # fmt: skip


def source_words(source: str) -> str:
    """Return the text for an error source of the uncertainty budget, such as ``RVDT curve 6``."""
    return source.replace("_", " ").replace("rvdt", "RVDT")


def scale_table(solution: Solution) -> FactTable | None:
    """Return the table of estimated error divided by stated error, for each family of errors; None if not estimated."""
    if not solution.scales:
        return None
    rows: list[tuple[Cell, ...]] = []
    for s in solution.scales:
        key: Key = ("scales", s.family)
        value = Figure(s.value, places=2, role="found", key=(*key, "value"))
        ends = (
            Figure(v, places=2, key=(*key, "interval_95", k)) for k, v in enumerate((s.low, s.high))
        )
        rows.append((s.family.replace("_", " "), value, *ends))
    return FactTable(
        ident="scales",
        title="Errors against what the files state, stated = 1 (no unit)",
        columns=(*words("errors"), *figures("found", "95 % from", "to")),
        rows=tuple(rows),
        note="Estimated from the poses where they determine it, otherwise as stated.",
        detail=True,
    )


def distance_table(solution: Solution) -> FactTable | None:
    """Return the table of the distances between the sockets of a ball; None if there are none."""
    if not solution.distances:
        return None
    titles, length = ["distance", "sigma"], Kind(units.LENGTH, places=3)
    if any(d.measured for d in solution.distances):
        titles += ["measured", "its sigma"]
    rows: list[tuple[Cell, ...]] = []
    for d in solution.distances:
        row: list[Cell] = [names(d.between), length(d.value_m, role="found"), length(d.sigma_m)]
        row += ["", ""] if (m := d.measured) is None else [length(m.value_m), length(m.sigma_m)]
        rows.append(tuple(row[: 1 + len(titles)]))
    return FactTable(
        ident="distances",
        title="Distances between placements [mm]",
        columns=(*words("between"), *figures(*titles)),
        rows=tuple(rows),
    )


def best_table_table(solution: Solution) -> FactTable | None:
    """Return the D-H table that gives the best tool position without corrections; None if not computed."""
    best = solution.best
    if best is None:
        return None
    kinds = shown_kinds(with_beta=bool(best.rows[DhKind.BETA].any()))

    def cell(kind: DhKind, value: float) -> Figure:
        return Figure(value, quantity_of(kind), places=4 if kind.is_angle else 3)

    return FactTable(
        ident="best_table",
        title="Best D-H table without corrections",
        columns=(*words("link"), *figures(*(f"{k.symbol} [{quantity_of(k).unit}]" for k in kinds))),
        rows=tuple(
            (str(link), *map(cell, kinds, entries))
            for link, entries in enumerate(best.rows[list(kinds)].T.tolist(), 1)
        ),
        note="These are not the physical entries: they include the corrections of the readings as far as a D-H "
        "table can express them. Use them for URDF files, fk and controllers that apply no corrections. Entries of "
        "link 1 that depend on the mounting (side: ground) and the base frame are those of the arm file.",
        detail=True,
    )


def posterior_data(solution: Solution) -> dict[str, Any]:
    """Return JSON data: shares, distances between sockets, best D-H table, and corrections.

    A share is the part of a parameter's information that comes from the poses. Angles are in deg and lengths in m,
    unless the key states another unit.
    """
    best = solution.best
    data: dict[str, Any] = {
        "shares": dict(solution.shares),
        "scales": {},
        "distances": [
            {
                "between": list(d.between),
                "mm": 1e3 * d.value_m,
                "sigma_mm": 1e3 * d.sigma_m,
                "interval_95": [
                    1e3 * (d.value_m + sign * NORMAL_95 * d.sigma_m) for sign in (-1.0, 1.0)
                ],
                "measured_mm": d.measured and 1e3 * d.measured.value_m,
                "measured_sigma_mm": d.measured and 1e3 * d.measured.sigma_m,
                "deviation_sigmas": d.measured and d.deviation,
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
                    data["best_table"][f"{kind.symbol}_{link}"] = shown
        data["best_table_tool_sigma_mm"] = 1e3 * best.sigma_m
    if solution.corrections is not None:
        data["corrections"] = [_correction_data(c) for c in solution.corrections.each]
        rows = dh_rows_data(solution.corrections.rows)
        data["corrections_dh"] = [
            {key: value for key, value in row.items() if value or key != "beta_deg"} for row in rows
        ]
    return data


def dh_rows_data(rows: FloatArray) -> list[dict[str, float]]:
    """Return a JSON object for each link of a D-H table (5, n), with rows in the order of `DhKind`; in deg and m."""
    keys = [f"{kind.symbol}_{'deg' if kind.is_angle else 'm'}" for kind in DhKind]
    in_json = [
        np.rad2deg(row) if kind.is_angle else row for kind, row in zip(DhKind, rows, strict=True)
    ]
    return [dict(zip(keys, link, strict=True)) for link in np.transpose(in_json).tolist()]


def _correction_data(c: ReadingCorrection) -> dict[str, Any]:
    """Return a correction as JSON; coefficients in deg, those of gravity in deg kg/(N m) and deg kg m/(N m)."""
    data: dict[str, Any] = {
        "source": c.source,
        "joint": c.joint,
        "kind": c.kind,
        "coefficients": np.rad2deg(c.coefficients).tolist(),
        "unit": "deg" if c.kind != "gravity" else "deg/(N m) kg, deg/(N m) kg m",
    }
    if c.kind == "linearity":
        data["middle_deg"] = math.degrees(c.middle_rad)
        data["half_scale_deg"] = math.degrees(c.half_scale_rad)
    if c.kind == "gravity":
        data["down"] = list(c.down)
    return data
