"""Contrast of every text of a report against what it stands on, light and dark (WCAG 2.1: 4.5 to 1)."""

from __future__ import annotations

import re

import pytest

from operator_app.report.html.style import DARK, HEAT_ALPHA, HEAT_STEPS, LIGHT, STYLE


def rgb(colour: str) -> tuple[float, ...]:
    if colour.startswith("#"):
        return tuple(int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))
    return tuple(int(part) / 255.0 for part in colour.split())


def luminance(colour: tuple[float, ...]) -> float:
    linear = [c / 12.92 if c <= 0.04045 else ((c + 0.055) / 1.055) ** 2.4 for c in colour]
    return 0.2126 * linear[0] + 0.7152 * linear[1] + 0.0722 * linear[2]


def contrast(a: tuple[float, ...], b: tuple[float, ...]) -> float:
    high, low = sorted((luminance(a), luminance(b)), reverse=True)
    return (high + 0.05) / (low + 0.05)


def test_the_formula_knows_black_on_white() -> None:
    assert contrast(rgb("#000000"), rgb("#ffffff")) == pytest.approx(21.0)
    assert contrast(rgb("#767676"), rgb("#ffffff")) == pytest.approx(4.54, abs=0.01)


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize("ground", ["page", "panel"])
@pytest.mark.parametrize("ink", ["text", "muted", "accent", "good", "bad", "warn"])
def test_every_text_colour_can_be_read(theme: dict[str, str], ground: str, ink: str) -> None:
    assert contrast(rgb(theme[ink]), rgb(theme[ground])) >= 4.5


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize("ink", ["accent", "second", "third", "muted"])
@pytest.mark.parametrize("ground", ["page", "band"])
def test_every_mark_can_be_seen(theme: dict[str, str], ink: str, ground: str) -> None:
    assert contrast(rgb(theme[ink]), rgb(theme[ground])) >= 3.0


@pytest.mark.parametrize("theme", [LIGHT, DARK], ids=["light", "dark"])
@pytest.mark.parametrize("sign", ["plus", "minus"])
def test_numbers_can_be_read_on_the_darkest_cell(theme: dict[str, str], sign: str) -> None:
    page, cell = rgb(theme["page"]), rgb(theme[sign])
    share = HEAT_STEPS * HEAT_ALPHA
    ground = tuple(share * c + (1.0 - share) * p for c, p in zip(cell, page, strict=True))
    assert contrast(rgb(theme["text"]), ground) >= 4.5


def test_both_themes_define_the_same_colours_and_all_that_are_used() -> None:
    assert set(LIGHT) == set(DARK)
    assert set(re.findall(r"var\(--([a-z]+)\)", STYLE)) <= set(LIGHT)


def test_the_sheet_is_closed_and_loads_nothing() -> None:
    assert STYLE.count("{") == STYLE.count("}")
    assert "@import" not in STYLE
    assert "url(" not in STYLE
    assert "prefers-color-scheme:dark" in STYLE
    assert "@media print" in STYLE
