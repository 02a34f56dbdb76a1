"""HTML and SVG elements: text is escaped unless it is already markup. And the parts that all sections use.

Strings from operators, buses and files arrive in the page as text.
"""

from __future__ import annotations

import html
import re
from collections.abc import Iterable
from dataclasses import dataclass

from operator_app.safe_output import harmless
from operator_app.units.numbers import typeset

VOID = frozenset({"meta", "br", "col", "link", "hr"})

WHITE_SPACE = "\t\n\r"


class Html(str):
    """Markup; every other string is text."""

    __slots__ = ()


Attribute = str | int | float | bool | None


def text(value: str) -> Html:
    """Return a string as markup: escaped, unless it is markup already."""
    if isinstance(value, Html):
        return value
    return Html(html.escape(harmless(value, keep=WHITE_SPACE), quote=True))


def element(tag: str, *children: str, **attributes: Attribute) -> Html:
    """Build one element.

    Attribute names are Python's: ``class_`` is class, ``stroke_width`` is stroke-width. None and False
    leave an attribute out, True gives it no value.
    """
    written = "".join(
        f" {name.rstrip('_').replace('_', '-')}"
        + ("" if value is True else f'="{text(_attribute(value))}"')
        for name, value in attributes.items()
        if value is not None and value is not False
    )
    if tag in VOID:
        if children:
            raise ValueError(f"<{tag}> has no content")
        return Html(f"<{tag}{written}>")
    return Html(f"<{tag}{written}>{join(children)}</{tag}>")


def join(parts: Iterable[str], separator: str = "") -> Html:
    """Put pieces one after another."""
    return Html(text(separator).join(text(part) for part in parts))


def spoken(value: str) -> Html:
    """Return what a person wrote, isolated: right-to-left marks do not turn the text around it."""
    return element("bdi", value)


def _attribute(value: Attribute) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return str(value)


OPTION = re.compile(r"--[a-z-]+(?: \d[\d,]*)?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One section: anchor, heading, content; a narrow one takes half of the page."""

    ident: str
    title: str
    content: tuple[str, ...]
    narrow: bool = False

    @property
    def html(self) -> Html:
        """The section as an element."""
        heading = element("h2", self.title, id=f"{self.ident}-h")
        return element(
            "section",
            heading,
            *self.content,
            id=self.ident,
            aria_labelledby=f"{self.ident}-h",
            class_="narrow" if self.narrow else "",
        )


def definitions(rows: Iterable[tuple[str, str]]) -> Html:
    """Return a list of terms and their definitions."""
    return element(
        "dl",
        *(part for name, value in rows for part in (element("dt", name), element("dd", value))),
        class_="facts",
    )


def figure(caption: str, drawn: Html) -> Html:
    """Return a plot under its caption."""
    return element("figure", element("figcaption", element("b", caption)), drawn)


def plots(drawn: Iterable[Html]) -> Html:
    """Arrange figures side by side where there is room."""
    return element("div", *drawn, class_="plots")


def remark(*words: str) -> Html:
    """Return a paragraph that explains."""
    return element("p", *(w if isinstance(w, Html) else prose(w) for w in words), class_="muted")


def bullets(points: Iterable[str]) -> Html:
    """Return a list."""
    return element("ul", *(element("li", point) for point in points))


def sentence(words: str) -> str:
    """Return text as a sentence: capital first, full stop last."""
    return words[:1].upper() + words[1:] + ("" if words.endswith(".") else ".")


def prose(words: str) -> Html:
    """Return a sentence in which options of the command line stand out and stay in one piece."""
    parts: list[str] = []
    end = 0
    for found in OPTION.finditer(words):
        parts += [
            typeset(words[end : found.start()]),
            element("code", found.group(), class_="whole"),
        ]
        end = found.end()
    return join([*parts, typeset(words[end:])])
