"""A session, or the history of an arm, as one self-contained HTML page. No script, no external resource."""

from __future__ import annotations

import math
from collections.abc import Sequence
from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.calibration.history import ArmHistory, EntryHistory
from operator_app.calibration.sensitivity import source_sensitivities
from operator_app.config.atomic import write_atomically
from operator_app.errors import GuardError
from operator_app.report.html.markup import (
    STYLE,
    Html,
    Section,
    bullets,
    element,
    plots,
    prose,
    remark,
    sentence,
    table_html,
)
from operator_app.report.html.sections import sections_of
from operator_app.report.plots.before_after import hand_pair
from operator_app.report.plots.plot import Layer, Marks, Picture, Polyline, axis
from operator_app.report.plots.svg import drawn
from operator_app.report.quality_tables import truth_in_words
from operator_app.report.results.history import (
    HOW,
    checks_lines,
    due_text,
    entries_table,
    quantity,
    sessions_table,
    title_of,
    verdict_text,
)
from operator_app.report.subject import subject_of_session
from operator_app.report.uncertainty_tables import source_words
from operator_app.session.store.journal import read_journal
from operator_app.session.store.stored_calibration import StoredCalibration, journal_calibration
from operator_app.session.workflow.importing import UNKNOWN_SERIAL_NUMBER
from operator_app.units import CLOSURE_LENGTH, SHARE, Figure, quantity_of

if TYPE_CHECKING:
    from operator_app.report.facts import Facts
    from operator_app.report.subject import Subject
    from operator_app.session.workflow.session import Session


POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Content security policy of the page: the browser loads no other resource."""


def report_html(subject: Subject) -> bytes:
    """Return the report page of a session, UTF-8; the same journal gives the same bytes."""
    sections = sections_of(subject)
    title = (
        f"{subject.procedure.arm.name} {subject.state.serial_number}: "
        f"{verdict_words(subject).lower()} ({subject.name})"
    )
    links = [element("li", element("a", s.title, href=f"#{s.ident}")) for s in sections]
    contents = element("nav", element("ul", *links), aria_label="Contents")
    body = element(
        "body",
        element("a", "Skip to the content", href="#content", class_="skip"),
        element("header", summary(subject), tiles(subject.facts), contents),
        element("main", *(section.html for section in sections), id="content"),
        element(
            "footer",
            f"Made from the journal of session {subject.name} by sarcal "
            f"{subject.software_version}. ",
            element("code", "sarcal report"),
            " writes this page again. ",
            *_history(subject.state.serial_number),
        ),
    )
    return document(title, body, generator=f"sarcal {subject.software_version}")


def document(title: str, body: Html, *, generator: str = "") -> bytes:
    """Return a complete page, UTF-8, that loads no other resource."""
    made_by = [element("meta", name="generator", content=generator)] if generator else []
    head = element(
        "head",
        element("meta", charset="utf-8"),
        element("title", title),
        element("meta", name="viewport", content="width=device-width, initial-scale=1"),
        element("meta", name="color-scheme", content="light dark"),
        element("meta", http_equiv="Content-Security-Policy", content=POLICY),
        *made_by,
        element("style", Html(STYLE)),
    )
    return f"<!DOCTYPE html>\n{element('html', head, body, lang='en')}\n".encode()


def _history(serial: str) -> tuple[Html | str, ...]:
    if not serial or serial == UNKNOWN_SERIAL_NUMBER:
        return ()
    return (
        "All calibrations of this arm, with control charts: ",
        element("code", f"sarcal history {serial} -o history.html"),
        ".",
    )


REPORT_NAME = "report.html"


def write_report(session: Session) -> Path:
    """Write the report page into the session's folder, return its path; GuardError if no calibration is current."""
    calibration = journal_calibration(session.state)
    if not isinstance(calibration, StoredCalibration):
        raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
    folder = session.journal.path.parent
    contents = read_journal(folder)
    subject = subject_of_session(
        folder.resolve().name, contents.events, session.procedure, calibration, torn=contents.torn
    )
    target = folder / REPORT_NAME
    write_atomically(target, report_html(subject))
    return target


def verdict_words(subject: Subject) -> str:
    """Return the verdict in words, such as ``Accepted``."""
    facts = subject.facts
    return ("not identifiable" if facts is None else facts.verdict).capitalize()


def summary(subject: Subject) -> Html:
    """Return the top of the page: verdict, least certain parameter, and tool position error."""
    return element(
        "div",
        element("div", banner(subject), verdict(subject), *_widest(subject)),
        *_tool(subject),
        class_="summary",
    )


def _widest(subject: Subject) -> list[Html]:
    """Return paragraphs on the least certain parameter and its largest source of error; empty if no source is known."""
    sensitivities = () if subject.solution is None else source_sensitivities(subject.solution)
    if not sensitivities:
        return []
    worst = sensitivities[0]
    sigma, then = (
        Figure(v, quantity_of(worst.parameter), digits=2) for v in (worst.sigma, worst.then)
    )
    return [
        element("h2", "Widest sigma"),
        element(
            "p",
            element("span", worst.parameter.name, class_="mono"),
            f": {sigma.with_unit}, {Figure(worst.share, SHARE, places=0).with_unit} of its variance from "
            f"{source_words(worst.source)}. With half of that: {then.with_unit}.",
        ),
        element("p", "To halve it: ", prose(f"{worst.remedy}.")),
    ]


def _tool(subject: Subject) -> list[Html]:
    """Return the tool position error before and after calibration, as text and pictures; empty if not computed."""
    solution, facts = subject.solution, subject.facts
    if solution is None or facts is None or (accuracy := solution.accuracy) is None:
        return []
    pair = hand_pair(solution, subject.procedure.arm)
    before, after = (
        Figure(s.rms, CLOSURE_LENGTH).with_unit for s in (accuracy.before, accuracy.after)
    )
    truth = truth_in_words(solution)
    return [
        element(
            "div",
            element("h2", f"Tool off by {before} rms before, {after} after (one sigma)"),
            *([] if pair is None else [plots([drawn(pair.before), drawn(pair.after)])]),
            *([] if pair is None else [remark(pair.note)]),
            *([element("p", f"The truth: {truth}")] if truth else []),
        )
    ]


def banner(subject: Subject) -> Html:
    """Return the banner of a simulated arm; empty for a real arm."""
    if not subject.simulated:
        return Html("")
    scenario = subject.state.settings.get("scenario")
    text = "SIMULATED: the drives report that they are virtual"
    return element("p", f"{text}; scenario {scenario}" if scenario else text, class_="simulated")


def verdict(subject: Subject) -> Html:
    """Return the verdict, the arm, and the reasons."""
    facts = subject.facts
    good = facts is not None and facts.accepted
    when = subject.state.opened_utc[:16].replace("T", " ")
    parts: list[str] = [
        element(
            "h1",
            element("span", "✓ " if good else "✕ ", class_="glyph", aria_hidden="true"),
            verdict_words(subject),
        ),
        element(
            "p",
            f"Calibration of {subject.procedure.arm.name}, serial "
            f"{subject.state.serial_number or 'not known'}, in fixture {subject.procedure.fixture.name}, "
            f"{when} UTC.",
            " The limits of the procedure are met." if good else "",
        ),
    ]
    if reasons := _reasons(subject):
        parts.append(bullets(sentence(reason) for reason in reasons))
    return element("div", *parts, class_="verdict" if good else "verdict no")


def tiles(facts: Facts | None) -> Html:
    """Return the headline figures of a calibration."""
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
    """Return the reasons why the calibration is not accepted or not possible."""
    if subject.facts is not None:
        return subject.facts.reasons
    blind = subject.unidentifiable
    return [] if blind is None else [str(d) for d in blind.directions]


def history_html(history: ArmHistory) -> bytes:
    """Return the history page of an arm, UTF-8."""
    last = history.calibrations[-1].document
    title = f"{last.arm.model} {last.arm.serial}: history"
    sections = [
        Section(
            ident=f"part-{k}",
            title=title_of(part),
            content=(
                *([plots(_chart(part, j) for j in range(len(part.names)))] if part.several else []),
                table_html(entries_table(part)),
                table_html(sessions_table(part)),
            ),
        )
        for k, part in enumerate(history.parts, 1)
    ]
    notes = [*checks_lines(history), *(f"{n} left out: {reason}" for n, reason in history.left_out)]
    how = Section(
        ident="how", title="Verifications and method", content=(bullets(notes), remark(HOW))
    )
    good = not history.shifted
    verdict = element(
        "div",
        *(element("p", line.strip()) for line in verdict_text(history).split("\n- ")),
        element("p", due_text(history)),
        class_="verdict" if good else "verdict no",
    )
    body = element(
        "body",
        element("header", element("h1", title), verdict),
        element("main", *(section.html for section in [*sections, how]), id="content"),
    )
    return document(title, body)


def _chart(part: EntryHistory, j: int) -> Html:
    """Draw entry `j` over the sessions, with Shewhart and EWMA limits if these are known."""
    name, chart = part.names[j], part.chart
    unit = quantity(name)
    count = len(part.calibrations)
    sessions = [float(k) for k in range(1, count + 1)]
    values = (unit.per_si * part.values[:, j]).tolist()
    layers: list[Layer] = []
    heights = list(values)
    for half, style, label in (
        (chart.shewhart, "a", "Shewhart"),
        (chart.ewma_limit, "dashed", "EWMA limits"),
    ):
        for sign in (-1.0, 1.0):
            limit = (unit.per_si * (chart.centre[:, j] + sign * half[:, j])).tolist()
            known = [k for k in range(count) if math.isfinite(limit[k])]
            heights += [limit[k] for k in known]
            shown = label if sign > 0.0 else ""
            x, y = [sessions[k] for k in known], [limit[k] for k in known]
            if known:
                layers.append(Polyline(x=x, y=y, class_=style, label=shown))
    tips = [
        f"{c.session}: {v:.4f} {unit.unit}" for c, v in zip(part.calibrations, values, strict=True)
    ]
    layers.append(Marks(x=sessions, y=values, label="session", tips=tips))
    ewma = (unit.per_si * chart.ewma[:, j]).tolist()
    layers.append(Marks(x=sessions, y=ewma, shape="triangle", class_="b", label="EWMA"))
    picture = Picture(
        ident=f"{part.side.name.lower()}-{name}",
        title=f"{name} by session, in {unit.unit}",
        description="Dots are sessions, triangles the weighted mean of recent ones; lines are their limits.",
        x=axis("session", sessions, whole=True),
        y=axis(name, heights, unit=unit.unit),
        layers=layers,
    )
    return drawn(picture)
