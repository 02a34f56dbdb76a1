"""Tables of identified values: parameters, D-H table, corrected entries, correlations."""

import math
from collections.abc import Callable, Iterable
from functools import partial

import numpy as np

from operator_app import units
from operator_app.calibration.calibrated_arm import side_of
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.instrument_registration import instrument_stations
from operator_app.calibration.result import Solution
from operator_app.report.table import Cell, Column, FactTable, figures, words
from operator_app.units import Figure, Kind, Valued, places_needed, places_to_show, quantity_of
from solver.chain.parameters import DhEntry, DhKind, Parameter, nominal_vector
from solver.chain.rotations import rotation_vector
from solver.diagnostics.statistics import correlations, intervals
from solver.estimators.estimate import Estimate

MOST_PLACES = 6
"""Maximum number of decimal places: 1 nm and 1 udeg."""

SEVERAL_SIGMAS = 3.0
"""`estimators_table` names the largest difference between the estimators if it is at least this many sigmas."""


def values_of(estimate: Estimate) -> list[tuple[Parameter, float, float]]:
    """Return each parameter with its value and standard deviation, rad or m."""
    columns = estimate.x.tolist(), estimate.standard_deviation.tolist()
    return list(zip(estimate.parameters, *columns, strict=True))


Format = Callable[..., Figure]
"""Function that returns a value of one parameter as a `Figure` with a fixed number of decimal places."""


def formats(estimate: Estimate) -> Callable[[Valued], Format]:
    """Return a function that maps a parameter to its `Format`.

    All angles have as many decimal places as the smallest sigma of an angle needs for two digits. Lengths likewise.
    """
    return formats_of(((p, sd) for p, _, sd in values_of(estimate)), most=MOST_PLACES)


def formats_of(
    sigmas: Iterable[tuple[Valued, float]], *, most: int = 9
) -> Callable[[Valued], Format]:
    """Return what `formats` returns, for parameters with these `sigmas` (rad or m); 3 to `most` decimal places."""
    return _formats(sigmas, partial(places_to_show, least=3, most=most))


def nominal_formats(values: Iterable[tuple[Valued, float]]) -> Callable[[Valued], Format]:
    """Return a function from parameter to `Format`, with the fewest decimal places that show all `values` exactly."""
    return _formats(values, partial(places_needed, least=1, most=MOST_PLACES))


def _formats(
    values: Iterable[tuple[Valued, float]], places_for: Callable[[list[float]], int]
) -> Callable[[Valued], Format]:
    listed = [(quantity_of(p), value) for p, value in values]
    places = {
        quantity: places_for([quantity.per_si * v for own, v in listed if own is quantity])
        for quantity in (units.ANGLE, units.LENGTH)
    }
    return lambda p: partial(Figure, quantity=quantity_of(p), places=places[quantity_of(p)])


def parameter_table(estimate: Estimate, solution: Solution | None = None) -> FactTable:
    """Return the table of each parameter's nominal and identified value, change, sigma and interval.

    With the `solution` that has this estimate, the table also has type A uncertainties, what each parameter describes
    and the values of the other estimator, and JSON has the nominal values.
    """
    beside, within = None, dict[str, float]()
    if solution is not None:
        beside, within = solution.beside, solution.within
    own = f"{estimate.estimator} (chosen)"
    columns = [*words("parameter", "unit"), *figures("nominal")]
    columns += figures("identified", "change", "sigma", group=own)
    columns += figures("type A", group=own) if within else ()
    columns += figures("95 % from", "to", group=own, detail=True)
    columns += (Column("of the", words=True, detail=True),) if solution is not None else ()
    if beside is not None:
        columns += figures("identified", group=beside.estimator)
    format_of = formats(estimate)
    nominal_of = nominal_formats((p, p.nominal) for p in estimate.parameters)
    theirs = {} if beside is None else {p.name: value for p, value, _ in values_of(beside)}
    (low, high), rows = intervals(estimate), []
    for k, (p, value, sd) in enumerate(values_of(estimate)):
        figure, name = format_of(p), p.name
        row: list[Cell] = [
            name,
            quantity_of(p).unit,
            nominal_of(p)(p.nominal, key=() if solution is None else ("nominal", name)),
            figure(value, role="found", key=("parameters", name)),
            figure(change_of(p, value, p.nominal), signed=True),
            figure(sd, key=("sigma", name)),
        ]
        if within:
            row.append(figure(within[name], key=("repeatability", name)))
        ends = enumerate((float(low[k]), float(high[k])))
        row += [figure(end, key=("interval_95", name, which)) for which, end in ends]
        row += [] if solution is None else [side_of(solution.model, name)]
        if beside is not None:
            row.append(figure(theirs[name]) if name in theirs else "")
        rows.append(tuple(row))
    about = "Joint angle = reading + theta_off; change = identified - nominal, angles the short way round."
    if within:
        about += (
            " Sigma is the combined standard uncertainty of all stated sources; type A is the scatter of the same "
            "poses, if taken again."
        )
    if solution is not None:
        about += _side_note(solution)
    return FactTable(
        ident="parameters",
        title="Identified parameters",
        columns=tuple(columns),
        rows=tuple(rows),
        note=about,
    )


def _side_note(solution: Solution) -> str:
    names: dict[str, list[str]] = {"arm": [], "ground": [], "hand": []}
    for parameter in solution.identified.parameters:
        names[side_of(solution.model, parameter.name)].append(parameter.name)
    lists = (f"{side.capitalize()}: {', '.join(n)}." for side, n in names.items() if n)
    none = [] if names["arm"] else ["Arm: none."]
    return " ".join(["", *none, *lists, "Parameters of the arm stay valid in another mounting."])


def estimators_table(solution: Solution) -> FactTable | None:
    """Return the table of both estimators' values and sigmas, and their differences; None if there is only one."""
    estimate, beside = solution.identified, solution.beside
    if beside is None:
        return None
    paper, implicit = sorted((estimate, beside), key=lambda e: e.estimator == "implicit")
    by_paper = {p.name: (value, sd) for p, value, sd in values_of(paper)}
    format_of, rows, most = formats(estimate), [], 0.0
    for p, value, sigma in values_of(implicit):
        if p.name not in by_paper:
            continue
        quantity, figure, (other, its_sigma) = quantity_of(p), format_of(p), by_paper[p.name]
        difference = change_of(p, other, value)
        most = max(most, abs(difference) / its_sigma) if its_sigma > 0.0 else most
        own = figure(value), figure(sigma)
        theirs = figure(other), Figure(its_sigma, quantity, digits=2)
        rows.append((p.name, quantity.unit, *own, *theirs, figure(difference, signed=True)))
    apart = (
        f"; it differs from implicit by up to {most:.0f} sigmas" if most >= SEVERAL_SIGMAS else ""
    )
    return FactTable(
        ident="estimators",
        title="Both estimators, from the same poses",
        columns=(
            *words("parameter", "unit"),
            *figures("value", "sigma", group="implicit"),
            *figures("value", "sigma", group="paper"),
            *figures("difference"),
        ),
        rows=tuple(rows),
        note="The solution diverged: neither estimate is usable."
        if solution.adjudication.diverged
        else "Use implicit: it weights every reading by its noise and includes errors of lengths, twists and "
        "curves. The paper's estimator counts 1 m as 1 rad and treats readings as exact, so its sigmas are only the "
        f"scatter of its residuals{apart}. Both use the same poses: their difference is no change of the arm.",
    )


def change_of(parameter: Parameter, value: float, reference: float) -> float:
    """Return value minus reference; for an angle, modulo a turn, between -pi and pi."""
    change = value - reference
    return math.remainder(change, 2.0 * math.pi) if parameter.is_angle else change


def dh_table(solution: Solution) -> FactTable | None:
    """Return the D-H table with nominal and identified entries; None for a loop without a D-H table."""
    model = solution.model
    before = model.dh_table(nominal_vector(model.parameters))
    after = model.dh_table(solution.estimate.x)
    if before is None or after is None:
        return None
    nominal, identified = before.stacked(), after.stacked()
    free = set(model.entries)
    with_beta = any(e.kind is DhKind.BETA for e in free) or bool(before.beta_rad.any())
    kinds = shown_kinds(with_beta=with_beta)
    format_of = formats(solution.identified)
    nominal_of = nominal_formats((kind, float(v)) for kind in kinds for v in nominal[kind])
    columns = [*words("link")]
    for kind in kinds:
        columns += figures("nominal", "found", group=f"{kind.symbol} [{quantity_of(kind).unit}]")
    rows = []
    for row in range(before.links):
        cells: list[Cell] = [str(row)]
        for kind in kinds:
            if kind is DhKind.THETA_OFF and (row == 0 or row in model.unsensed_joints):
                cells += [units.NOT_AVAILABLE, ""]
                continue
            value = format_of(kind)(float(identified[kind, row]), role="found")
            nominal_value = nominal_of(kind)(float(nominal[kind, row]))
            cells += [nominal_value, value if DhEntry(kind, row) in free else ""]
        rows.append(tuple(cells))
    return FactTable(
        ident="dh",
        title="D-H table (Tables 1 and 2 of the paper)",
        columns=tuple(columns),
        rows=tuple(rows),
        note="Link 0 is the fixture; found is empty where an entry was not calibrated.",
    )


def instrument_table(solution: Solution) -> FactTable | None:
    """Return the table of the calibrated poses of the arm's base and of the target; None without an instrument."""
    length, angle = Kind(units.LENGTH, places=3), Kind(units.ANGLE, places=4)
    rows: list[tuple[Cell, ...]] = []
    stations = instrument_stations(solution)
    for s in stations:
        name = "base" if s.placement is None else f"base, placement {s.placement}"
        places = [(name, s.T_instrument_base, True)]
        if s is stations[-1]:
            places.append(("target", s.T_flange_target, s.full_pose))
        for frame, T, turns in places:
            turn = rotation_vector(T[:3, :3]).tolist() if turns else (None,) * 3
            rows.append((frame, *map(length, T[:3, 3].tolist()), *map(angle, turn)))
    return None if not rows else FactTable(
        ident="instrument",
        title="Calibrated places of base and target [mm, deg]",
        columns=(*words("of"), *figures("x", "y", "z"), *figures("rx", "ry", "rz")),
        rows=tuple(rows),
        note="Base in the instrument's frame, target in the flange frame: position and rotation vector (axis times "
        "angle), as base_mm, base_turn_deg, tip_mm and tip_turn_deg of a fixture file. The parameters base_r* and "
        "tip_r* are small turns on a nominal orientation that was itself found from the poses: R = exp(r) R_nominal.",
    )  # fmt: skip


def shown_kinds(*, with_beta: bool) -> tuple[DhKind, ...]:
    """Return the kinds of entries that a D-H table shows as columns; beta only if `with_beta`."""
    beta = (DhKind.BETA,) if with_beta else ()
    return (DhKind.A, DhKind.S, DhKind.ALPHA, *beta, DhKind.THETA_OFF)


def jackknife_table(solution: Solution, checks: Checks | None) -> FactTable | None:
    """Return the table of sigmas and jackknife sigmas (each pose left out in turn); None if not computed."""
    if checks is None or checks.jackknife_sd is None:
        return None
    estimate, jackknife = solution.identified, checks.jackknife_sd.tolist()
    format_of, rows = formats(estimate), []
    for (p, _, sd), other in zip(values_of(estimate), jackknife, strict=True):
        figure, key = format_of(p), ("checks", "jackknife_sigma", p.name)
        rows.append((p.name, quantity_of(p).unit, figure(sd), figure(other, key=key)))
    return FactTable(
        ident="jackknife",
        title="Sigma by leaving out each pose in turn",
        columns=(*words("parameter", "unit"), *figures("sigma", "jackknife")),
        rows=tuple(rows),
        note="If the jackknife is much larger than sigma, the stated noise is too small. The jackknife "
        "shows errors that differ from pose to pose, not those that all poses share, such as lengths.",
    )


def tolerated_table(solution: Solution) -> FactTable | None:
    """Return the table of lengths, twists and offsets that were free within tolerances; None if there are none."""
    estimate, rows = solution.estimate, []
    format_of = formats(estimate)
    nominal_of = nominal_formats((p, p.nominal) for p in estimate.parameters)
    for p, x, sd in values_of(estimate):
        if p.name in solution.tolerated:
            figure, key = format_of(p), ("tolerated_parameters", p.name)
            nominal = nominal_of(p)(p.nominal, key=(*key, "nominal"))
            both = figure(x, role="found", key=(*key, "value")), figure(sd, key=(*key, "sigma"))
            rows.append((p.name, quantity_of(p).unit, nominal, *both))
    offsets = any(name.startswith("theta_off_") for name in solution.tolerated)
    what = "Lengths, twists and offsets" if offsets else "Lengths and twists"
    return None if not rows else FactTable(
        ident="tolerated",
        title=f"{what} corrected within their tolerances",
        columns=(*words("entry", "unit"), *figures("nominal", "found", "sigma")),
        rows=tuple(rows),
        detail=True,
    )  # fmt: skip


def correlation_table(solution: Solution) -> FactTable:
    """Return the table of the parameters' correlations, lower triangle."""
    estimate = solution.identified
    matrix = correlations(estimate.covariance)
    listed = [p.name for p in estimate.parameters]
    rows = [
        (name, *(Figure(v, places=2) if j <= k else "" for j, v in enumerate(matrix[k].tolist())))
        for k, name in enumerate(listed)
    ]
    lower = zip(*np.tril_indices(len(listed), -1), strict=True)
    pairs = sorted(lower, key=lambda pair: -abs(matrix[pair]))
    largest = "; ".join(
        f"{listed[k]} and {listed[j]} {Figure(float(matrix[k, j]), places=3, signed=True).shown}"
        for k, j in pairs[:3]
    )
    return FactTable(
        ident="correlations",
        title="Correlations of the parameters (no unit, from -1 to 1)",
        columns=(*words("parameter"), *figures(*listed)),
        rows=tuple(rows),
        note=f"Most correlated: {largest}.",
        detail=True,
    )
