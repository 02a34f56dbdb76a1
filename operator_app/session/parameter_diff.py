"""New parameters against those the controller has active, entry by entry. Knows documents only."""

from __future__ import annotations

from collections.abc import Mapping

from operator_app.config.parameters import ParametersDocument
from operator_app.session.snapshot import DiffRow


def diff_rows(new: ParametersDocument, active: ParametersDocument | None) -> tuple[DiffRow, ...]:
    """Every calibrated entry: what is active (None: nothing), what would be."""
    before = {} if active is None else _entries(active)
    now = _entries(new)
    rows = []
    for entry in (c.entry for c in new.calibrated):
        is_length = entry.startswith(("s_", "a_"))
        old = before.get(entry)
        rows.append(
            DiffRow(
                name=entry,
                unit="mm" if is_length else "deg",
                active=None if old is None else old * (1e3 if is_length else 1.0),
                new=now[entry] * (1e3 if is_length else 1.0),
            )
        )
    return tuple(rows)


def _entries(document: ParametersDocument) -> Mapping[str, float]:
    """Values by the paper's names: deg and m."""
    found: dict[str, float] = {}
    for row in document.dh:
        found[f"theta_off_{row.row}"] = row.theta_off_deg
        found[f"s_{row.row}"] = row.s_m
        found[f"a_{row.row}"] = row.a_m
        found[f"alpha_{row.row}"] = row.alpha_deg
    return found
