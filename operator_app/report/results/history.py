"""The history of an arm as tables, text and JSON."""

from typing import Any

import numpy as np

from operator_app.calibration.comparison import Side
from operator_app.calibration.history import ArmHistory, EntryHistory
from operator_app.report.table import Cell, FactTable, figures, words
from operator_app.report.text import WIDTH, paragraph, table_lines
from operator_app.units import ANGLE, LENGTH, Figure, Quantity, places_to_show, plural
from solver.chain.parameters import DhEntry, is_entry
from solver.diagnostics.control_chart import BASELINE, RECENT, ChartSignal
from solver.diagnostics.limits import CONTROL_CHART_FALSE_ALARM_PROBABILITY
from solver.loops.endpoints import MeasuredClosure

TITLES = {
    Side.ARM: "Offsets of the arm",
    Side.GROUND: "Fixture on the table",
    Side.HAND: "Fixture on the tool",
}
HOW = (
    "Mean is the mean of the baseline. By chance, in "
    f"{100.0 * CONTROL_CHART_FALSE_ALARM_PROBABILITY:g} % of sessions, any entry leaves mean +- limit (Shewhart), or "
    f"its weighted mean of the last {RECENT} sessions leaves the EWMA limits. Limits come from the scatter between "
    "sessions, not from sigma: most of sigma is the same in every session. Type A is the scatter if the same poses "
    "were taken again; shift is the size that the next three sessions would show in 90 % of cases. NIST/SEMATECH "
    "e-Handbook, 2.3.5 and 6.3.2."
)

SCATTER_TYPE_A, SCATTER_SIGMAS = 5.0, 3.0
"""The verdict names an entry whose scatter between sessions exceeds these multiples of both type A and sigma."""

FRAMED = 72
"""Columns available inside a frame on a terminal of 80 columns."""


def quantity(name: str) -> Quantity:
    """Return the quantity of a parameter: angle or length."""
    entry = name.partition("[")[0]
    if is_entry(entry):
        return ANGLE if DhEntry.parse(entry).kind.is_angle else LENGTH
    return ANGLE if entry in MeasuredClosure.OWN_ANGLES else LENGTH


def title_of(part: EntryHistory) -> str:
    """Return a title that states what the entries describe, the fixture, the estimator and the number of sessions."""
    first, last = part.calibrations[0].document, part.calibrations[-1].document
    since = "" if part.side is Side.ARM else f", mounted {first.utc:%Y-%m-%d}"
    count = plural(len(part.calibrations), "session")
    return f"{TITLES[part.side]}: fixture {last.fixture.name}, {last.estimator}{since}, {count}"


def entries_table(part: EntryHistory) -> FactTable:
    """Return the table with one row per entry: its last value, its sigmas and its control limits."""
    rows: list[tuple[Cell, ...]] = []
    chart, shifted = part.chart, {s.name for s in part.chart.changes}
    for j, name in enumerate(part.names):
        unit = quantity(name)
        places = places_to_show((unit.per_si * float(part.within[-1, j]),), least=3)
        found = (
            part.values[-1, j], part.sigma[-1, j], np.sqrt(np.mean(part.within[:, j] ** 2)),
            chart.between[-1, j], chart.centre[-1, j], chart.shewhart[-1, j], part.smallest[j],
            chart.ewma[-1, j], chart.ewma_limit[-1, j],
        )  # fmt: skip
        shown = (Figure(float(value), unit, places=places) for value in found)
        rows.append((name, unit.unit, *shown, "!" if name in shifted else ""))
    return FactTable(
        ident="history",
        title=title_of(part),
        columns=(
            *words("entry", "unit"),
            *figures("last", "sigma", "type A", "between", "mean", "limit", "shift"),
            *figures("mean", "limit", group="EWMA", detail=True),
            *words(""),
        ),
        rows=tuple(rows),
    )


def sessions_table(part: EntryHistory) -> FactTable:
    """Return the table with one row per session: the values of all entries."""
    units = [quantity(name) for name in part.names]
    rows: list[tuple[Cell, ...]] = []
    for past, values in zip(part.calibrations, part.values, strict=True):
        shown = (Figure(float(v), u, places=3) for v, u in zip(values, units, strict=True))
        rows.append((f"{past.document.utc:%Y-%m-%d}", *shown, past.session))
    return FactTable(
        ident="values",
        title="By session, in the units above",
        columns=(*words("date"), *figures(*part.names), *words("session", detail=True)),
        rows=tuple(rows),
    )


def verdict_text(history: ArmHistory, width: int = WIDTH) -> str:
    """Return the verdict as text: which entries have shifted, or that none has, or that there are too few sessions."""
    shifts = [_shift_text(part, shift) for part in history.parts for shift in part.chart.changes]
    if shifts:
        lines = (paragraph(f"- {text}", indent=2, width=width) for text in shifts)
        return "\n".join(["SHIFTED:", *lines])
    if (most := _most_sessions(history)) <= BASELINE:
        text = (
            f"TOO EARLY TO JUDGE: limits need {BASELINE} sessions with one fixture before the session to be judged; "
            f"there are {most} with one fixture. Compare two sessions with sarcal compare."
        )
        return paragraph(text, width=width)
    verdict = "IN CONTROL: no entry has shifted."
    if scattered := [text for part in history.parts for text in _scatter_texts(part)]:
        verdict += (
            f" But sessions scatter more than their sigmas explain: {'; '.join(scattered)}. The limits are as wide as "
            "this scatter. Check the home marks and the couplings of these joints."
        )
    return paragraph(verdict, width=width)


def _scatter_texts(part: EntryHistory) -> list[str]:
    if part.side is not Side.ARM or len(part.calibrations) <= BASELINE:
        return []
    type_a, sigma = (np.sqrt(np.mean(v**2, axis=0)) for v in (part.within, part.sigma))
    # The scatter in the chart is not used: it is partly that of the other entries.
    between = part.values.std(axis=0, ddof=1)
    wide = between > np.maximum(SCATTER_TYPE_A * type_a, SCATTER_SIGMAS * sigma)
    return [
        f"{name} by {Figure(float(size), quantity(name), places=3).with_unit} "
        f"(type A {Figure(float(a), quantity(name), places=3).with_unit})"
        for name, size, a, is_wide in zip(part.names, between, type_a, wide, strict=True)
        if is_wide
    ]


def _most_sessions(history: ArmHistory) -> int:
    return max((len(p.calibrations) for p in history.parts if p.side is Side.ARM), default=0)


def due_text(history: ArmHistory) -> str:
    """Return the sentence with the date of the next calibration and its reason."""
    return f"Next calibration due {history.due:%Y-%m-%d}: {history.due_why}."


def checks_lines(history: ArmHistory) -> list[str]:
    """Return one line for each verification."""
    return [
        f"{v.utc:%Y-%m-%d %H:%M}  {'HOLDS' if v.holds else 'DOES NOT HOLD'}  "
        f"{plural(v.poses, 'new pose')}, {1e3 * v.position_m:.3f} mm rms, {v.session}"
        for v in history.verifications
    ]


def history_text(history: ArmHistory, *, brief: bool = False) -> str:
    """Return the history for a terminal, the verdict first; if `brief`, shorter and narrower, for a dialog."""
    arm, width = history.calibrations[-1].document.arm, FRAMED if brief else WIDTH
    calibrations = plural(len(history.calibrations), "accepted calibration")
    counts = f"{calibrations}, {plural(len(history.verifications), 'verification')}"
    due = paragraph(due_text(history), width=width)
    blocks = [verdict_text(history, width), f"{arm.model} {arm.serial}: {counts}\n{due}"]
    for part in history.parts:
        gap = " " if brief else "  "
        head = [title_of(part), *table_lines(entries_table(part), gap, gap)]
        if not brief and part.side is Side.ARM:
            head += ["", *table_lines(sessions_table(part))]
        blocks.append("\n".join(head))
    if lines := checks_lines(history):
        blocks.append("\n".join(["Verifications", *(f"  {line}" for line in lines)]))
    blocks.append("What each column is: m, page over-the-years" if brief else paragraph(HOW))
    blocks += [
        paragraph(f"Left out: {name} ({reason})", width=width) for name, reason in history.left_out
    ]
    return "\n\n".join(blocks)


def history_json(history: ArmHistory) -> dict[str, Any]:
    """Return the object that `sarcal history --json` prints; angles in deg, lengths in m."""
    last, verdict = history.calibrations[-1].document, "in control"
    if history.shifted:
        verdict = "shifted"
    elif _most_sessions(history) <= BASELINE:
        verdict = "too early to judge"
    return {
        "arm_model": last.arm.model,
        "arm_serial": last.arm.serial,
        "verdict": verdict,
        "due": _utc(history.due),
        "due_why": history.due_why,
        "level": CONTROL_CHART_FALSE_ALARM_PROBABILITY,
        "parts": [_part_json(part) for part in history.parts],
        "verifications": [
            {
                "session": v.session,
                "utc": _utc(v.utc),
                "poses": v.poses,
                "holds": v.holds,
                "position_mm": Figure(1e3 * v.position_m).in_json,
                "why": v.why,
            }
            for v in history.verifications
        ],
        "left_out": [{"session": name, "why": reason} for name, reason in history.left_out],
    }


def _part_json(part: EntryHistory) -> dict[str, Any]:
    def in_json(name: str, value: float) -> float | None:
        return Figure(float(value), quantity(name)).in_json

    chart = part.chart
    by_session = {
        "value": part.values,
        "sigma": part.sigma,
        "type_a": part.within,
        "between": chart.between,
        "centre": chart.centre,
        "shewhart_half_width": chart.shewhart,
        "ewma": chart.ewma,
        "ewma_half_width": chart.ewma_limit,
    }
    return {
        "side": part.side.name.lower(),
        "fixture": part.calibrations[-1].document.fixture.name,
        "estimator": part.calibrations[-1].document.estimator,
        "sessions": [
            {"session": c.session, "utc": _utc(c.document.utc), "mounting": c.mounting}
            for c in part.calibrations
        ],
        "entries": {
            name: {
                "unit": "deg" if quantity(name) is ANGLE else "m",
                **{k: [in_json(name, v) for v in table[:, j]] for k, table in by_session.items()},
                "smallest_shift": in_json(name, part.smallest[j]),
            }
            for j, name in enumerate(part.names)
        },
        "shifts": [
            {
                "entry": s.name,
                "since": part.calibrations[s.at].session,
                "seen": part.calibrations[s.detected_at].session,
                "size": in_json(s.name, s.size),
                "sigma": in_json(s.name, s.sigma),
                "chart": s.chart,
            }
            for s in part.chart.changes
        ],
    }


def _shift_text(part: EntryHistory, shift: ChartSignal) -> str:
    unit, first = quantity(shift.name), part.calibrations[shift.at]
    size = Figure(shift.size, unit, places=3, signed=True).with_unit
    sigma = Figure(shift.sigma, unit, places=3).with_unit
    by = {"shewhart": "Shewhart", "ewma": "EWMA"}[shift.chart]
    advice = "the fixture's mounting has moved, or it was remounted: omit --kept-mounted"
    if part.side is Side.ARM:
        advice = "check the encoder's home mark and the coupling of that joint"
    return (
        f"{shift.name} by {size} (sigma {sigma}) from {first.document.utc:%Y-%m-%d} on, session "
        f"{first.session}; seen in session {shift.detected_at + 1} by {by}: {advice}"
    )


def _utc(time: Any) -> str:
    return f"{time:%Y-%m-%dT%H:%M:%SZ}"
