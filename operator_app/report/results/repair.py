"""What a repair kept and what is lost, line by line, as text and as data. Repairs nothing, prints nothing."""

from __future__ import annotations

from itertools import groupby
from typing import TYPE_CHECKING, Any

from operator_app.report.text import paragraph

if TYPE_CHECKING:
    from operator_app.session.store.journal_repair import Repaired, RepairedLine

KEPT, RESTORED, LOST = "kept", "restored", "lost"


def fate(line: RepairedLine) -> str:
    """Return what became of a line, in a word."""
    if line.event is None:
        return LOST
    return RESTORED if line.words else KEPT


def repair_json(found: Repaired) -> dict[str, Any]:
    """Return it as data."""
    return {
        "folder": str(found.folder),
        "repaired": found.aside is not None,
        "original": None if found.aside is None else str(found.aside),
        "lines": [
            {
                "line": line.number,
                "fate": fate(line),
                "event": None if line.event is None else line.event.name,
                "why": line.words,
            }
            for line in found.lines
        ],
        "poses": len(found.state.used_poses),
    }


def repair_text(found: Repaired) -> str:
    """Return it as paragraphs."""
    folder = found.folder
    if found.aside is None:
        torn = " Its last line was never written to its end: a session that goes on leaves it out."
        return paragraph(
            f"{folder}: the journal is whole, {len(found.lines)} lines; nothing was changed."
            + (torn if found.torn else "")
        )
    said = [paragraph(f"{folder}: repaired. The damaged journal is untouched in {found.aside}.")]
    for what, some in groupby(found.lines, key=fate):
        if what is KEPT:
            first, *others = some
            last = others[-1].number if others else first.number
            span = f"line {first.number}" if not others else f"lines {first.number} to {last}"
            said.append(f"  {span}: kept, proven by {'its' if not others else 'their'} checksum")
            continue
        for line in some:
            name = "" if line.event is None else f" ({line.event.name.replace('_', ' ')})"
            said.append(paragraph(f"  line {line.number}: {what}{name}: {line.words}", indent=4))
    if found.torn:
        said.append("  the last line was never written to its end, and does not count")
    state = found.state
    said.append(f"{len(state.used_poses)} poses count.")
    if found.lost:
        said.append(
            paragraph(
                "What was calibrated from them does not count any more, as a pose or its exclusion may "
                "be among what is lost: look at the poses before you calibrate again."
            )
        )
    if state.sources:
        said.append(f"Go on with: sarcal run --resume {folder}")
    else:
        said.append(
            paragraph(
                "What was opened is lost with line 1, so that this session cannot go on: begin a new one."
            )
        )
    return "\n".join(said)
