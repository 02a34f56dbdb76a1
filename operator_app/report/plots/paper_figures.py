"""The figures of a calibration for a paper: what each shows, from the facts and the page's own pictures.

`figure_files` draws them. Nothing is computed here.
"""

from __future__ import annotations

import re
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from itertools import accumulate
from types import MappingProxyType

from operator_app.report.facts import Facts
from operator_app.report.plots import before_after, calibration_plots
from operator_app.report.plots.plot import Axis, Picture, axis, log_axis
from operator_app.report.plots.strips import Bars
from operator_app.report.subject import Subject
from operator_app.report.table import FactTable
from operator_app.units.figure import ANGLE, LENGTH, Figure

MOST_SOURCES = 7
"""Of a budget: as many as colours tell apart; the rest are put together."""
PERCENTS = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panels:
    """Pictures in one figure, in rows of so many; `words` say of each which it is."""

    pictures: tuple[Picture | Bars, ...]
    columns: int = 1
    words: tuple[str, ...] = ()


def drawing(subject: Subject, name: str) -> Panels:
    """Return what one of `FIGURES` shows.

    Raises
    ------
    KeyError
        This calibration has nothing to put in it, or there is no such figure; lists those there are.
    """
    found = FIGURES[name][1](subject) if name in FIGURES else None
    if found is None:
        raise KeyError(f"no figure {name!r}; there are {', '.join(drawings(subject))}")
    return found


def drawings(subject: Subject) -> Mapping[str, Panels]:
    """Return all that there are, by name."""
    found = {name: make(subject) for name, (_, make) in FIGURES.items()}
    return {name: shown for name, shown in found.items() if shown is not None}


def _residuals(subject: Subject) -> Panels | None:
    if subject.solution is None:
        return None
    estimate = subject.solution.identified
    shown = (
        *calibration_plots.closure_by_pose(subject, estimate),
        calibration_plots.misses(subject, estimate),
    )
    return Panels(pictures=shown)


def _parameters(subject: Subject) -> Panels | None:
    table = _table(subject, "parameters")
    if table is None:
        return None
    by_unit: dict[str, list[int]] = {}
    for k, row in enumerate(table.rows):
        by_unit.setdefault(str(row[1]), []).append(k)
    titles = [c.title for c in table.columns]
    # The chosen estimator's columns come first, and what it did not estimate is not there.
    at = {title: titles.index(title) for title in reversed(titles)}
    kinds = {"sigma": "all sources", "type A": "repeatability"}

    def column(title: str, rows: list[int]) -> tuple[float, ...]:
        return tuple(_number(table.rows[k][at[title]]) for k in rows)

    before = [_stated(subject, str(row[at["of the"]]), str(row[1])) for row in table.rows]
    shown: list[Bars] = []
    for unit, rows in by_unit.items():
        names = [str(table.rows[k][0]) for k in rows]
        identified, change = column("identified", rows), column("change", rows)
        low, high = (
            [c + e - v for c, e, v in zip(change, column(title, rows), identified, strict=True)]
            for title in ("95 % from", "to")
        )
        shown.append(
            Bars(
                x=axis("change from nominal", [*low, *high, 0.0], unit=unit),
                names=names,
                bars={"95 % interval": tuple(zip(low, high, strict=True))},
                marks={"identified": change},
            )
        )
        sigmas = {words: column(t, rows) for t, words in kinds.items() if t in titles}
        sigmas["stated before"] = tuple(before[k] for k in rows)
        known = [s for values in sigmas.values() for s in values]
        shown.append(Bars(x=log_axis("sigma", known, unit=unit), names=names, marks=sigmas))
    return Panels(pictures=tuple(shown), columns=2)


def _stated(subject: Subject, side: str, unit: str) -> float:
    """How well a parameter was known before, by the files, in its unit; nan where none states it."""
    fixture, arm = subject.procedure.fixture, subject.procedure.arm
    if side != "arm":
        stated: float | None = fixture.tolerance_m if unit == LENGTH.unit else fixture.tolerance_rad
    else:
        stated = arm.offset_tolerance_rad if unit == ANGLE.unit else None
    quantity = LENGTH if unit == LENGTH.unit else ANGLE
    return float("nan") if stated is None else quantity.per_si * stated


def _budget(subject: Subject) -> Panels | None:
    table = _table(subject, "budget")
    if table is None:
        return None
    table = table.whole
    # The RVDTs of all joints together: a bar shows which joint's it is.
    kinds = [re.sub(r" \d+$", "", c.title) for c in table.columns[1:]]
    sources = list(dict.fromkeys(kinds))
    shares = [
        [
            sum(max(0.0, _number(c)) for c, k in zip(row[1:], kinds, strict=True) if k == source)
            for source in sources
        ]
        for row in table.rows
    ]
    order = sorted(range(len(sources)), key=lambda k: -sum(row[k] for row in shares))
    kept, rest = order[:MOST_SOURCES], order[MOST_SOURCES:]
    percent = [[row[k] for k in kept] + [sum(row[k] for k in rest)] for row in shares]
    ends = [[*accumulate(row, initial=0.0)] for row in percent]
    return Panels(
        pictures=(
            Bars(
                x=Axis(label="share of variance", unit="%", low=0.0, high=100.0, ticks=PERCENTS),
                names=[str(row[0]) for row in table.rows],
                bars={
                    source: [(row[k], row[k + 1]) for row in ends]
                    for k, source in enumerate([*(sources[k] for k in kept), "all others"])
                },
            ),
        )
    )


def _rvdt(subject: Subject) -> Panels | None:
    verdicts = () if subject.solution is None else subject.solution.rvdt
    shown = tuple(
        calibration_plots.rvdt_deviations(subject, v.joint, v.figures)
        for v in verdicts
        if v.figures is not None
    )
    return Panels(pictures=shown, columns=2) if shown else None


def _condition(subject: Subject) -> Panels | None:
    if subject.solution is None or len(subject.solution.seen.trend) < 2:
        return None
    limit = subject.procedure.acceptance.scaled_condition_number
    return Panels(pictures=(calibration_plots.condition_trend(subject.solution.seen.trend, limit),))


def _workspace(subject: Subject) -> Panels | None:
    if subject.solution is None:
        return None
    return _pair(before_after.hand_pair(subject.solution, subject.procedure.arm))


def _arm(subject: Subject) -> Panels | None:
    return _pair(before_after.arm_pair(subject))


def _pair(pair: before_after.Pair | None) -> Panels | None:
    return (
        None
        if pair is None
        else Panels(pictures=(pair.before, pair.after), columns=2, words=("before", "after"))
    )


FIGURES: Mapping[str, tuple[str, Callable[[Subject], Panels | None]]] = MappingProxyType(
    {
        "parameters": ("change of every parameter with its 95 % interval, and sigmas", _parameters),
        "residuals": ("closure of every pose at the joints as read", _residuals),
        "budget": ("what each source of error brings to each variance", _budget),
        "rvdt": ("deviation of the RVDTs with the strip that it is known to", _rvdt),
        "workspace": ("how far off the hand is before and after, over the workspace", _workspace),
        "arm": ("arm and fixture in one pose, before and after", _arm),
        "condition": ("scaled condition number as the poses came", _condition),
    }
)
"""Figures by name: what each shows, in words, and where it comes from."""


def _table(subject: Subject, ident: str) -> FactTable | None:
    facts: Facts | None = subject.facts
    return None if facts is None else facts.table(ident)


def _number(cell: Figure | str) -> float:
    """Return a cell's number in the unit in which it is shown."""
    if isinstance(cell, str) or cell.value is None:
        return float("nan")
    return cell.quantity.per_si * cell.value
