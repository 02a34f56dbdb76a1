"""Three themes, which give each role of text a style, and ASCII replacements for glyphs.

Normal states are grey. All other states have a colour, always together with a glyph and a word.
"""

from collections.abc import Mapping
from dataclasses import dataclass

from rich.style import Style
from textual.theme import BUILTIN_THEMES, Theme

from operator_app.safe_output import sanitized

DARK, LIGHT, NO_COLOUR = "sarcal-dark", "sarcal-light", "sarcal-no-colour"

_COLOURS: Mapping[str, Mapping[str, str]] = {
    DARK: {
        "background": "#24282c",
        "bar": "#3a3f44",
        "text": "#dfe3e6",
        "dim": "#a3abb2",
        "accent": "#63b8f0",
        "warn": "#f0a818",
        "alarm": "#ff8a5c",
        "border": "#5f676e",
    },
    LIGHT: {
        "background": "#f0f1f3",
        "bar": "#dadcdf",
        "text": "#16181a",
        "dim": "#40464c",
        "accent": "#004f8c",
        "warn": "#6a3f00",
        "alarm": "#8f1d00",
        "border": "#2f5f85",
    },
}
"""Contrast of every text colour on both backgrounds is at least 4.5:1, also in 256 colours; a test computes it."""

ASCII = str.maketrans(
    {
        "│": "|", "─": "-", "├": "|", "┤": "|", "┼": "+", "└": "+", "╭": "+", "╮": "+",
        "╯": "+", "╰": "+", "━": "=", "▌": ">", "●": "o", "○": ".", "▲": "!", "■": "#",
        "▶": ">", "✓": "+", "·": ".", "…": "~", "—": "-", "°": "d", "→": ">",
        "⊕": "@", "◌": "o", "✗": "x", "✕": "x", "\N{MINUS SIGN}": "-",
        "█": "#", "▁": "_", "▂": "_", "▃": "-", "▄": "-", "▅": "=", "▆": "=", "▇": "#",
    }
)  # fmt: skip
"""ASCII replacements of one character each, so that nothing moves. Plots choose ASCII or braille themselves."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Look:
    """Appearance of text: whether only ASCII is used, styles by role."""

    ascii_only: bool
    styles: Mapping[str, Style]

    def style(self, role: str) -> Style:
        """Return the style of a role, which may combine names: ``"warn bold"``; ``@name``: a click does this action."""
        names, _, action = role.partition("@")
        click = [Style.from_meta({"@click": f"app.click('{action}')"})] if action else []
        return Style.combine([*map(self.styles.__getitem__, names.split()), *click])

    def text(self, text: str) -> str:
        """Return `text` without control characters other than line breaks; if `ascii_only`, in ASCII."""
        text = sanitized(text, keep="\n")
        if not self.ascii_only:
            return text
        # No aligned text follows this sign: two characters may replace it.
        plain = text.replace("±", "+-").translate(ASCII)
        return plain.encode("ascii", "replace").decode("ascii")


STOP_WIDTH = 16
"""Number of columns at the left end of the strip in which a click means STOP."""
SMALLEST_TERMINAL = (80, 24)
LARGE = (110, 32)


def is_compact(width: int, height: int) -> bool:
    """Whether a terminal of this size gets the small layout."""
    return width < LARGE[0] or height < LARGE[1]


_STYLES: Mapping[str, tuple[str, str]] = {
    "bold": ("bold", "bold"),
    "text": ("{text}", ""),
    "dim": ("{dim}", ""),
    "accent": ("bold {accent}", "bold"),
    "warn": ("bold {warn}", "bold"),
    "alarm": ("bold {alarm}", "bold reverse"),
    "key": ("bold {accent}", "bold"),
    "cursor": ("on {bar}", "reverse"),
    "header": ("bold {dim}", "bold underline"),
    "badge": ("bold {background} on {text}", "reverse"),
}
"""Style of each role with the colours of a theme, and without colours."""


def look(theme: str, *, ascii_only: bool) -> Look:
    """Return the look of a theme: its text styles by role, and whether only ASCII is used."""
    colours = _COLOURS.get(theme)
    styles = {
        role: Style.parse(plain if colours is None else coloured.format(**colours))
        for role, (coloured, plain) in _STYLES.items()
    }
    return Look(ascii_only=ascii_only, styles=styles)


def themes() -> tuple[Theme, ...]:
    """Return the three themes for Textual."""
    plain = "ansi_default"
    own = ("border", "bar", "dim")
    ansi = {
        **dict.fromkeys((*BUILTIN_THEMES["ansi-dark"].variables, *own), plain),
        "input-cursor-text-style": "reverse",
        "block-cursor-text-style": "reverse",
    }
    looks = (
        (DARK, True, _COLOURS[DARK], {name: _COLOURS[DARK][name] for name in own}),
        (LIGHT, False, _COLOURS[LIGHT], {name: _COLOURS[LIGHT][name] for name in own}),
        (NO_COLOUR, True, dict.fromkeys(_COLOURS[DARK], plain), ansi),
    )
    return tuple(
        Theme(
            name=name,
            dark=dark,
            ansi=name == NO_COLOUR,
            primary=c["accent"],
            secondary=c["dim"],
            accent=c["accent"],
            warning=c["warn"],
            error=c["alarm"],
            success=c["text"],
            foreground=c["text"],
            background=c["background"],
            surface=c["background"],
            panel=c["bar"],
            variables=variables,
        )
        for name, dark, c, variables in looks
    )
