"""Figures for a paper, drawn by matplotlib: vector PDF, PNG of 300 dpi. Knows no calibration and decides no number.

Needs the extra ``[plots]``. One column of a journal is 88 mm wide, two are 180 mm; text is of 8 points, the
colours are told apart by colour-blind readers too (Okabe and Ito), marks differ in shape as well.
"""

from __future__ import annotations

import io
import re
from collections.abc import Iterable, Iterator, Mapping
from contextlib import contextmanager
from pathlib import Path
from typing import Any

from operator_app.config.atomic import write_atomically
from operator_app.config.errors import WriteError
from operator_app.errors import SessionError
from operator_app.report.plots.paper_figures import (
    Drawing,
    Estimates,
    Panels,
    Shares,
    drawing,
    drawings,
)
from operator_app.report.plots.plot import Band, LogAxis, Marks, Picture, Polyline, Ribbon
from operator_app.report.subject import Subject
from operator_app.units.numbers import typeset

ONE_COLUMN, TWO_COLUMNS = 88.0 / 25.4, 180.0 / 25.4
"""Widths, inches."""
PANEL = 44.0 / 25.4
"""Height of a picture without an aspect of its own, inches."""
BAR = 4.6 / 25.4
DPI = 300
MOST_TICKS = 6
LETTERS = "abcdefghijklmnop"
ENDINGS = ("pdf", "png")

BLACK, ORANGE, SKY, GREEN, YELLOW, BLUE, RED, PINK = (
    "#000000", "#e69f00", "#56b4e9", "#009e73", "#f0e442", "#0072b2", "#d55e00", "#cc79a7",
)  # fmt: skip
GREY = "#bdbdbd"
SOURCES = (BLUE, ORANGE, GREEN, PINK, SKY, RED, YELLOW, GREY)
LINES: Mapping[str, Mapping[str, Any]] = {
    "a": {"color": BLUE},
    "b": {"color": RED},
    "dashed": {"color": "#606060", "linestyle": (0, (4, 3))},
    "gap": {"color": PINK, "linewidth": 1.8},
}
MARKS: Mapping[str, Mapping[str, Any]] = {
    "a": {"color": BLUE},
    "b": {"facecolors": "none", "edgecolors": RED, "linewidths": 0.8},
    "c": {"color": RED},
    "d": {"color": "#404040"},
}
SHAPES = {"dot": "o", "square": "s", "triangle": "^"}
USUAL, LARGEST = 7.0, 45.0
"""Areas of marks, square points."""
STYLE: Mapping[str, Any] = {
    "font.size": 8.0,
    "axes.labelsize": 8.0,
    "axes.titlesize": 8.0,
    "xtick.labelsize": 7.0,
    "ytick.labelsize": 7.0,
    "legend.fontsize": 7.0,
    "legend.frameon": False,
    "legend.handlelength": 1.4,
    "legend.columnspacing": 1.0,
    "legend.handletextpad": 0.5,
    "axes.linewidth": 0.6,
    "xtick.major.width": 0.6,
    "ytick.major.width": 0.6,
    "lines.linewidth": 1.0,
    "axes.grid": False,
    "axes.spines.top": False,
    "axes.spines.right": False,
    "mathtext.fontset": "dejavusans",
    # Text stays text in a PDF, as journals want it.
    "pdf.fonttype": 42,
    "savefig.dpi": DPI,
    "figure.dpi": 150.0,
}


def figure(subject: Subject, name: str) -> Any:
    """Return one figure as a ``matplotlib.figure.Figure``.

    Raises
    ------
    KeyError
        There is no such figure of this calibration; lists those there are.
    SessionError
        matplotlib is not installed.
    """
    found = drawing(subject, name)
    with _style() as Paper:
        return _drawn(found, Paper)


def save_figures(subject: Subject, folder: Path) -> tuple[Path, ...]:
    """Write every figure there is into a folder, as PDF and PNG; return the files.

    Raises
    ------
    SessionError
        matplotlib is not installed.
    WriteError
        The folder cannot be written to.
    """
    written = []
    try:
        folder.mkdir(parents=True, exist_ok=True)
    except OSError as error:
        raise WriteError(file=str(folder), reason=error.strerror or str(error)) from error
    with _style() as Paper:
        for name, found in drawings(subject).items():
            made = _drawn(found, Paper)
            for ending in ENDINGS:
                file = io.BytesIO()
                # No time of day: the same calibration gives the same file.
                stamp = {"CreationDate": None} if ending == "pdf" else {}
                made.savefig(file, format=ending, metadata=stamp)
                written.append(folder / f"{name}.{ending}")
                write_atomically(written[-1], file.getvalue())
    return tuple(written)


@contextmanager
def _style() -> Iterator[Any]:
    """Set our style while something is drawn or saved; give the class of figures that keep to it."""
    try:
        import matplotlib as mpl  # type: ignore[import-not-found,unused-ignore]
        from matplotlib.figure import Figure  # type: ignore[import-not-found,unused-ignore]
    except ImportError as error:
        raise SessionError(
            "figures for a paper need matplotlib, which is not installed",
            "pip install 'sarcal[plots]'",
        ) from error
    settings: Any = dict(STYLE)
    methods = {"savefig": _saved, "_repr_png_": _as_png}
    with mpl.rc_context(settings):
        yield type("Figure", (Figure,), methods)


def _saved(self: Any, *args: Any, **options: Any) -> None:
    """Save in our style: whether text stays text is settled only then."""
    with _style():
        super(type(self), self).savefig(*args, **options)


def _as_png(self: Any) -> bytes:
    """Show it in a notebook, which would show a figure made without pyplot as its name."""
    file = io.BytesIO()
    self.savefig(file, format="png", dpi=self.dpi)
    return file.getvalue()


def _drawn(found: Drawing, Paper: Any) -> Any:
    match found:
        case Panels():
            return _panels(found, Paper)
        case Shares():
            return _shares(found, Paper)
        case _:
            return _estimates(found, Paper)


# ---- pictures of the page ------------------------------------------------------------------------


def _panels(found: Panels, Paper: Any) -> Any:
    columns = min(found.columns, len(found.pictures))
    rows = -(-len(found.pictures) // columns)
    width = ONE_COLUMN if columns == 1 else TWO_COLUMNS
    aspect = found.pictures[0].aspect
    height = PANEL if aspect == 0.0 else 0.86 * width / columns / aspect + 0.25
    made = Paper(figsize=(width, rows * (height + 0.12) + 0.12), layout="constrained")
    axes = made.subplots(rows, columns, squeeze=False).ravel()
    for k, (ax, picture) in enumerate(zip(axes, found.pictures, strict=False)):
        _picture(ax, picture)
        if len(found.pictures) > 1:
            words = f" {found.words[k]}" if found.words else ""
            ax.set_title(f"({LETTERS[k % len(LETTERS)]}){words}", loc="left", pad=10.0)
    for ax in axes[len(found.pictures) :]:
        ax.set_visible(False)
    return made


def _picture(ax: Any, of: Picture) -> None:
    if isinstance(of.x, LogAxis):
        ax.set_xscale("log")
    if isinstance(of.y, LogAxis):
        ax.set_yscale("log")
    for layer in of.layers:
        label = typeset(layer.label) or None
        if isinstance(layer, Band):
            ax.axhspan(layer.low, layer.high, color="#e4e8ec", linewidth=0.0, label=label)
        elif isinstance(layer, Ribbon):
            ax.fill_between(
                layer.x, layer.low, layer.high, color=RED, alpha=0.3, linewidth=0.0, label=label
            )
        elif isinstance(layer, Polyline):
            ax.plot(layer.x, layer.y, label=label, **LINES[layer.class_])
        elif isinstance(layer, Marks):
            areas = [LARGEST * size for size in layer.sizes] if layer.sizes else USUAL
            ax.scatter(
                layer.x, layer.y, s=areas, marker=SHAPES[layer.shape], label=label, zorder=3.0,
                **{"linewidths": 0.0, **MARKS[layer.class_]},
            )  # fmt: skip
    if not isinstance(of.y, LogAxis) and of.y.low < 0.0 < of.y.high and of.aspect == 0.0:
        ax.axhline(0.0, color="#606060", linewidth=0.5, zorder=1.0)
    for axis, set_limits, set_ticks in (
        (of.x, ax.set_xlim, ax.set_xticks),
        (of.y, ax.set_ylim, ax.set_yticks),
    ):
        set_limits(axis.low, axis.high)
        set_ticks(axis.ticks, [typeset(text) for text in axis.tick_texts])
        set_ticks([], minor=True)
    if of.aspect:
        ax.set_aspect("equal")
    ax.set_xlabel(typeset(of.x.title))
    ax.set_ylabel(typeset(of.y.title))
    if any(layer.label for layer in of.layers):
        _legend(ax, columns=4)


def _legend(ax: Any, *, columns: int) -> None:
    """Put it above the frame, where no value is."""
    ax.legend(
        loc="lower right",
        bbox_to_anchor=(1.0, 1.0),
        ncols=columns,
        borderaxespad=0.2,
        handletextpad=0.4,
    )


# ---- figures of the facts ------------------------------------------------------------------------


def _estimates(found: Iterable[Estimates], Paper: Any) -> Any:
    groups = list(found)
    made = Paper(figsize=(TWO_COLUMNS, 3.5), layout="constrained")
    widths = [len(group.names) + 2.0 for group in groups]
    axes = made.subplots(2, len(groups), squeeze=False, sharex="col", width_ratios=widths)
    for (upper, lower), of in zip(axes.T, groups, strict=True):
        at = range(len(of.names))
        ends = [
            [abs(c - end) for c, end in zip(of.change, side, strict=True)]
            for side in (of.low, of.high)
        ]
        upper.errorbar(
            at, of.change, yerr=ends, fmt="o", ms=3.0, color=BLUE, capsize=2.0,
            elinewidth=0.8, capthick=0.8, label="identified, 95 % interval",
        )  # fmt: skip
        upper.axhline(0.0, color="#606060", linewidth=0.6, linestyle=(0, (4, 3)), label="nominal")
        upper.set_ylabel(f"change from nominal [{of.unit}]")
        for (words, sigma), mark, colour in zip(
            of.sigmas.items(), ("o", "^", "s"), (BLUE, ORANGE, "#808080"), strict=False
        ):
            lower.plot(at, sigma, linestyle="none", marker=mark, ms=3.5, color=colour, label=words)
        lower.set_yscale("log")
        # What is not stated is nan, and neither larger nor smaller than zero.
        known = [s for sigma in of.sigmas.values() for s in sigma if s > 0.0] or [1.0]
        low, high = min(known), max(known)
        lower.set_ylim(low / 1.4, high * 1.4)
        ticks = _round_ticks(low / 1.4, high * 1.4)
        ticks = ticks if len(ticks) <= MOST_TICKS else [t for t in ticks if f"{t:e}"[0] == "1"]
        lower.set_yticks(ticks, [f"{t:g}" for t in ticks])
        lower.set_yticks([], minor=True)
        lower.set_ylabel(f"sigma [{of.unit}]")
        lower.set_xticks(list(at), [symbol(name) for name in of.names], rotation=0)
        lower.set_xlim(-0.7, len(of.names) - 0.3)
    _legend(axes[0, 0], columns=2)
    _legend(axes[1, 0], columns=3)
    return made


def _round_ticks(low: float, high: float) -> list[float]:
    """1, 2 and 5 times the powers of ten within a range."""
    powers = range(-9, 9)
    return [m * 10.0**k for k in powers for m in (1.0, 2.0, 5.0) if low <= m * 10.0**k <= high]


def _shares(found: Shares, Paper: Any) -> Any:
    height = BAR * len(found.names) + 1.0
    made = Paper(figsize=(ONE_COLUMN, height), layout="constrained")
    ax = made.subplots()
    at = range(len(found.names))
    left = [0.0] * len(found.names)
    for k, (source, colour) in enumerate(zip(found.sources, SOURCES, strict=False)):
        widths = [row[k] for row in found.percent]
        ax.barh(at, widths, left=left, height=0.78, color=colour, label=source)
        left = [a + b for a, b in zip(left, widths, strict=True)]
    ax.set_yticks(list(at), [symbol(name) for name in found.names])
    ax.invert_yaxis()
    ax.set_xlim(0.0, 100.0)
    ax.set_xlabel("share of variance [%]")
    ax.tick_params(axis="y", length=0.0)
    made.legend(loc="outside upper center", ncols=3)
    return made


def symbol(name: str) -> str:
    """Return a parameter's name as a formula: ``alpha_0`` has a Greek letter and an index."""
    plain, _, placement = name.partition("[")
    kind, _, row = plain.rpartition("_")
    letter = {
        "theta_off": r"\theta^{\mathrm{off}}",
        "alpha": r"\alpha",
        "beta": r"\beta",
        "a": "a",
        "s": "s",
    }.get(kind)
    if letter is None or not re.fullmatch(r"\d+", row):
        return name
    index = f"{row},{placement[:-1]}" if placement else row
    return f"${letter}_{{{index}}}$"
