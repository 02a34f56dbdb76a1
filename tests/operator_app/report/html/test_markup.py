"""Whatever is put into a string arrives in the page as text."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from operator_app.report.html.markup import Html, element, join, spoken, text

HOSTILE = [
    "<script>alert(1)</script>",
    '"><img src=x onerror=alert(1)>',
    "' onload='x",
    "</td></table><b>",
    "&lt;b&gt; &amp;",
    "</style><script>",
]


@pytest.mark.parametrize("words", HOSTILE)
def test_text_stays_text_in_content_and_in_attributes(words: str, take_apart: type) -> None:
    page = take_apart(element("p", words, title=words))
    assert page.tags == ["p"]
    assert page.attributes == [("p", "title", words)]
    assert page.text == words
    assert page.errors == []


@given(st.text())
def test_any_text_comes_back_or_is_marked(words: str) -> None:
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


def test_characters_that_no_page_may_hold_are_replaced() -> None:
    assert text("a\x00b\x1bc\ud800d\ufffe") == "a\ufffdb\ufffdc\ufffdd\ufffd"
    assert text("tab\tand\nline") == "tab\tand\nline"


def test_markup_is_not_escaped_twice() -> None:
    inner = element("b", "1 < 2")
    assert element("p", inner, " & more") == "<p><b>1 &lt; 2</b> &amp; more</p>"
    assert isinstance(join((inner, "<")), Html)


def test_attributes_are_named_as_in_html_and_left_out_when_none() -> None:
    made = element("a", class_="x", aria_label="y", href=None, hidden=False, download=True, x=1.50)
    assert made == '<a class="x" aria-label="y" download x="1.5"></a>'


def test_a_void_element_has_no_content() -> None:
    assert element("meta", charset="utf-8") == '<meta charset="utf-8">'
    with pytest.raises(ValueError, match="no content"):
        element("br", "x")


def test_what_people_write_cannot_turn_the_page_round() -> None:
    assert spoken("\u05d0abc") == "<bdi>\u05d0abc</bdi>"
    assert spoken("\u202eabc") == "<bdi>\ufffdabc</bdi>"
