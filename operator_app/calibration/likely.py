"""How sure a sentence is of itself: what is less likely than not "may be". Knows sentences, no fault and no figure."""

from __future__ import annotations

EVEN = 0.5
"""A cause that is as likely as all others together is said as a fact."""

PERHAPS = (
    (" does not fit ", " may not fit "),
    (" do not fit ", " may not fit "),
    (" does not follow ", " may not follow "),
    (" is off ", " may be off "),
    (" slipped ", " may have slipped "),
    (" changed by ", " may have changed by "),
    (" jumped by ", " may have jumped by "),
    (" shifted by ", " may have shifted by "),
    (" drifts by ", " may drift by "),
    (" gives ", " may give "),
    (" scatters by ", " may scatter by "),
    (" scatter by ", " may scatter by "),
    (" strays from ", " may stray from "),
    (" errs by ", " may err by "),
    (" twists by ", " may twist by "),
    (" reads the same ", " may read the same "),
)
"""Verbs of what may be wrong, as a fact and as a possibility."""


def as_likely(text: str, probability: float) -> str:
    """Return a cause's sentence as sure as its probability allows."""
    return text if probability >= EVEN else perhaps(text)


def perhaps(text: str) -> str:
    """Return a cause's sentence as a possibility."""
    found = [(text.find(fact), fact, maybe) for fact, maybe in PERHAPS if fact in text]
    if not found:
        # As "with two lengths exchanged the loops close": what was found, not what was done.
        return text
    _, fact, maybe = min(found)
    return text.replace(fact, maybe, 1)
