"""Text stays text in HTML; colours have contrast."""

import re
from html import unescape
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.report.html.markup import (
    DARK_COLOURS,
    HEAT_ALPHA,
    HEAT_STEPS,
    LIGHT_COLOURS,
    STYLE,
    WHITE_SPACE,
    Html,
    element,
    join,
    spoken,
    text,
)
from operator_app.safe_output import sanitized

HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onload='x",
    "</td></table><b>",
    "&lt;b&gt; &amp;",
    "</style><script>",
]


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_text_stays_text(words, parse_page):
    page = parse_page(element("p", words, title=words))
    assert page.tags == ["p"]
    assert page.attributes == [("p", "title", words)]
    assert page.text == words


@given(st.text())
def test_any_text_is_escaped(words):
    markup = text(words)
    assert not {"<", '"'} & set(markup)
    assert unescape(markup) == sanitized(words, keep=WHITE_SPACE)


def test_html_is_not_escaped_twice():
    inner = element("b", "1 < 2")
    assert element("p", inner, " & more") == "<p><b>1 &lt; 2</b> &amp; more</p>"
    assert isinstance(join((inner, "<")), Html)


def test_attribute_names_and_none_values():
    markup = element(
        "a", class_="x", aria_label="y", href=None, hidden=False, download=True, x=1.50
    )
    assert markup == '<a class="x" aria-label="y" download x="1.5"></a>'


def test_void_element_has_no_content():
    assert element("meta", charset="utf-8") == '<meta charset="utf-8">'
    with pytest.raises(ValueError, match="no content"):
        element("br", "x")


def test_bidirectional_text_is_isolated():
    assert spoken("\u05d0abc") == "<bdi>\u05d0abc</bdi>"
    assert spoken("\u202eabc") == "<bdi>\ufffdabc</bdi>"


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


@pytest.mark.parametrize("theme", [LIGHT_COLOURS, DARK_COLOURS], ids=["light", "dark"])
@pytest.mark.parametrize(
    ("inks", "grounds", "least"),
    [
        (("text", "muted", "accent", "good", "bad", "warn"), ("page", "panel"), 4.5),
        (("accent", "second", "third", "muted"), ("page", "band"), 3.0),
    ],
    ids=["text", "marks"],
)
def test_colour_contrast_is_sufficient(theme, inks, grounds, least):
    for ink, ground in product(inks, grounds):
        assert contrast(rgb(theme[ink]), rgb(theme[ground])) >= least, (ink, ground)


@pytest.mark.parametrize("theme", [LIGHT_COLOURS, DARK_COLOURS], ids=["light", "dark"])
@pytest.mark.parametrize("sign", ["plus", "minus"])
def test_numbers_are_readable_on_the_darkest_cell(theme, sign):
    page, cell = rgb(theme["page"]), rgb(theme[sign])
    share = HEAT_STEPS * HEAT_ALPHA
    ground = tuple(share * c + (1.0 - share) * p for c, p in zip(cell, page, strict=True))
    assert contrast(rgb(theme["text"]), ground) >= 4.5


def test_both_themes_define_all_colours():
    assert set(LIGHT_COLOURS) == set(DARK_COLOURS)
    assert set(re.findall(r"var\(--([a-z]+)\)", STYLE)) <= set(LIGHT_COLOURS)


def test_style_sheet_is_closed_and_loads_nothing():
    assert STYLE.count("{") == STYLE.count("}")
    assert "@import" not in STYLE
    assert "url(" not in STYLE
    assert "prefers-color-scheme:dark" in STYLE
    assert "@media print" in STYLE
