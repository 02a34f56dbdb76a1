"""Figures for a paper as files: the report's own pictures as SVG and, with the extra ``[plots]``, as PDF.

One column of a journal is 88 mm wide, two are 180 mm. Colours are those of the page in daylight; bars have
the colours of Okabe and Ito, which colour-blind readers tell apart, and marks differ in shape as well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Mapping
from dataclasses import dataclass
from os import PathLike
from pathlib import Path
from typing import Any

from operator_app.config.atomic import write_atomically
from operator_app.config.errors import WriteError
from operator_app.errors import SessionError
from operator_app.report.html.markup import Html, element
from operator_app.report.html.style import LIGHT, PLOT_RULES
from operator_app.report.plots.paper_figures import Panels, drawing, drawings
from operator_app.report.plots.strips import Bars, bars
from operator_app.report.plots.svg import WIDTH, draw, label
from operator_app.report.subject import Subject

ONE_COLUMN_MM, TWO_COLUMNS_MM = 88, 180
TITLE = 16.0
"""Height of the line above a panel, in the units of its picture."""
BARS = ("#0072b2", "#e69f00", "#009e73", "#cc79a7", "#56b4e9", "#d55e00", "#f0e442", "#bdbdbd")
ENDINGS = ("svg", "pdf")
FONT, PDF_FONT = '"DejaVu Sans", Verdana, sans-serif', "Vera"
"""Bitstream Vera comes with the PDF library; the fonts that every PDF reader has lack a minus sign."""


@dataclass(frozen=True, slots=True)
class PaperFigure:
    """One figure: a notebook shows it, `savefig` writes it."""

    svg: str

    def _repr_svg_(self) -> str:
        return self.svg

    def savefig(self, path: str | PathLike[str]) -> None:
        """Write the figure to a file whose name ends in ``.svg`` or ``.pdf``.

        Raises
        ------
        ValueError
            The name has another ending.
        SessionError
            A PDF is wanted and svglib is not installed.
        WriteError
            The file cannot be written.
        """
        ending = Path(path).suffix.removeprefix(".").lower()
        if ending not in ENDINGS:
            raise ValueError(f"a figure is saved as .svg or .pdf, not as {Path(path).name!r}")
        write_atomically(Path(path), _pdf(self.svg) if ending == "pdf" else self.svg.encode())


def figure(subject: Subject, name: str) -> PaperFigure:
    """Return one figure; KeyError lists those there are of this calibration."""
    return PaperFigure(_document(drawing(subject, name)))


def save_figures(subject: Subject, folder: Path) -> tuple[Path, ...]:
    """Write every figure there is into a folder, as SVG and, where svglib is installed, PDF.

    Raises
    ------
    WriteError
        The folder cannot be written to.
    """
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(file=str(folder), reason=error.strerror or str(error)) from error
    written = []
    for name, found in drawings(subject).items():
        made = PaperFigure(_document(found))
        for ending in ENDINGS if pdf_is_possible() else ENDINGS[:1]:
            written.append(folder / f"{name}.{ending}")
            made.savefig(written[-1])
    return tuple(written)


def pdf_is_possible() -> bool:
    """Whether the extra ``[plots]`` is installed."""
    try:
        import svglib  # noqa: F401
    except ImportError:
        return False
    return True


def _document(of: Panels) -> str:
    """Return a whole SVG file: the panels in rows, each under its letter, with colours of its own."""
    columns = min(of.columns, len(of.pictures))
    words = of.words or ("",) * len(of.pictures)
    parts: list[Html] = []
    top = 0.0
    for first in range(0, len(of.pictures), columns):
        tallest = 0.0
        for k, shown in enumerate(of.pictures[first : first + columns]):
            drawn = bars(shown) if isinstance(shown, Bars) else draw(shown)
            title = f"({chr(ord('a') + first + k)}) {words[first + k]}".rstrip()
            headed = len(of.pictures) > 1
            above = [label(title, 2.0, -4.0, class_="legend")] if headed else []
            at = f"translate({WIDTH * k:g} {top + (TITLE if headed else 0.0):g})"
            parts.append(element("g", *above, *drawn.parts, transform=at))
            tallest = max(tallest, drawn.height + (TITLE if headed else 0.0))
        top += tallest
    width_mm = ONE_COLUMN_MM if columns == 1 else TWO_COLUMNS_MM
    return element(
        "svg",
        element("style", Html(_style(LIGHT))),
        *parts,
        xmlns="http://www.w3.org/2000/svg",
        viewBox=f"0 0 {WIDTH * columns:g} {top:g}",
        width=f"{width_mm}mm",
        height=f"{width_mm * top / (WIDTH * columns):.1f}mm",
    )


def _style(colours: Mapping[str, str]) -> str:
    rules = re.sub(r"var\(--(\w+)\)", lambda m: colours[m[1]], PLOT_RULES)
    fills = "".join(f".bar.b{k}{{fill:{colour}}}" for k, colour in enumerate(BARS))
    return f"text{{font-family:{FONT};font-size:9.6px}}{rules}{fills}"


def _pdf(svg: str) -> bytes:
    """Convert by svglib and reportlab; the same picture gives the same bytes."""
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
    found: Any = svg2rlg(io.StringIO(svg.replace(FONT, PDF_FONT)))
    file = io.BytesIO()
    canvas = Canvas(file, pagesize=(found.width, found.height), invariant=1)
    renderPDF.draw(found, canvas, 0, 0)
    canvas.save()
    return file.getvalue()
