"""A session as one self-contained HTML page: head, header, sections, foot. No script, no external resource."""

from __future__ import annotations

from typing import TYPE_CHECKING

from operator_app.report.html.head import summary, tiles, verdict_words
from operator_app.report.html.markup import Html, element
from operator_app.report.html.sections import sections_of
from operator_app.report.html.style import STYLE
from operator_app.session.workflow.importing import UNSTATED

if TYPE_CHECKING:
    from operator_app.report.html.elements import Section
    from operator_app.report.subject import Subject

POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""What a browser may load for this page: nothing."""


def report_html(subject: Subject) -> bytes:
    """Return the page, UTF-8. The same journal gives the same bytes."""
    sections = sections_of(subject)
    title = (
        f"{subject.procedure.arm.name} {subject.serial_number}: "
        f"{verdict_words(subject).lower()} ({subject.name})"
    )
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("title", title),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        element("meta", name="generator", content=f"sarcal {subject.software_version}"),
        element("style", Html(STYLE)),
    )
    body = element(
        "body",
        element("a", "Skip to the content", href="#content", class_="skip"),
        element("header", summary(subject), tiles(subject.facts), _contents(sections)),
        element("main", *(section.html for section in sections), id="content"),
        element(
            "footer",
            f"Made from the journal of session {subject.name} by sarcal "
            f"{subject.software_version}. ",
            element("code", "sarcal report"),
            " makes this page again. ",
            *_history(subject.serial_number),
        ),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n".encode()


def _history(serial: str) -> tuple[Html | str, ...]:
    if not serial or serial == UNSTATED:
        return ()
    return (
        "All calibrations of this arm, with control charts: ",
        element("code", f"sarcal history {serial} -o history.html"),
        ".",
    )


def _contents(sections: tuple[Section, ...]) -> Html:
    links = [element("li", element("a", s.title, href=f"#{s.ident}")) for s in sections]
    return element("nav", element("ul", *links), aria_label="Contents")
