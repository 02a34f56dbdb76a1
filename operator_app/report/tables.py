"""The tables of a report about parameters: values, D-H, sigmas, noise, correlations. Knows no page."""

from __future__ import annotations

import math
from collections.abc import Sequence

from operator_app.report.markup import Column, Html, element, table
from operator_app.report.numbers import MINUS, NOT_KNOWN, fixed, places_to_show, significant
from operator_app.report.style import HEAT_STEPS
from operator_app.report.subject import Subject
from solver.chain.parameters import DhEntry, DhKind, Parameter, nominal_vector
from solver.estimators.component_report import Component
from solver.estimators.estimate import Estimate
from solver.estimators.goodness import ClosureSigmas
from solver.judging.statistics import correlations, intervals


def parameter_table(subject: Subject, estimate: Estimate) -> Html:
    """Nominal, identified, change, sigma and interval, with the other estimator beside it."""
    other = subject.paper if estimate.estimator == "implicit" else subject.implicit
    chosen = f"{estimate.estimator} (chosen)"
    columns = [
        Column(title="parameter", number=False),
        Column(title="unit", number=False),
        Column(title="nominal"),
        Column(title="identified", group=chosen),
        Column(title="change", group=chosen),
        Column(title="sigma", group=chosen),
        Column(title="95 % from", group=chosen),
        Column(title="to", group=chosen),
    ]
    bounds = intervals(estimate)
    spread = subject.checks.jackknife_sd if estimate.estimator == "implicit" else None
    if spread is not None:
        columns.append(Column(title="sigma by jackknife", group=chosen))
    if other is not None:
        columns += [
            Column(title="identified", group=other.estimator),
            Column(title="sigma", group=other.estimator),
            Column(title="difference", group=other.estimator),
        ]
    places = {
        angle: places_to_show(
            [
                _scale(p) * float(s)
                for p, s in zip(
                    estimate.parameters, estimate.standard_deviation.tolist(), strict=True
                )
                if p.is_angle is angle
            ],
            least=3,
        )
        for angle in (True, False)
    }
    rows = []
    for k, p in enumerate(estimate.parameters):
        scale, n = _scale(p), places[p.is_angle]
        value, sigma = float(estimate.x[k]), float(estimate.standard_deviation[k])
        row = [
            element("code", p.name),
            "deg" if p.is_angle else "mm",
            fixed(p.nominal * scale, 2),
            element("span", fixed(value * scale, n), class_="found"),
            fixed(_change(p, value, p.nominal) * scale, n, signed=True),
            fixed(sigma * scale, n),
            fixed(bounds[k].low * scale, n),
            fixed(bounds[k].high * scale, n),
        ]
        if spread is not None:
            row.append(fixed(float(spread[k]) * scale, n))
        if other is not None:
            beside = float(other.x[k])
            row += [
                fixed(beside * scale, n),
                significant(float(other.standard_deviation[k]) * scale, 2),
                fixed(_change(p, beside, value) * scale, n, signed=True),
            ]
        rows.append(row)
    return table("Identified parameters", columns, rows)


def dh_table(subject: Subject, estimate: Estimate) -> Html | None:
    """D-H table, identified entries beside nominal ones; None for a loop that has none."""
    model = None if subject.solution is None else subject.solution.model
    before = None if model is None else model.dh_table(nominal_vector(model.parameters))
    after = None if model is None else model.dh_table(estimate.x)
    if model is None or before is None or after is None:
        return None
    nominal, found = before.stacked(), after.stacked()
    free = set(model.entries)
    kinds = (
        (DhKind.A, "a", "mm", 1e3, 3),
        (DhKind.S, "s", "mm", 1e3, 3),
        (DhKind.ALPHA, "alpha", "deg", 180.0 / math.pi, 3),
        (DhKind.THETA_OFF, "theta_off", "deg", 180.0 / math.pi, 3),
    )
    columns = [Column(title="link", number=False)]
    for _, symbol, unit, _, _ in kinds:
        group = f"{symbol} [{unit}]"
        columns += [
            Column(title="nominal", group=group),
            Column(title="identified", group=group),
        ]
    rows = []
    for row in range(before.links):
        cells = [f"{row}" + (" (fixture)" if row == 0 else "")]
        for kind, _, _, scale, places in kinds:
            if kind is DhKind.THETA_OFF and (row == 0 or row in model.unsensed_joints):
                cells += ["unsensed" if row == 0 else "not used", ""]
                continue
            cells.append(fixed(nominal[kind, row] * scale, 1))
            known = DhEntry(kind, row) not in free
            value = "" if known else fixed(found[kind, row] * scale, places)
            cells.append(element("span", value, class_="found") if value else "")
        rows.append(cells)
    return table(
        "Denavit-Hartenberg table, links 0 to n: empty where an entry was not calibrated",
        columns,
        rows,
    )


def sigma_table(subject: Subject, estimate: Estimate) -> Html:
    """Closure sigmas before and after, in both readings of eqs. 14 and 15, by both estimators."""
    solution = subject.solution
    if solution is None:
        raise ValueError("nothing was solved")
    columns = [Column(title="parameters", number=False)]
    for figure, unit in (("sigma_pos", "mm"), ("sigma_ori", "mrad")):
        group = f"{figure} [{unit}]"
        columns += [Column(title="rms", group=group), Column(title="as printed", group=group)]
    others = [
        e
        for e in (subject.implicit, subject.paper)
        if e is not None and e.estimator != estimate.estimator
    ]
    held = subject.checks.held_out
    rows = [
        ["nominal, before", *_sigmas(solution.before, estimate)],
        [f"{estimate.estimator} (chosen), after", *_sigmas(estimate.sigmas, estimate)],
        *([f"{e.estimator}, for comparison", *_sigmas(e.sigmas, e)] for e in others),
    ]
    if held is not None and subject.implicit is not None:
        parts = f"implicit, poses held out ({len(held.parts)} parts)"
        rows.append([parts, *_sigmas(held.sigmas, subject.implicit)])
    return table("Closure at the measured joints (eqs. 14 and 15)", columns, rows)


def component_table(components: Sequence[Component]) -> Html:
    """Size of every source of error that was estimated, with its interval."""
    columns = [
        Column(title="source", number=False),
        Column(title="unit", number=False),
        Column(title="sigma"),
        Column(title="95 % from"),
        Column(title="to"),
    ]
    rows = [
        [
            component_words(c.name),
            "mrad" if c.unit == "rad" else "mm",
            element("span", significant(1e3 * c.sd), class_="found"),
            significant(1e3 * c.low),
            significant(1e3 * c.high),
        ]
        for c in components
    ]
    return table("Sources of error, sized by the data", columns, rows)


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


def correlation_table(estimate: Estimate) -> Html:
    """Correlations of the parameters, lower triangle, shaded by size."""
    correlation = correlations(estimate.covariance)
    names = [p.name for p in estimate.parameters]
    head = element(
        "tr",
        element("th", "parameter", scope="col"),
        *(element("th", name, scope="col") for name in names),
    )
    body = []
    for k, name in enumerate(names):
        cells = [element("th", element("code", name), scope="row")]
        for other in range(len(names)):
            if other > k:
                cells.append(element("td"))
                continue
            value = float(correlation[k, other])
            step = 0 if other == k else min(HEAT_STEPS, int(abs(value) * HEAT_STEPS + 0.5))
            sign = "p" if value > 0.0 else "m"
            cells.append(element("td", fixed(value, 2), class_=f"{sign}{step}" if step else None))
        body.append(element("tr", *cells))
    caption = f"Correlations of the parameters (no unit, from {MINUS}1 to 1)"
    made = element(
        "table",
        element("caption", element("span", caption)),
        element("thead", head),
        element("tbody", *body),
        class_="heat",
    )
    return element("div", made, class_="scroll", role="region", aria_label=caption, tabindex=0)


def strongest_correlations(estimate: Estimate, count: int = 3) -> list[tuple[str, str, float]]:
    """Return the pairs of parameters that are hardest to tell apart."""
    correlation = correlations(estimate.covariance)
    names = [p.name for p in estimate.parameters]
    pairs = [(a, b, float(correlation[k, j])) for k, a in enumerate(names)
             for j, b in enumerate(names[:k])]  # fmt: skip
    return sorted(pairs, key=lambda pair: -abs(pair[2]))[:count]


def _sigmas(sigmas: ClosureSigmas, estimate: Estimate) -> list[str]:
    cells = [
        significant(1e3 * sigmas.position_m.rms, 4),
        significant(1e3 * sigmas.position_m.as_printed, 4),
    ]
    if not estimate.rotation_rows:
        return [*cells, NOT_KNOWN, NOT_KNOWN]
    return [
        *cells,
        significant(1e3 * sigmas.orientation_rad.rms, 4),
        significant(1e3 * sigmas.orientation_rad.as_printed, 4),
    ]


def _scale(parameter: Parameter) -> float:
    """From SI to deg or mm."""
    return 180.0 / math.pi if parameter.is_angle else 1e3


def _change(parameter: Parameter, value: float, reference: float) -> float:
    change = value - reference
    return math.remainder(change, 2.0 * math.pi) if parameter.is_angle else change
