"""The style sheet of a report: `report.css` with the colours of both themes and the rules of plots. Knows no content.

Normal is grey; colour marks the abnormal and separates series, always together with another sign.
"""

from __future__ import annotations

from pathlib import Path

from operator_app.report.parameter_tables import HEAT_STEPS

LIGHT = {
    "page": "#ffffff",
    "panel": "#f4f6f8",
    "text": "#1c2126",
    "muted": "#56606b",
    "rule": "#d5dae0",
    "accent": "#0b5c9e",
    "second": "#a34700",
    "third": "#5b5f66",
    "good": "#1f6b3a",
    "bad": "#a8202a",
    "warn": "#7f5200",
    "band": "#dfe8f1",
    "shade": "rgb(28 33 38/.22)",
    "plus": "11 92 158",
    "minus": "176 84 0",
}
DARK = {
    "page": "#14171b",
    "panel": "#1d2126",
    "text": "#e2e6ea",
    "muted": "#9ca6b1",
    "rule": "#343a42",
    "accent": "#6fb3ee",
    "second": "#f0a35e",
    "third": "#b4bac2",
    "good": "#7ccb95",
    "bad": "#ff8d8a",
    "warn": "#e3b04b",
    "band": "#263442",
    "shade": "rgb(0 0 0/.75)",
    "plus": "111 179 238",
    "minus": "240 163 94",
}
HEAT_ALPHA = 0.09
"""Opacity of a cell of the heat table: this much a step."""


def _variables(colours: dict[str, str]) -> str:
    return "".join(f"--{name}:{value};" for name, value in colours.items())


_HEAT = "".join(
    f".{name}{k}{{background:rgb(var(--{name})/{HEAT_ALPHA * k:.2f})}}"
    for name in ("plus", "minus")
    for k in range(1, HEAT_STEPS + 1)
)

PLOT_RULES = """svg text{fill:var(--muted)}
svg .axis,svg .legend{fill:var(--text)}
.grid{stroke:var(--rule);stroke-width:.7}
.zero{stroke:var(--muted);stroke-width:.8}
.frame{stroke:var(--muted);stroke-width:.8}
.band{fill:var(--band)}
.ribbon{fill:var(--second);fill-opacity:.28}
.range{fill:none;stroke:var(--muted);stroke-width:.8}
.rug{stroke:var(--accent);stroke-width:.7;stroke-opacity:.75}
.line{fill:none;stroke-width:1.4}
.line.a{stroke:var(--accent)}.line.b{stroke:var(--second)}
.line.gap{stroke:var(--bad);stroke-width:2}
.line.dashed{stroke:var(--muted);stroke-dasharray:4 3}
.stem{stroke-width:.8;stroke-opacity:.6}.stem.a{stroke:var(--accent)}.stem.c{stroke:var(--second)}
.mark.a{fill:var(--accent)}
.mark.b{fill:none;stroke:var(--second);stroke-width:1.2}
.mark.c{fill:var(--second)}
.mark.d{fill:var(--third)}
"""
"""Style of the content of a picture."""

STYLE = (
    f":root{{color-scheme:light dark;{_variables(LIGHT)}}}\n"
    f"@media screen and (prefers-color-scheme:dark){{:root{{{_variables(DARK)}}}}}\n"
    f"{_HEAT}\n{PLOT_RULES}{Path(__file__).with_name('report.css').read_text('utf-8')}"
)
