"""Tables of the sources of error: sized, as shares of each variance, halved. Knows no renderer."""

from __future__ import annotations

import numpy as np

from operator_app.calibration.result import Solution
from operator_app.calibration.sensitivity import source_sensitivities
from operator_app.report.table import Cell, Column, FactTable, figures, words
from operator_app.units.figure import (
    CLOSURE_ANGLE,
    CLOSURE_LENGTH,
    SHARE,
    Figure,
    quantity_of,
)
from operator_app.units.numbers import significant
from solver.estimators.variance_components import VarianceComponents

SMALLEST_P = 1e-12
LARGEST = 3
"""Sources of error that are named where there is no room for all."""


def components_table(found: VarianceComponents | None, *, astray: bool = False) -> FactTable | None:
    """Size of every source of error that was estimated, with its interval; `astray` ones ask for nothing."""
    if found is None or (not found.components and found.flexure is None):
        return None
    rows: list[tuple[Cell, ...]] = []
    for c in found.components:
        quantity = CLOSURE_LENGTH if c.unit == "m" else CLOSURE_ANGLE
        fixture = c.name.startswith("fixture")
        key = f"fixture_{quantity.unit}" if fixture else f"{c.name}_{quantity.unit}"
        rows.append(
            (
                component_words(c.name),
                quantity.unit,
                Figure(c.stated, quantity),
                Figure(c.sd, quantity, role="found", key=("variance_components", key)),
                Figure(c.low, quantity, key=("variance_components_interval", key, 0)),
                Figure(c.high, quantity, key=("variance_components_interval", key, 1)),
            )
        )
    note = ""
    if found.flexure is not None and not astray:
        p = found.flexure.p_value
        chance = f"= {significant(p, 2)}" if p > SMALLEST_P else f"< {SMALLEST_P:.0e}"
        asks = "ask" if found.flexure.gives else "do not ask"
        note = (
            f"The data {asks} for a fixture that gives more than stated (score test, p {chance})."
        )
    return FactTable(
        ident="noise",
        title="Sources of error, sized by the data",
        columns=(*words("source", "unit"), *figures("stated", "found", "95 % from", "to")),
        rows=tuple(rows),
        note=note,
    )


def component_words(name: str) -> str:
    """Say what a variance component is."""
    kind, _, which = name.partition("_")
    match kind:
        case "rvdt":
            return f"reading of joint {which} (RVDT)"
        case "curve":
            return f"curve of joint {which} (RVDT)"
        case "fixture":
            return "fixture, turning" if which == "rad" else "fixture, shifting"
        case _:
            return name


def budget_table(solution: Solution) -> FactTable | None:
    """Share of every parameter's variance that each source of error brings."""
    if solution.components is None:
        return None
    estimate, budget = solution.estimate, solution.components.budget
    total = np.diagonal(estimate.covariance)

    def share(source: str, k: int, name: str) -> Figure:
        value = float(budget[source][k] / total[k]) if total[k] > 0.0 else 0.0
        return Figure(value, SHARE, places=0, key=("budget", name, source))

    rows: list[tuple[Cell, ...]] = []
    for k, p in enumerate(estimate.parameters):
        if p.name not in solution.tolerated:
            shares = {source: share(source, k, p.name) for source in budget}
            largest = sorted(shares, key=lambda source: -(shares[source].value or 0.0))[:LARGEST]
            told = ", ".join(f"{source_words(s)} {shares[s].with_unit}" for s in largest)
            rows.append((p.name, told, *shares.values()))
    return FactTable(
        ident="budget",
        title="Uncertainty budget: share of each variance by source [%]",
        columns=(
            *words("parameter"),
            Column("largest", words=True, summary=True),
            *figures(*map(source_words, budget), detail=True),
        ),
        rows=tuple(rows),
        note=f"Assumed, since no file states them: {', '.join(solution.assumed)}."
        if solution.assumed
        else "",
    )


def halving_table(solution: Solution) -> FactTable | None:
    """What would halve the widest sigmas: the largest source of each, and what half of it leaves."""
    found = source_sensitivities(solution)
    rows: list[tuple[Cell, ...]] = []
    for h in found:
        quantity = quantity_of(h.parameter)
        rows.append(
            (
                h.parameter.name,
                quantity.unit,
                Figure(h.sigma, quantity, digits=2),
                f"{source_words(h.source)} {Figure(h.share, SHARE, places=0).with_unit}",
                Figure(h.then, quantity, digits=2, key=("halved", h.parameter.name, "sigma")),
            )
        )
    done = dict.fromkeys(f"{source_words(h.source)}: {h.remedy}" for h in found)
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
        note=f"To halve it: {'; '.join(done)}.",
    )  # fmt: skip


def source_words(source: str) -> str:
    """Say what a source of the budget is: ``RVDT curve 6``."""
    return source.replace("_", " ").replace("rvdt", "RVDT")
