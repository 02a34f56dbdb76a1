"""Numbers as people read them: places by precision, powers of ten, counted nouns. Knows no renderer."""

from __future__ import annotations

import math
import re
from collections.abc import Iterable, Sequence

MINUS = "\N{MINUS SIGN}"
NOT_KNOWN = "n/a"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def fixed(value: float, places: int, *, signed: bool = False) -> str:
    """Return `value` with this many decimal places; zero has no sign."""
    if not math.isfinite(value):
        return NOT_KNOWN
    # Rounded first, so that what rounds to nothing shows no sign.
    rounded = round(value, places) + 0.0
    return f"{rounded:{'+' if signed and rounded > 0.0 else ''}.{places}f}"


def significant(value: float, digits: int = 3) -> str:
    """Return `value` to so many significant digits, with a power of ten where zeros would pile up."""
    if not math.isfinite(value):
        return "infinite" if value == math.inf else NOT_KNOWN
    if value == 0.0:
        return "0"
    written = f"{value:.{digits - 1}e}"
    power = int(written.partition("e")[2])
    return fixed(value, max(0, digits - 1 - power)) if -4 <= power < 5 else written


def typeset(words: str) -> str:
    """Return numbers as print has them: a real minus, a raised power of ten."""
    raised = re.sub(
        r"(?<=\d)e([+-]\d+)\b", lambda m: "·10" + str(int(m[1])).translate(SUPERSCRIPTS), words
    )
    return re.sub(r"(?<![\w-])-(?=\d)", MINUS, raised)


def places_to_show(
    precisions: Iterable[float], *, digits: int = 2, least: int = 1, most: int = 9
) -> int:
    """Decimal places at which the finest of these precisions still has `digits` digits."""
    finest = min((p for p in precisions if math.isfinite(p) and p > 0.0), default=0.0)
    if finest == 0.0:
        return least
    return min(most, max(least, digits - 1 - math.floor(math.log10(finest))))


def places_needed(values: Iterable[float], *, least: int, most: int) -> int:
    """Fewest decimal places that cut nothing off these round values."""
    listed = list(values)
    return next(
        (n for n in range(least, most) if all(abs(v - round(v, n)) < 1e-9 for v in listed)), most
    )


def plural(count: int, noun: str) -> str:
    """Return ``1 pose``, ``2 poses``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def joints_named(joints: Sequence[int]) -> str:
    """Return ``joint 5``, or ``joints 1 and 5``."""
    return f"joint{'s' if len(joints) > 1 else ''} {names(joints)}"


def names(items: Iterable[object]) -> str:
    """Return ``1, 2 and 3``."""
    listed = [str(item) for item in items]
    return (
        " and ".join([", ".join(listed[:-1]), listed[-1]]) if len(listed) > 1 else "".join(listed)
    )
