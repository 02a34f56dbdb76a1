"""HTML and SVG by construction: text is escaped unless it is already markup. Knows no report.

Whatever an operator, a bus or a file put into a string, it arrives in the page as text.
"""

from __future__ import annotations

import html
from collections.abc import Iterable

from operator_app.safe_output import harmless

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
    """Return what a person wrote, kept from turning the text around it round (right-to-left marks)."""
    return element("bdi", value)


def _attribute(value: Attribute) -> str:
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".")
    return str(value)
