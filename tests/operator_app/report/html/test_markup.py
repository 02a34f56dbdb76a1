"""Text stays text in HTML; colours have contrast."""

import re
from html import unescape
from itertools import product

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.report.html.markup import (
    DARK_COLOURS,
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
from tests.oracles.contrast import contrast


@given(st.text() | st.text("<>\"'&;ltamp/=#3"))
def test_any_text_is_escaped_in_contents_and_attributes(words):
    markup = text(words)
    assert not {"<", ">", '"', "'"} & set(markup)
    assert unescape(markup) == sanitized(words, keep=WHITE_SPACE)
    assert element("p", words, title=words) == f'<p title="{markup}">{markup}</p>'


@pytest.mark.parametrize(
    ("markup", "expected"),
    [
        (element("p", element("b", "1 < 2"), " & more"), "<p><b>1 &lt; 2</b> &amp; more</p>"),
        (
            element("a", class_="x", aria_label="y", href=None, hidden=False, download=True, x=1.5),
            '<a class="x" aria-label="y" download x="1.5"></a>',
        ),
        (element("meta", charset="utf-8"), '<meta charset="utf-8">'),
        (spoken("\u05d0abc"), "<bdi>\u05d0abc</bdi>"),
        (spoken("\u202eabc"), "<bdi>\ufffdabc</bdi>"),
    ],
    ids=["nested", "attributes", "void", "bidirectional", "override"],
)
def test_markup_is_escaped_once(markup, expected):
    assert markup == expected


def test_void_element_has_no_content():
    assert isinstance(join((element("b", "1 < 2"), "<")), Html)
    with pytest.raises(ValueError, match="no content"):
        element("br", "x")


def rgb(colour: str) -> tuple[float, ...]:
    return tuple(int(colour[k : k + 2], 16) / 255.0 for k in (1, 3, 5))


@pytest.mark.parametrize("theme", [LIGHT_COLOURS, DARK_COLOURS], ids=["light", "dark"])
def test_colour_contrast_is_sufficient(theme):
    for inks, grounds, least in (
        (("text", "muted", "accent", "good", "bad", "warn"), ("page", "panel"), 4.5),
        (("accent", "second", "third", "muted"), ("page", "band"), 3.0),
    ):
        for ink, ground in product(inks, grounds):
            assert contrast(rgb(theme[ink]), rgb(theme[ground])) >= least, (ink, ground)


def test_style_sheet_is_closed_loads_nothing_and_has_all_colours():
    assert set(LIGHT_COLOURS) == set(DARK_COLOURS)
    assert set(re.findall(r"var\(--([a-z]+)\)", STYLE)) <= set(LIGHT_COLOURS)
    assert STYLE.count("{") == STYLE.count("}")
    assert "@import" not in STYLE
    assert "url(" not in STYLE
    assert "prefers-color-scheme:dark" in STYLE
    assert "@media print" in STYLE
