"""What an export would change on the controller, as a table. Knows no screen and no document."""

from __future__ import annotations

from typing import TYPE_CHECKING

from operator_app.report.parameter_tables import precision
from operator_app.report.table import Cell, FactTable, figures, words
from operator_app.units.figure import ANGLE, LENGTH, Figure
from solver.chain.parameters import wrap_angle

if TYPE_CHECKING:
    from operator_app.calibration.result import Solution
    from operator_app.session.ui.snapshot import DiffRow


def difference_table(solution: Solution, rows: tuple[DiffRow, ...]) -> FactTable:
    """Return every calibrated entry, active and new, with the digits that its calibration is shown with."""
    places = precision(solution.identified)

    def cells(row: DiffRow) -> tuple[Cell, ...]:
        quantity = ANGLE if row.is_angle else LENGTH
        n = places(quantity)
        new = Figure(row.new, quantity, n, role="found")
        if row.active is None:
            return (row.name, quantity.unit, "none", new, "")
        change = row.new - row.active
        change = float(wrap_angle(change)) if row.is_angle else change
        active = Figure(row.active, quantity, n)
        return (row.name, quantity.unit, active, new, Figure(change, quantity, n, signed=True))

    return FactTable(
        ident="difference",
        title="Difference from the controller's active parameters",
        columns=(*words("parameter", "unit"), *figures("active", "new", "change")),
        rows=tuple(map(cells, rows)),
    )


def changed(table: FactTable) -> int:
    """How many entries would read otherwise afterwards."""
    return sum(active != new for _, _, active, new, _ in _shown(table))


def _shown(table: FactTable) -> list[list[str]]:
    return [[c if isinstance(c, str) else c.shown for c in row] for row in table.rows]
