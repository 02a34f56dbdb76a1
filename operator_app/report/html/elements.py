"""What sections of a report are built from: headings, definitions, figures with captions. Knows no content."""

from __future__ import annotations

import re
from collections.abc import Iterable
from dataclasses import dataclass

from operator_app.report.html.markup import Html, element, join
from operator_app.units.numbers import typeset

OPTION = re.compile(r"--[a-z-]+(?: \d[\d,]*)?")


@dataclass(frozen=True, slots=True, kw_only=True)
class Section:
    """One section: its anchor, its heading, what is in it; a narrow one has room for another beside it."""

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
    """Return names with what they are."""
    return element(
        "dl",
        *(part for name, value in rows for part in (element("dt", name), element("dd", value))),
        class_="facts",
    )


def figure(caption: str, drawn: Html) -> Html:
    """Return a plot under its caption."""
    return element("figure", element("figcaption", element("b", caption)), drawn)


def plots(drawn: Iterable[Html]) -> Html:
    """Put figures beside each other where there is room."""
    return element("div", *drawn, class_="plots")


def remark(*words: str) -> Html:
    """Return a paragraph that explains."""
    return element("p", *(w if isinstance(w, Html) else prose(w) for w in words), class_="muted")


def bullets(points: Iterable[str]) -> Html:
    """Return a list."""
    return element("ul", *(element("li", point) for point in points))


def sentence(words: str) -> str:
    """Begin with a capital, end with a full stop."""
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
