"""New parameters against those the controller has active, entry by entry. Knows documents only."""

from __future__ import annotations

from operator_app.config.parameters import ParametersDocument
from operator_app.session.ui.snapshot import DiffRow
from solver.chain.parameters import DhEntry


def diff_rows(new: ParametersDocument, active: ParametersDocument | None) -> tuple[DiffRow, ...]:
    """Every calibrated entry: what is active (None: nothing), what would be; rad and m."""
    now, before = new.table.stacked(), None if active is None else active.table.stacked()
    return tuple(
        DiffRow(
            name=entry.name,
            is_angle=entry.kind.is_angle,
            active=None if before is None else float(before[entry.kind, entry.row]),
            new=float(now[entry.kind, entry.row]),
        )
        for entry in (DhEntry.parse(c.entry) for c in new.calibrated)
    )
