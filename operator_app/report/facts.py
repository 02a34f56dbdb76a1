"""What a calibration says: verdict, headlines, tables and notices, built once for every renderer.

Text, page, JSON, screen and plain words show these facts and decide nothing. A table that is added
to `facts_of` appears in all of them; figures with a key are in JSON as well, and what JSON alone
has stands in `calibration_data`. Knows no renderer, no session and no file.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass
from typing import Any

import numpy as np

from operator_app.calibration.checks import FOLDS, Checks
from operator_app.calibration.judgement import Notice
from operator_app.calibration.solve import Solution
from operator_app.config.procedure import AcceptanceLimits
from operator_app.report.calibration_data import calibration_data, checks_data, estimate_data
from operator_app.report.numbers import (
    NOT_KNOWN,
    places_needed,
    places_to_show,
    plural,
    significant,
)
from operator_app.report.table import (
    ANGLE,
    CLOSURE_ANGLE,
    CLOSURE_LENGTH,
    LENGTH,
    SHARE,
    Cell,
    Column,
    Figure,
    Key,
    Quantity,
    Table,
    keyed,
    quantity_of,
)
from solver.arrays import FloatArray
from solver.chain.parameters import DhEntry, DhKind, Parameter, nominal_vector
from solver.estimators.estimate import Estimate
from solver.estimators.goodness import ClosureSigmas, TwoReadings
from solver.estimators.variance_components import VarianceComponents
from solver.judging.statistics import correlations, intervals

CONDITION_PAPER = 28
MOST_PLACES = 6
"""Beyond a nanometre and a thousandth of a millidegree nothing is believed, whatever a sigma says."""

SMALLEST_P = 1e-12
HEAT_STEPS = 5
LARGEST = 3
"""Sources of error that are named where there is no room for all."""
OBSERVABILITY = (
    "geometric mean of the singular values over root m",
    "smallest over largest singular value",
    "smallest singular value",
    "its square over the largest",
    "one over the sum of inverses",
)


@dataclass(frozen=True, slots=True, kw_only=True)
class Headline:
    """A figure that sums a calibration up, and what to hold it against."""

    name: str
    figure: Figure
    note: str = ""

    @property
    def text(self) -> str:
        """``rank 14 (of 14)``."""
        return self.figure_text + (f" ({self.note})" if self.note else "")

    @property
    def figure_text(self) -> str:
        """``rank 14``."""
        return f"{self.name} {self.figure.with_unit}"


@dataclass(frozen=True, slots=True, kw_only=True)
class Facts:
    """What there is to say of a calibration, most important first.

    Attributes
    ----------
    verdict, reasons
        In a word or two, and why it is not better.
    notices
        What the operator should know and do.
    data
        What the JSON object holds beside the figures with a key.
    """

    accepted: bool
    verdict: str
    reasons: tuple[str, ...]
    notices: tuple[Notice, ...]
    headlines: tuple[Headline, ...]
    tables: tuple[Table, ...]
    data: Mapping[str, Any]

    @property
    def json(self) -> dict[str, Any]:
        """The object of `sarcal solve --json`."""
        return merged(self.data, keyed(self.tables))

    def table(self, ident: str) -> Table | None:
        """Return one table, None where there is nothing to put in it."""
        return next((t for t in self.tables if t.ident == ident), None)

    def headline(self, name: str) -> Headline:
        """Return one headline."""
        return next(h for h in self.headlines if h.name == name)


def facts_of(
    solution: Solution,
    *,
    checks: Checks | None = None,
    beside: Estimate | None = None,
    limits: AcceptanceLimits | None = None,
    left_out: int = 0,
) -> Facts:
    """Return the facts of a calibration.

    Parameters
    ----------
    checks
        Second opinions, where there are some.
    beside
        The other estimator's result; by default the paper's, where it is not the chosen one.
    limits
        Those of the procedure.
    left_out
        How many captured poses took no part.
    """
    estimate = solution.identified
    if beside is None and estimate.estimator != "paper":
        beside = solution.paper
    condition = AcceptanceLimits() if limits is None else limits
    return Facts(
        accepted=solution.accepted,
        verdict=solution.verdict.words,
        reasons=solution.reasons,
        notices=solution.warnings,
        headlines=_headlines(solution, condition, left_out),
        tables=_there(
            parameter_table(
                estimate,
                beside=beside,
                repeatability=_repeatability(solution),
            ),
            dh_table(solution),
            determined_table(solution, condition),
            closure_table(solution, beside, checks),
            jackknife_table(estimate, None if checks is None else checks.jackknife_sd),
            components_table(solution.components),
            budget_table(solution),
            tolerated_table(solution),
            observability_table(solution),
            correlation_table(estimate),
        ),
        data={
            **calibration_data(solution),
            **({} if checks is None else {"checks": checks_data(checks)}),
        },
    )


def estimate_json(estimate: Estimate) -> dict[str, Any]:
    """Return what one estimator found as JSON: the paper's, beside the chosen one."""
    rows = closure_row(estimate.estimator, estimate.sigmas, estimate.rotation_rows, key=())
    closure = Table(ident="", title="", columns=CLOSURE_COLUMNS, rows=(rows,))
    return merged(
        {**estimate_data(estimate), "chi2_per_dof": estimate.chi2_per_dof},
        keyed((parameter_table(estimate, nominal_key=False), closure)),
    )


def merged(one: Mapping[str, Any], other: Mapping[str, Any]) -> dict[str, Any]:
    """Put two JSON objects into each other; where both have a value the second's counts."""
    found = dict(one)
    for key, value in other.items():
        both = isinstance(value, Mapping) and isinstance(found.get(key), Mapping)
        found[key] = merged(found[key], value) if both else value
    return found


def _there(*tables: Table | None) -> tuple[Table, ...]:
    return tuple(t for t in tables if t is not None)


def _headlines(solution: Solution, limits: AcceptanceLimits, left_out: int) -> tuple[Headline, ...]:
    estimate, before, seen = solution.identified, solution.before, solution.seen
    after = estimate.sigmas
    said = [_sigma("sigma_pos", CLOSURE_LENGTH, before.position_m, after.position_m)]
    if estimate.rotation_rows:
        turned = before.orientation_rad, after.orientation_rad
        said.append(_sigma("sigma_ori", CLOSURE_ANGLE, *turned))
    said += [
        Headline(
            name="scaled condition number",
            figure=Figure(seen.scaled_condition_number),
            note=f"limit {limits.scaled_condition_number:g}, the paper had {CONDITION_PAPER}",
        ),
        Headline(
            name="rank",
            figure=Figure(seen.rank, places=0),
            note=f"of {len(estimate.parameters)}",
        ),
    ]
    if estimate.chi2_per_dof is not None:
        fitted = solution.components is not None and solution.components.components
        note = "noise fitted with it" if fitted else "1 expected"
        said.append(Headline(name="chi2/dof", figure=Figure(estimate.chi2_per_dof), note=note))
    poses = Figure(solution.poses, places=0)
    note = f"{left_out} left out" if left_out else ""
    return (*said, Headline(name="poses", figure=poses, note=note))


def _sigma(name: str, quantity: Quantity, before: TwoReadings, after: TwoReadings) -> Headline:
    was = Figure(before.rms, quantity, digits=4)
    return Headline(
        name=name, figure=Figure(after.rms, quantity, digits=4), note=f"before {was.with_unit}"
    )


# -- parameters ------------------------------------------------------------------------------------


def precision(estimate: Estimate) -> Callable[[Quantity], int]:
    """Decimal places for angles and for lengths: two figures of the finest sigma of each."""

    def places(quantity: Quantity) -> int:
        finest = [
            quantity.per_si * float(sd)
            for p, sd in zip(estimate.parameters, estimate.standard_deviation, strict=True)
            if quantity_of(p) is quantity
        ]
        return places_to_show(finest, least=3, most=MOST_PLACES)

    return places


def nominal_places(parameters: Iterable[Parameter]) -> Callable[[Quantity], int]:
    """Decimal places that cut nothing off the nominal values."""
    listed = tuple(parameters)

    def places(quantity: Quantity) -> int:
        values = [quantity.per_si * p.nominal for p in listed if quantity_of(p) is quantity]
        return places_needed(values, least=1, most=MOST_PLACES)

    return places


def parameter_table(
    estimate: Estimate,
    *,
    beside: Estimate | None = None,
    repeatability: FloatArray | None = None,
    nominal_key: bool = True,
) -> Table:
    """Nominal, identified, change, sigma and interval, the other estimator's beside them."""
    own = f"{estimate.estimator} (chosen)"
    columns = [
        Column("parameter", words=True),
        Column("unit", words=True),
        Column("nominal"),
        Column("identified", group=own),
        Column("change", group=own),
        Column("sigma", group=own),
        *([Column("type A", group=own)] if repeatability is not None else []),
        Column("95 % from", group=own, detail=True),
        Column("to", group=own, detail=True),
    ]
    if beside is not None:
        columns += [
            Column("identified", group=beside.estimator),
            Column("sigma", group=beside.estimator, detail=True),
            Column("difference", group=beside.estimator, detail=True),
        ]
    places, round_places = precision(estimate), nominal_places(estimate.parameters)
    bounds, rows = intervals(estimate), []
    for k, p in enumerate(estimate.parameters):
        quantity, name = quantity_of(p), p.name
        n, value = places(quantity), float(estimate.x[k])

        def figure(
            value: float,
            key: Key = (),
            quantity: Quantity = quantity,
            n: int = n,
            *,
            signed: bool = False,
        ) -> Figure:
            return Figure(value, quantity, places=n, signed=signed, key=key)

        row: list[Cell] = [
            name,
            quantity.unit,
            figure(p.nominal, ("nominal", name) if nominal_key else (), n=round_places(quantity)),
            Figure(value, quantity, places=n, role="found", key=("parameters", name)),
            figure(_change(p, value, p.nominal), signed=True),
            figure(float(estimate.standard_deviation[k]), ("sigma", name)),
        ]
        if repeatability is not None:
            row.append(figure(float(repeatability[k]), ("repeatability", name)))
        row += [
            figure(bounds[k].low, ("interval_95", name, 0)),
            figure(bounds[k].high, ("interval_95", name, 1)),
        ]
        if beside is not None:
            row += _beside(p, value, n, beside)
        rows.append(tuple(row))
    return Table(
        ident="parameters",
        title="Identified parameters",
        columns=tuple(columns),
        rows=tuple(rows),
        note="Joint angles are the reading plus theta_off; change is identified less nominal, "
        "angles the short way round."
        + (
            ""
            if repeatability is None
            else " Sigma holds every stated source of error, type A what "
            "the same poses taken again would scatter."
        ),
    )


def _beside(p: Parameter, value: float, places: int, other: Estimate) -> tuple[Cell, ...]:
    known = [q.name for q in other.parameters]
    if p.name not in known:
        return ("", "", "")
    quantity, k = quantity_of(p), known.index(p.name)
    theirs = float(other.x[k])
    return (
        Figure(theirs, quantity, places=places),
        Figure(float(other.standard_deviation[k]), quantity, digits=2),
        Figure(_change(p, theirs, value), quantity, places=places, signed=True),
    )


def _change(parameter: Parameter, value: float, reference: float) -> float:
    change = value - reference
    return math.remainder(change, 2.0 * math.pi) if parameter.is_angle else change


def dh_table(solution: Solution) -> Table | None:
    """D-H table, identified entries beside nominal ones; None for a loop that has none."""
    model = solution.model
    before = model.dh_table(nominal_vector(model.parameters))
    after = model.dh_table(solution.estimate.x)
    if before is None or after is None:
        return None
    kinds = (DhKind.A, DhKind.S, DhKind.ALPHA, DhKind.THETA_OFF)
    nominal, found = before.stacked(), after.stacked()
    every = [
        Parameter(name="", is_angle=kind.is_angle, nominal=float(value))
        for kind in kinds
        for value in nominal[kind]
    ]
    round_places, places = nominal_places(every), precision(solution.identified)
    free, columns = set(model.entries), [Column("link", words=True)]
    for kind in kinds:
        group = f"{kind.symbol} [{_of(kind).unit}]"
        columns += [Column("nominal", group=group), Column("found", group=group)]
    rows = []
    for row in range(before.links):
        cells: list[Cell] = [str(row)]
        for kind in kinds:
            quantity = _of(kind)
            if kind is DhKind.THETA_OFF and (row == 0 or row in model.unsensed_joints):
                cells += [NOT_KNOWN, ""]
                continue
            value = float(found[kind, row])
            cells += [
                Figure(float(nominal[kind, row]), quantity, places=round_places(quantity)),
                Figure(value, quantity, places=places(quantity), role="found")
                if DhEntry(kind, row) in free
                else "",
            ]
        rows.append(tuple(cells))
    return Table(
        ident="dh",
        title="D-H table (Tables 1 and 2 of the paper)",
        columns=tuple(columns),
        rows=tuple(rows),
        note="Link 0 is the fixture; found is empty where an entry was not calibrated.",
    )


def _of(kind: DhKind) -> Quantity:
    return ANGLE if kind.is_angle else LENGTH


# -- how good it is --------------------------------------------------------------------------------


def determined_table(solution: Solution, limits: AcceptanceLimits) -> Table:
    """Condition, rank, degrees of freedom, chi2, weakest direction."""
    estimate, seen = solution.identified, solution.seen
    head = {h.name: h for h in _headlines(solution, limits, 0)}
    weights = ", ".join(
        f"{name} {significant(weight, 2)}"
        for name, weight in zip(seen.weakest.parameters[:4], seen.weakest.weights, strict=False)
    )
    freedom = f"{plural(solution.model.equations_per_pose, 'equation')} a pose, less parameters"
    ended = "converged" if estimate.converged else "did not converge"

    def key(figure: Figure, *key: str) -> Figure:
        return Figure(figure.value, places=figure.places, digits=figure.digits, key=key)

    rows: list[tuple[Cell, ...]] = [
        (
            h.name,
            key(h.figure, {"chi2/dof": "chi2_per_dof"}.get(h.name, h.name.replace(" ", "_"))),
            h.note,
        )
        for h in head.values()
        if not h.name.startswith("sigma_")
    ]
    rows[1:1] = [
        (
            "condition number, 1 m : 1 rad",
            Figure(seen.condition_number, key=("condition_number",)),
            "",
        )
    ]
    if solution.components is not None:
        found = solution.components
        ratio = Figure(found.stated_chi2 / found.stated_dof, key=("stated_chi2_per_dof",))
        rows.append(("chi2/dof at stated noise", ratio, "1 when all is as good as stated"))
    rows += [
        ("degrees of freedom", Figure(estimate.dof, places=0, key=("dof",)), freedom),
        ("iterations", Figure(estimate.iterations, places=0, key=("iterations",)), ended),
    ]
    return Table(
        ident="determined",
        title="How well the poses determine them (no unit)",
        columns=(Column("figure", words=True), Column("value"), Column("", words=True)),
        rows=tuple(rows),
        note=f"Weakest direction: {weights}.",
    )


def observability_table(solution: Solution) -> Table:
    """Return the five observability indices of the literature."""
    return Table(
        ident="observability",
        title="Observability of the scaled Jacobian (no unit)",
        columns=(Column("index", words=True), Column("value"), Column("", words=True)),
        rows=tuple(
            (f"O{k}", Figure(value, key=("observability", f"O{k}")), meaning)
            for k, (value, meaning) in enumerate(
                zip(solution.seen.observability, OBSERVABILITY, strict=True), 1
            )
        ),
        detail=True,
    )


def jackknife_table(estimate: Estimate, spread: FloatArray | None) -> Table | None:
    """Return every sigma beside its spread when each pose in turn is left out."""
    if spread is None:
        return None
    places, rows = precision(estimate), []
    for p, sd, other in zip(estimate.parameters, estimate.standard_deviation, spread, strict=True):
        quantity, n = quantity_of(p), places(quantity_of(p))
        key = ("checks", "jackknife_sigma", p.name)
        pair = Figure(float(sd), quantity, places=n), Figure(float(other), quantity, n, key=key)
        rows.append((p.name, quantity.unit, *pair))
    return Table(
        ident="jackknife",
        title="Sigma by leaving out each pose in turn",
        columns=(
            Column("parameter", words=True),
            Column("unit", words=True),
            Column("sigma"),
            Column("jackknife"),
        ),
        rows=tuple(rows),
        note="Where the jackknife is much larger than sigma, the noise model is too good to be true.",
    )


CLOSURE_COLUMNS = (
    Column("parameters", words=True),
    Column("rms", group="sigma_pos [mm]"),
    Column("as printed", group="sigma_pos [mm]"),
    Column("rms", group="sigma_ori [mrad]"),
    Column("as printed", group="sigma_ori [mrad]"),
)


def closure_table(solution: Solution, beside: Estimate | None, checks: Checks | None) -> Table:
    """Closure sigmas before and after, in both readings, and on poses held out."""
    estimate = solution.identified
    rotations = estimate.rotation_rows
    rows = [
        closure_row("nominal, before", solution.before, rotations, key=("before",)),
        closure_row(f"{estimate.estimator} (chosen), after", estimate.sigmas, rotations, key=()),
    ]
    if beside is not None:
        rows.append(closure_row(f"{beside.estimator}, for comparison", beside.sigmas, rotations))
    held = (
        ()
        if checks is None
        else (
            (f"{FOLDS} folds", "hold_out", checks.held_out),
            ("far block", "far_block", checks.far_block),
        )
    )
    for name, key, found in held:
        if found is not None:
            for words, which, sigmas in (
                ("took part", "inside", found.inside_sigmas),
                ("held out", "held_out", found.sigmas),
            ):
                place = ("checks", key)
                title = f"{name}, {words}"
                rows.append(closure_row(title, sigmas, rotations, key=place, reading=which))
    return Table(
        ident="closure",
        title="Closure at the measured joints (eqs. 14 and 15)",
        columns=CLOSURE_COLUMNS,
        rows=tuple(rows),
    )


def closure_row(
    name: str,
    sigmas: ClosureSigmas,
    rotations: int = 1,
    *,
    key: Key | None = None,
    reading: str = "",
) -> tuple[Cell, ...]:
    """Return one row of closure sigmas.

    Parameters
    ----------
    rotations
        How many rotations close; without any sigma_ori says nothing.
    key
        Where the figures stand in JSON; None: nowhere.
    reading
        JSON's name of a figure that it has in one reading only.
    """
    cells: list[Cell] = [name]
    for symbol, quantity, both, there in (
        ("sigma_pos_mm", CLOSURE_LENGTH, sigmas.position_m, True),
        ("sigma_ori_mrad", CLOSURE_ANGLE, sigmas.orientation_rad, rotations > 0),
    ):
        for value, last in ((both.rms, reading or "rms"), (both.as_printed, "as_printed")):
            listed = key is not None and not (reading and last == "as_printed")
            place = (*key, symbol, last) if key is not None and listed else ()
            cells.append(Figure(value, quantity, digits=4, key=place) if there else NOT_KNOWN)
    return tuple(cells)


def components_table(found: VarianceComponents | None) -> Table | None:
    """Size of every source of error that was estimated, with its interval."""
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
    if found.flexure is not None:
        p = found.flexure.p_value
        chance = f"= {significant(p, 2)}" if p > SMALLEST_P else f"< {SMALLEST_P:.0e}"
        asks = "ask" if found.flexure.gives else "do not ask"
        note = (
            f"The data {asks} for a fixture that gives more than stated (score test, p {chance})."
        )
    return Table(
        ident="noise",
        title="Sources of error, sized by the data",
        columns=(
            Column("source", words=True),
            Column("unit", words=True),
            Column("stated"),
            Column("found"),
            Column("95 % from"),
            Column("to"),
        ),
        rows=tuple(rows),
        note=note,
    )


def _repeatability(solution: Solution) -> FloatArray | None:
    """Type A: standard deviations of what the same poses taken again would give, (P,)."""
    if solution.components is None:
        return None
    sd = np.sqrt(np.diagonal(solution.components.repeatability))
    listed = zip(solution.estimate.parameters, sd.tolist(), strict=True)
    return np.array([s for p, s in listed if p.name not in solution.tolerated])


def budget_table(solution: Solution) -> Table | None:
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
    return Table(
        ident="budget",
        title="Uncertainty budget: share of each variance by source [%]",
        columns=(
            Column("parameter", words=True),
            Column("largest", words=True),
            *(Column(source_words(source), detail=True) for source in budget),
        ),
        rows=tuple(rows),
    )


def source_words(source: str) -> str:
    """Say what a source of the budget is: ``RVDT curve 6``."""
    return source.replace("_", " ").replace("rvdt", "RVDT")


def tolerated_table(solution: Solution) -> Table | None:
    """Lengths and twists that were corrected within their tolerances."""
    estimate = solution.estimate
    places, round_places = precision(estimate), nominal_places(estimate.parameters)
    rows = []
    for p, x, sd in zip(
        estimate.parameters, estimate.x.tolist(), estimate.standard_deviation.tolist(), strict=True
    ):
        if p.name in solution.tolerated:
            quantity, key = quantity_of(p), ("tolerated_parameters", p.name)
            n = places(quantity)
            rows.append(
                (
                    p.name,
                    quantity.unit,
                    Figure(p.nominal, quantity, round_places(quantity), key=(*key, "nominal")),
                    Figure(x, quantity, n, role="found", key=(*key, "value")),
                    Figure(sd, quantity, n, key=(*key, "sigma")),
                )
            )
    return None if not rows else Table(
        ident="tolerated",
        title="Lengths and twists corrected within their tolerances",
        columns=(Column("entry", words=True), Column("unit", words=True), Column("nominal"),
                 Column("found"), Column("sigma")),
        rows=tuple(rows),
        detail=True,
    )  # fmt: skip


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


def correlation_table(estimate: Estimate, strongest: int = 3) -> Table:
    """Correlations of the parameters, lower triangle, shaded by size."""
    matrix = correlations(estimate.covariance)
    listed = [p.name for p in estimate.parameters]

    def cell(k: int, j: int) -> Cell:
        value = float(matrix[k, j])
        step = 0 if j == k else min(HEAT_STEPS, int(abs(value) * HEAT_STEPS + 0.5))
        role = f"{'plus' if value > 0.0 else 'minus'}{step}" if step else "text"
        return Figure(value, places=2, role=role) if j <= k else ""

    pairs = sorted(
        ((a, b, float(matrix[k, j])) for k, a in enumerate(listed)
         for j, b in enumerate(listed[:k])),
        key=lambda pair: -abs(pair[2]),
    )  # fmt: skip
    told = "; ".join(
        f"{a} and {b} {Figure(r, places=3, signed=True).shown}" for a, b, r in pairs[:strongest]
    )
    return Table(
        ident="correlations",
        title="Correlations of the parameters (no unit, from -1 to 1)",
        columns=(Column("parameter", words=True), *(Column(name) for name in listed)),
        rows=tuple(
            (name, *(cell(k, j) for j in range(len(listed)))) for k, name in enumerate(listed)
        ),
        note=f"Hardest to tell apart: {told}.",
        detail=True,
    )
