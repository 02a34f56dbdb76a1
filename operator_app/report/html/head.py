"""The head of a report: whether it is simulated, the verdict with its reasons, the figures that sum it up."""

from __future__ import annotations

from collections.abc import Sequence
from typing import TYPE_CHECKING

from operator_app.report.html.elements import bullets, sentence
from operator_app.report.html.markup import Html, element

if TYPE_CHECKING:
    from operator_app.report.facts import Facts
    from operator_app.report.subject import Subject


def verdict_words(subject: Subject) -> str:
    """Return the verdict in a word or two."""
    facts = subject.facts
    return ("not identifiable" if facts is None else facts.verdict).capitalize()


def banner(subject: Subject) -> Html:
    """Say that the arm was a simulated one; nothing for a real one."""
    if not subject.simulated:
        return Html("")
    scenario = subject.state.settings.get("scenario")
    words = "SIMULATED: the drives said that they are virtual"
    return element("p", f"{words}; scenario {scenario}" if scenario else words, class_="simulated")


def verdict(subject: Subject) -> Html:
    """Return the verdict, which arm it is about, and why it is not better."""
    facts = subject.facts
    good = facts is not None and facts.accepted
    when = subject.state.opened_utc[:16].replace("T", " ")
    said: list[str] = [
        element(
            "h1",
            element("span", "✓ " if good else "✕ ", class_="glyph", aria_hidden="true"),
            verdict_words(subject),
        ),
        element(
            "p",
            f"Calibration of {subject.procedure.arm.name}, serial "
            f"{subject.serial_number or 'not known'}, in fixture {subject.procedure.fixture.name}, "
            f"{when} UTC.",
            " The limits of the procedure are met." if good else "",
        ),
    ]
    if reasons := _reasons(subject):
        said.append(bullets(sentence(reason) for reason in reasons))
    return element("div", *said, class_="verdict" if good else "verdict no")


def tiles(facts: Facts | None) -> Html:
    """Return the figures that sum a calibration up."""
    return element(
        "dl",
        *(
            element(
                "div",
                element("dt", h.name),
                element(
                    "dd",
                    h.figure.shown,
                    " ",
                    element("span", h.figure.quantity.unit, class_="unit"),
                ),
                element("dd", h.note, class_="was"),
            )
            for h in (() if facts is None else facts.headlines)
        ),
        class_="tiles",
    )


def _reasons(subject: Subject) -> Sequence[str]:
    """Why the verdict is not better."""
    if subject.facts is not None:
        return subject.facts.reasons
    blind = subject.unidentifiable
    return [] if blind is None else [str(d) for d in blind.directions]
