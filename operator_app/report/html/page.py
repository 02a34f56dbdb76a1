"""A session, or the history of an arm, as one self-contained HTML page. No script, no external resource."""

from __future__ import annotations

from collections.abc import Iterable
from pathlib import Path
from typing import TYPE_CHECKING

import numpy as np

from operator_app.calibration.history import ArmHistory, EntryHistory
from operator_app.calibration.sensitivity import source_sensitivities
from operator_app.config.atomic import write_atomically
from operator_app.errors import GuardError
from operator_app.report.html import markup
from operator_app.report.html.markup import STYLE, Html, Section, element
from operator_app.report.html.sections import sections_of
from operator_app.report.plots.before_after import hand_pair
from operator_app.report.plots.plot import Layer, Marks, Picture, Polyline, axis
from operator_app.report.plots.svg import drawn
from operator_app.report.quality_tables import truth_in_words
from operator_app.report.results import history as history_output
from operator_app.report.subject import subject_of_session
from operator_app.report.uncertainty_tables import source_words
from operator_app.session.store.journal import read_journal
from operator_app.session.store.stored_calibration import StoredCalibration, journal_calibration
from operator_app.session.workflow.importing import UNKNOWN_SERIAL_NUMBER
from operator_app.units import CLOSURE_LENGTH, PERCENT, Figure, Kind, names, quantity_of, typeset

if TYPE_CHECKING:
    from operator_app.report.facts import Facts
    from operator_app.report.subject import Subject
    from operator_app.report.table import Headline
    from operator_app.session.workflow.session import Session


POLICY = "default-src 'none'; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"
"""Content security policy of the page: the browser loads no other resource."""


def report_html(subject: Subject) -> bytes:
    """Return the report page of a session, UTF-8; the same journal gives the same bytes."""
    facts = subject.facts
    sections = sections_of(subject, facts)
    arm, program = subject.procedure.arm.name, f"sarcal {subject.software_version}"
    outcome = "not identifiable" if facts is None else facts.verdict
    title = f"{arm} {subject.state.serial_number}: {outcome.lower()} ({subject.name})"
    links = [element("li", element("a", s.title, href=f"#{s.ident}")) for s in sections]
    contents = element("nav", element("ul", *links), aria_label="Contents")
    verdict = element("div", _banner(subject), _verdict(subject, facts, outcome), *_widest(subject))
    body = element(
        "body",
        element("a", "Skip to the content", href="#content", class_="skip"),
        element(
            "header",
            element("div", verdict, *_tool(subject), class_="summary"),
            _tiles(() if facts is None else facts.headlines),
            contents,
        ),
        element("main", *(section.html for section in sections), id="content"),
        element(
            "footer",
            f"Made from the journal of session {subject.name} by {program}. ",
            element("code", "sarcal report"),
            " writes this page again. ",
            *_history(subject.state.serial_number),
        ),
    )
    return _document(title, body, generator=program)


def _document(title: str, body: Html, *, generator: str = "") -> bytes:
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
    command = element("code", f"sarcal history {serial} -o history.html")
    return "All calibrations of this arm, with control charts: ", command, "."


REPORT_NAME = "report.html"


def write_report(session: Session) -> Path:
    """Write the report page and return its path; raises GuardError if the present poses have no calibration."""
    calibration = journal_calibration(session.state)
    if not isinstance(calibration, StoredCalibration):
        raise GuardError("There is no calibration of these poses", "Calibrate first (step 5)")
    folder = session.journal.path.parent
    subject = subject_of_session(folder, read_journal(folder), session.procedure, calibration)
    write_atomically(folder / REPORT_NAME, report_html(subject))
    return folder / REPORT_NAME


def _widest(subject: Subject) -> list[Html]:
    sensitivities = () if subject.solution is None else source_sensitivities(subject.solution)
    if not sensitivities:
        return []
    worst = sensitivities[0]
    figure, name = Kind(quantity_of(worst.parameter), digits=2), worst.parameter.name
    text = (
        f": {figure(worst.sigma).with_unit}, {PERCENT(worst.share).with_unit} of its variance from "
        f"{source_words(worst.source)}. With half of that source: {figure(worst.then).with_unit}."
    )
    return [
        element("h2", "Widest sigma"),
        element("p", element("span", name, class_="mono"), text),
        element("p", "To halve the source: ", typeset(f"{worst.remedy}.")),
    ]


def _tool(subject: Subject) -> list[Html]:
    solution = subject.solution
    if solution is None or (accuracy := solution.accuracy) is None:
        return []
    both = (accuracy.before, accuracy.after)
    before, after = (Figure(spread.rms, CLOSURE_LENGTH).with_unit for spread in both)
    head = f"Tool off by {before} rms before, {after} after (one sigma)"
    if (by_poses := accuracy.after_by_poses) is not None:
        without = Figure(by_poses.rms, CLOSURE_LENGTH).with_unit
        head += f", {without} without the uncertainty of {names(accuracy.stated)}"
    parts = [element("h2", head)]
    if pair := hand_pair(subject):
        parts += [markup.plots(map(drawn, pair.pictures)), markup.remark(pair.note)]
    if truth := truth_in_words(solution):
        parts.append(element("p", f"The truth: {truth}"))
    return [element("div", *parts)]


def _banner(subject: Subject) -> Html:
    if not subject.simulated:
        return Html("")
    scenario = subject.state.settings.get("scenario")
    text = "SIMULATED: the drives report that they are virtual"
    return element("p", f"{text}; scenario {scenario}" if scenario else text, class_="simulated")


def _verdict(subject: Subject, facts: Facts | None, outcome: str) -> Html:
    good = facts is not None and facts.solution.accepted
    blind = subject.unidentifiable
    reasons: Iterable[str] = map(str, blind.directions if blind else ())
    if facts is not None:
        reasons = facts.solution.reasons
    when = subject.state.opened_utc[:16].replace("T", " ")
    glyph = element("span", "✓ " if good else "✕ ", class_="glyph", aria_hidden="true")
    points = [markup.sentence(reason) for reason in reasons]
    procedure, serial = subject.procedure, subject.state.serial_number or "not known"
    arm = (
        f"Calibration of {procedure.arm.name}, serial {serial}, in fixture {procedure.fixture.name}"
    )
    met = f" {markup.sentence(facts.limits_met)}" if facts is not None and good else ""
    return element(
        "div",
        element("h1", glyph, outcome.capitalize()),
        element("p", f"{arm}, {when} UTC.{met}"),
        *([markup.bullets(points)] if points else []),
        class_="verdict" if good else "verdict no",
    )


def _tiles(headlines: Iterable[Headline]) -> Html:
    tiles = []
    for h in headlines:
        unit = element("span", h.figure.quantity.unit, class_="unit")
        value, note = element("dd", h.figure.shown, " ", unit), element("dd", h.note, class_="was")
        tiles.append(element("div", element("dt", h.name), value, note))
    return element("dl", *tiles, class_="tiles")


def history_html(history: ArmHistory) -> bytes:
    """Return the history page of an arm, UTF-8."""
    last = history.calibrations[-1].document
    title = f"{last.arm.model} {last.arm.serial}: history"
    sections = []
    for k, part in enumerate(history.parts, 1):
        drawn_entries = (_chart(part, j) for j in range(len(part.names)))
        charts = [markup.plots(drawn_entries)] if len(part.calibrations) > 1 else []
        tables = history_output.entries_table(part), history_output.sessions_table(part)
        content = (*charts, *map(markup.table_html, tables))
        heading = history_output.title_of(part)
        sections.append(Section(ident=f"part-{k}", title=heading, content=content))
    notes = [
        *history_output.checks_lines(history),
        *(f"{n} left out: {reason}" for n, reason in history.left_out),
    ]
    method = (markup.bullets(notes), markup.remark(history_output.HOW))
    sections.append(Section(ident="how", title="Verifications and method", content=method))
    lines = history_output.verdict_text(history).split("\n- ")
    verdict = element(
        "div",
        *(element("p", line.strip()) for line in lines),
        element("p", history_output.due_text(history)),
        class_="verdict no" if history.shifted else "verdict",
    )
    body = element(
        "body",
        element("header", element("h1", title), verdict),
        element("main", *(section.html for section in sections), id="content"),
    )
    return _document(title, body)


def _chart(part: EntryHistory, j: int) -> Html:
    name, chart, unit = part.names[j], part.chart, history_output.quantity(part.names[j])
    sessions = [float(k) for k in range(1, len(part.calibrations) + 1)]
    values = (unit.per_si * part.values[:, j]).tolist()
    layers: list[Layer] = []
    heights = list(values)
    ewma_limits = chart.ewma_limit, "dashed", "EWMA limits"
    for half, style, label in ((chart.shewhart, "a", "Shewhart"), ewma_limits):
        for sign in (-1.0, 1.0):
            limit = unit.per_si * (chart.centre[:, j] + sign * half[:, j])
            known = np.isfinite(limit)
            x, y = np.array(sessions)[known].tolist(), limit[known].tolist()
            heights += y
            if y:
                shown = label if sign > 0.0 else ""
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
