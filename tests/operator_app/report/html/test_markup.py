"""Whatever is put into a string arrives in the page as text."""

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.report.html.markup import (
    DARK_COLOURS,
    HEAT_ALPHA,
    HEAT_STEPS,
    LIGHT_COLOURS,
    STYLE,
    Html,
    element,
    join,
    spoken,
    text,
)

HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onload='x",
    "</td></table><b>",
    "&lt;b&gt; &amp;",
    "</style><script>",
]


@pytest.mark.parametrize("words", HOSTILE)
def test_hostile_text_stays_text(words, take_apart):
    page = take_apart(element("p", words, title=words))
    assert page.tags == ["p"]
    assert page.attributes == [("p", "title", words)]
    assert page.text == words
    assert page.errors == []


@given(st.text())
def test_any_text_round_trips_or_is_marked(words):
    # pytest's fixtures and hypothesis do not mix per example: parse with a parser of our own.
    from html import unescape

    made = text(words)
    assert "<" not in made
    assert '"' not in made
    made.encode()
    back = unescape(made)
    assert len(back) == len(words)
    for before, after in zip(words, back, strict=True):
        assert after in (before, "\ufffd")
    if words.isprintable() and words.isascii():
        assert back == words


def test_forbidden_characters_are_replaced():
    assert text("a\x00b\x1bc\ud800d\ufffe") == "a\ufffdb\ufffdc\ufffdd\ufffd"
    assert text("tab\tand\nline") == "tab\tand\nline"


def test_html_is_not_escaped_twice():
    inner = element("b", "1 < 2")
    assert element("p", inner, " & more") == "<p><b>1 &lt; 2</b> &amp; more</p>"
    assert isinstance(join((inner, "<")), Html)


def test_attribute_names_and_none_values():
    made = element("a", class_="x", aria_label="y", href=None, hidden=False, download=True, x=1.50)
    assert made == '<a class="x" aria-label="y" download x="1.5"></a>'


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
@pytest.mark.parametrize("ground", ["page", "panel"])
@pytest.mark.parametrize("ink", ["text", "muted", "accent", "good", "bad", "warn"])
def test_colour_contrast_is_sufficient(theme, ground, ink):
    assert contrast(rgb(theme[ink]), rgb(theme[ground])) >= 4.5


@pytest.mark.parametrize("theme", [LIGHT_COLOURS, DARK_COLOURS], ids=["light", "dark"])
@pytest.mark.parametrize("ink", ["accent", "second", "third", "muted"])
@pytest.mark.parametrize("ground", ["page", "band"])
def test_every_mark_can_be_seen(theme, ink, ground):
    assert contrast(rgb(theme[ink]), rgb(theme[ground])) >= 3.0


@pytest.mark.parametrize("theme", [LIGHT_COLOURS, DARK_COLOURS], ids=["light", "dark"])
@pytest.mark.parametrize("sign", ["plus", "minus"])
def test_numbers_can_be_read_on_the_darkest_cell(theme, sign):
    page, cell = rgb(theme["page"]), rgb(theme[sign])
    share = HEAT_STEPS * HEAT_ALPHA
    ground = tuple(share * c + (1.0 - share) * p for c, p in zip(cell, page, strict=True))
    assert contrast(rgb(theme["text"]), ground) >= 4.5


def test_both_themes_define_all_colours():
    assert set(LIGHT_COLOURS) == set(DARK_COLOURS)
    assert set(re.findall(r"var\(--([a-z]+)\)", STYLE)) <= set(LIGHT_COLOURS)


def test_style_sheet_is_self_contained():
    assert STYLE.count("{") == STYLE.count("}")
    assert "@import" not in STYLE
    assert "url(" not in STYLE
    assert "prefers-color-scheme:dark" in STYLE
    assert "@media print" in STYLE
