"""The end of a planned capture as text and as JSON: parameters short of the request, and advice."""

from __future__ import annotations

from collections.abc import Iterable, Sequence
from typing import TYPE_CHECKING, Any

from operator_app.report.table import FactTable, figures, words
from operator_app.report.text import paragraph, table_lines
from operator_app.units.figure import Figure, in_json, quantity_of

if TYPE_CHECKING:
    from operator_app.session.store.state import CapturedPose
    from operator_app.session.workflow.planned_capture import CampaignEnd
    from solver.chain.parameters import Parameter

PLACES = 4


def capture_json(
    end: CampaignEnd | None,
    advice: str,
    parameters: Iterable[Parameter],
    poses: Sequence[CapturedPose],
) -> dict[str, Any] | None:
    """Return the JSON object of a planned capture; None where poses were explored only."""
    if end is None:
        return None
    known = {p.name: p for p in parameters}
    return {
        "complete": end.complete,
        "text": end.text,
        "explored": sum(not p.planned for p in poses),
        "planned": sum(p.planned for p in poses),
        "weak": [
            {
                "name": w.name,
                "sigma": None if w.sigma is None else in_json(known[w.name], w.sigma),
                "requested": in_json(known[w.name], w.requested),
            }
            for w in end.weak
        ],
        "advice": advice or None,
    }


def capture_text(end: CampaignEnd, advice: str, parameters: Iterable[Parameter]) -> str:
    """Return how a planned capture ended, which parameters fall short, and advice."""
    known = {p.name: quantity_of(p) for p in parameters}
    weak = FactTable(
        ident="weak",
        title="",
        columns=(*words("short of the request", "unit"), *figures("sigma", "requested")),
        rows=tuple(
            (
                w.name,
                known[w.name].unit,
                *(Figure(v, known[w.name], places=PLACES) for v in (w.sigma, w.requested)),
            )
            for w in end.weak
        ),
    )
    lines = [paragraph(f"Plan        {end.text}.", indent=12), *table_lines(weak)]
    if advice:
        lines.append(paragraph(f"Advice      {advice}.", indent=12))
    return "\n".join(lines)
