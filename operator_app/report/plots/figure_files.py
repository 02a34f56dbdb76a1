"""Figures for a paper: the report's pictures as SVG files and, if ``sarcal[plots]`` is installed, as PDF files.

One column of a scientific journal is 88 mm wide, two are 180 mm. Colours are those of the page's light theme; bars have
the colours of Okabe and Ito, which colour-blind readers can tell apart, and marks differ in shape as well.
"""

from __future__ import annotations

import io
import math
import re
from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, field
from importlib.util import find_spec
from itertools import chain, pairwise
from os import PathLike
from pathlib import Path
from types import MappingProxyType
from typing import Any

import numpy as np

from operator_app.calibration.error_model import stated_priors
from operator_app.calibration.result import Solution
from operator_app.config.atomic import write_atomically
from operator_app.config.errors import WriteError
from operator_app.errors import SessionError
from operator_app.report.html.markup import LIGHT_COLOURS, PLOT_RULES, Html, element
from operator_app.report.parameter_tables import change_of
from operator_app.report.plots import before_after, calibration_plots, svg
from operator_app.report.plots.plot import Axis, Picture, Shape, axis, log_axis
from operator_app.report.subject import Subject
from operator_app.report.uncertainty_tables import source_words
from operator_app.units import Quantity, quantity_of
from solver.arrays import FloatArray
from solver.diagnostics.statistics import intervals

ONE_COLUMN_MM, TWO_COLUMNS_MM = 88, 180
TITLE = 16.0
"""Height of the caption above a panel, in the units of its picture."""
BARS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#bdbdbd")
ENDINGS = ("svg", "pdf")
FONT, PDF_FONT = '"DejaVu Sans", Verdana, sans-serif', "Vera"
"""Fonts of SVG and PDF. The PDF library includes Vera; the standard fonts of PDF readers have no minus sign."""


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """One figure: a notebook shows the figure, `savefig` writes it to a file."""

    svg: str

    def _repr_svg_(self) -> str:
        return self.svg

    def savefig(self, path: str | PathLike[str]) -> None:
        """Write the figure to a file whose name ends in ``.svg`` or ``.pdf``.

        Raises ValueError for another ending, SessionError if a PDF needs svglib and it is not installed, WriteError if
        the file cannot be written.
        """
        ending = Path(path).suffix.removeprefix(".").lower()
        if ending not in ENDINGS:
            raise ValueError(f"a figure is saved as .svg or .pdf, not as {Path(path).name!r}")
        write_atomically(Path(path), _pdf(self.svg) if ending == "pdf" else self.svg.encode())


def figure(subject: Subject, name: str) -> PaperFigure:
    """Return the figure with this name; raises KeyError, with the available names, if there is none."""
    solution, make = subject.solution, FIGURES.get(name)
    panels = None if solution is None or make is None else make(subject, solution)
    if panels is None:
        raise KeyError(f"no figure {name!r}; there are {', '.join(drawings(subject))}")
    return PaperFigure(_document(panels))


def save_figures(subject: Subject, folder: Path) -> tuple[Path, ...]:
    """Write all figures into a folder, as SVG and, if svglib is installed, PDF; raises WriteError."""
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(file=str(folder), reason=error.strerror or str(error)) from error
    written = []
    for name, panels in drawings(subject).items():
        made = PaperFigure(_document(panels))
        for ending in ENDINGS if find_spec("svglib") else ENDINGS[:1]:
            written.append(folder / f"{name}.{ending}")
            made.savefig(written[-1])
    return tuple(written)


def _document(of: Panels) -> str:
    columns = min(of.columns, len(of.pictures))
    captions = of.words or ("",) * len(of.pictures)
    title_height = TITLE if len(of.pictures) > 1 else 0.0
    parts: list[Html] = []
    top = 0.0
    for first in range(0, len(of.pictures), columns):
        tallest = 0.0
        for k, shown in enumerate(of.pictures[first : first + columns]):
            drawn = bars(shown) if isinstance(shown, Bars) else svg.draw(shown)
            title = f"({chr(ord('a') + first + k)}) {captions[first + k]}".rstrip()
            above = [svg.label(title, 2.0, -4.0, class_="legend")] if title_height else []
            at = f"translate({svg.PLOT_WIDTH * k:g} {top + title_height:g})"
            parts.append(element("g", *above, *drawn.parts, transform=at))
            tallest = max(tallest, drawn.height + title_height)
        top += tallest
    width_mm = ONE_COLUMN_MM if columns == 1 else TWO_COLUMNS_MM
    return element(
        "svg",
        element("style", Html(_style())),
        *parts,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {svg.PLOT_WIDTH * columns:g} {top:g}",
        width=f"{width_mm}mm",
        height=f"{width_mm * top / (svg.PLOT_WIDTH * columns):.1f}mm",
    )


def _style() -> str:
    rules = re.sub(r"var\(--(\w+)\)", lambda m: LIGHT_COLOURS[m[1]], PLOT_RULES)
    fills = "".join(f".bar.b{k}{{fill:{colour}}}" for k, colour in enumerate(BARS))
    return f"text{{font-family:{FONT};font-size:9.6px}}{rules}{fills}"


def _pdf(svg: str) -> bytes:
    """Return an SVG file converted to PDF; the same picture gives the same bytes."""
    try:
        from reportlab.graphics import renderPDF
        from reportlab.pdfbase import pdfmetrics
        from reportlab.pdfbase.ttfonts import TTFont
        from reportlab.pdfgen.canvas import Canvas
        from svglib.svglib import svg2rlg
    except ImportError as error:
        raise SessionError(
            "a PDF of a figure needs svglib, which is not installed", "pip install 'sarcal[plots]'"
        ) from error
    pdfmetrics.registerFont(TTFont(PDF_FONT, f"{PDF_FONT}.ttf"))
    converted: Any = svg2rlg(io.StringIO(svg.replace(FONT, PDF_FONT)))
    file = io.BytesIO()
    canvas = Canvas(file, pagesize=(converted.width, converted.height), invariant=1)
    renderPDF.draw(converted, canvas, 0, 0)
    canvas.save()
    return file.getvalue()


NAME_WIDTH, BAR_HEIGHT, LEGEND, FOOT = 74.0, 13.0, 12.0, 32.0


@dataclass(frozen=True, slots=True, kw_only=True)
class Bars:
    """Rows of bars and marks on one x axis, one row for each of `names`.

    `bars`: start and end of the bar in each row, by label in the legend.
    `marks`: value marked in each row, by label in the legend; non-finite values are not drawn.
    """

    x: Axis
    names: Sequence[str]
    bars: Mapping[str, Sequence[tuple[float, float]]] = field(default_factory=dict)
    marks: Mapping[str, Sequence[float]] = field(default_factory=dict)


def bars(of: Bars) -> svg.Drawn:
    """Draw rows of bars and marks, and above these a legend with three labels per line."""
    bars, labels = list(of.bars.values()), [*of.bars, *of.marks]
    top = LEGEND * -(-len(labels) // 3) + 6.0
    foot = top + BAR_HEIGHT * len(of.names)
    # A single kind of bar is the uncertainty of the marks; several are distinguished by colour.
    fill = "ribbon" if len(bars) == 1 else "bar b{}"
    shapes: list[tuple[Shape, str]] = [("dot", "a"), ("triangle", "c"), ("square", "d")]
    parts = []
    for k, legend in enumerate(labels):
        x, y = 2.0 + (k % 3) * (svg.RIGHT - 2.0) / 3.0, LEGEND * (k // 3 + 1)
        if k < len(bars):
            sign = svg.rectangle(x, y - 7.0, 9.0, 7.0, fill.format(k))
        else:
            shape, colour = shapes[k - len(bars)]
            sign = svg.mark(shape, x + 4.0, y - 3.5, 2.4, colour)
        parts += [sign, svg.label(legend, x + 12.0, y, class_="legend")]
    for value in of.x.ticks:
        x_at = of.x.place(value, NAME_WIDTH, svg.RIGHT)
        parts.append(svg.segment(x_at, top, x_at, foot, "zero" if value == 0.0 else "grid"))
    for k, name in enumerate(of.names):
        y = top + BAR_HEIGHT * k
        parts.append(svg.label(name, 2.0, y + 8.6, class_="legend"))
        for number, pieces in enumerate(bars):
            start, end = (of.x.place(value, NAME_WIDTH, svg.RIGHT) for value in pieces[k])
            width, class_ = max(0.0, end - start), fill.format(number)
            parts.append(svg.rectangle(start, y + 2.0, width, BAR_HEIGHT - 4.0, class_))
        for (shape, colour), values in zip(shapes, of.marks.values(), strict=False):
            if math.isfinite(values[k]):
                x_at = of.x.place(values[k], NAME_WIDTH, svg.RIGHT)
                parts.append(svg.mark(shape, x_at, y + 0.5 * BAR_HEIGHT, 2.4, colour))
    title = svg.label(of.x.title, svg.RIGHT, foot + FOOT - 3.0, class_="axis", anchor="end")
    return svg.Drawn(foot + FOOT, (*parts, *svg.ticks(of.x, NAME_WIDTH, svg.RIGHT, foot), title))


MOST_SOURCES = 7
"""Number of sources of a budget that have their own colour; all others are drawn as one source."""
PERCENTS = (0.0, 20.0, 40.0, 60.0, 80.0, 100.0)


@dataclass(frozen=True, slots=True, kw_only=True)
class Panels:
    """The pictures of one figure, in rows of `columns` pictures; `words` has the caption of each picture."""

    pictures: tuple[Picture | Bars, ...]
    columns: int = 1
    words: tuple[str, ...] = ()


def drawings(subject: Subject) -> Mapping[str, Panels]:
    """Return the panels of all figures of a calibration, by name of the figure."""
    if (solution := subject.solution) is None:
        return {}
    by_name = {name: make(subject, solution) for name, make in FIGURES.items()}
    return {name: panels for name, panels in by_name.items() if panels is not None}


def _parameters(subject: Subject, solution: Solution) -> Panels:
    estimate, (low, high) = solution.identified, intervals(solution.identified)
    arm, fixture = subject.procedure.arm, subject.procedure.fixture.fixture
    arm = arm.with_length_tolerance(solution.length_tolerance_m)
    stated = stated_priors(solution.model, arm, fixture)
    of_quantity: dict[Quantity, list[int]] = {}
    for k, p in enumerate(estimate.parameters):
        of_quantity.setdefault(quantity_of(p), []).append(k)
    shown: list[Bars] = []
    for quantity, rows in of_quantity.items():
        listed, scale = [estimate.parameters[k] for k in rows], quantity.per_si
        names, x = [p.name for p in listed], estimate.x[rows].tolist()
        change = [scale * change_of(p, v, p.nominal) for p, v in zip(listed, x, strict=True)]
        ends = [
            (c + scale * float(low[k] - v), c + scale * float(high[k] - v))
            for k, c, v in zip(rows, change, x, strict=True)
        ]
        x_axis = axis("change from nominal", [*chain(*ends), 0.0], unit=quantity.unit)
        interval, identified = {"95 % interval": ends}, {"identified": change}
        shown.append(Bars(x=x_axis, names=names, bars=interval, marks=identified))
        sigmas = {"all sources": (scale * estimate.standard_deviation[rows]).tolist()}
        if solution.components is not None:
            sigmas["repeatability"] = [scale * solution.within[name] for name in names]
        sigmas["stated before"] = [scale * stated.get(name, math.nan) for name in names]
        x_axis = log_axis("sigma", chain(*sigmas.values()), unit=quantity.unit)
        shown.append(Bars(x=x_axis, names=names, marks=sigmas))
    return Panels(pictures=tuple(shown), columns=2)


def _budget(_: Subject, solution: Solution) -> Panels | None:
    if solution.components is None:
        return None
    listed = solution.estimate.parameters
    rows = [k for k, p in enumerate(listed) if p.name not in solution.tolerated]
    total = np.diagonal(solution.estimate.covariance)[rows]
    nothing = np.zeros(len(rows))
    percent: dict[str, FloatArray] = {}
    for source, variance in solution.components.budget.items():
        # Sources of one kind share a colour, whatever the joint.
        kind = re.sub(r" \d+$", "", source_words(source))
        share = np.divide(100.0 * variance[rows], total, out=nothing.copy(), where=total > 0.0)
        percent[kind] = percent.get(kind, nothing) + np.maximum(share, 0.0)
    order = sorted(percent, key=lambda kind: -float(percent[kind].sum()))
    largest = {kind: percent[kind] for kind in order[:MOST_SOURCES]}
    largest["all others"] = sum((percent[kind] for kind in order[MOST_SOURCES:]), nothing)
    ends = np.cumsum([nothing, *largest.values()], axis=0).tolist()
    pairs = (list(zip(*pair, strict=True)) for pair in pairwise(ends))
    pieces = dict(zip(largest, pairs, strict=True))
    x = Axis(label="share of variance", unit="%", low=0.0, high=100.0, ticks=PERCENTS)
    return Panels(pictures=(Bars(x=x, names=[listed[k].name for k in rows], bars=pieces),))


def _rvdt(subject: Subject, solution: Solution) -> Panels | None:
    measured = [(v.joint, v.figures) for v in solution.rvdt if v.figures is not None]
    shown = tuple(calibration_plots.rvdt_deviations(subject, j, f) for j, f in measured)
    return Panels(pictures=shown, columns=2) if shown else None


def _condition(subject: Subject, solution: Solution) -> Panels | None:
    trend = solution.identifiability.trend
    if len(trend) < 2:
        return None
    limit = subject.procedure.acceptance.scaled_condition_number
    return Panels(pictures=(calibration_plots.condition_trend(trend, limit),))


def _pair(pair: before_after.Pair | None) -> Panels | None:
    if pair is None:
        return None
    return Panels(pictures=pair.pictures, columns=2, words=("before", "after"))


FIGURES: Mapping[str, Callable[[Subject, Solution], Panels | None]] = MappingProxyType(
    {
        "parameters": _parameters,
        "residuals": lambda subject, solution: Panels(
            pictures=calibration_plots.residuals(subject, solution.identified)
        ),
        "budget": _budget,
        "rvdt": _rvdt,
        "workspace": lambda subject, _: _pair(before_after.hand_pair(subject)),
        "arm": lambda subject, _: _pair(before_after.arm_pair(subject)),
        "condition": _condition,
    }
)
