"""Step 7, Export: the parameters file, differences from the controller's active parameters, and the verification."""

from collections.abc import Sequence

from operator_app.report.parameter_tables import formats
from operator_app.report.results.verification import verified_words
from operator_app.report.spans import Line, clip, entry, wrapped_entry
from operator_app.report.table import Cell, FactTable, figures, shown, words
from operator_app.session.ui.snapshot import DiffRow, SessionSnapshot
from operator_app.tui.lines import Lines
from operator_app.tui.steps.view import StepView
from operator_app.tui.widgets.list_panel import TablePanel
from operator_app.units import quantity_of
from solver.chain.parameters import wrap_angle


class _FilePanel(Lines):
    TITLE = "Export"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        serial = s.identity.serial_number if s.identity else s.state.serial_number or "—"
        if s.written is None:
            rows = [entry("File", "not written yet: Enter or w writes it")]
        else:
            rows = [entry("File", f"✓ {s.written.parameters}"), entry("SHA-256", s.written.sha256)]
        if s.identity is not None and not s.identity.keeps_parameters:
            rows.append(entry("Controller", f"none: {serial} stores no parameters"))
            return [clip(row, width) for row in rows]
        rows.append(entry("To", f"controller {serial} over {s.bus}"))
        if s.receipt is None:
            table = _difference_table(s)
            rows_of = () if table is None else table.rows
            # Only differences in the digits shown count.
            changed = sum(shown(active) != shown(new) for _, _, active, new, _ in rows_of)
            text = f"not uploaded: {changed} of {len(s.diff)} parameters would change"
            rows.append(entry("Controller", text))
        else:
            text = f"✓ slot {s.receipt.slot} active, {s.receipt.length} bytes read back"
            rows += [entry("Controller", text), entry("Read back", s.receipt.sha256)]
        return [clip(row, width) for row in rows]


class _DiffPanel(TablePanel):
    TITLE = "Difference from the controller's active parameters"

    def _table(self, s: SessionSnapshot) -> FactTable | None:
        return _difference_table(s)


class RecordPanel(Lines):
    """Verification and the session's files."""

    TITLE = "Record"

    def _build(self, s: SessionSnapshot, width: int, height: int) -> Sequence[Line]:
        if s.verification is None:
            rows = [entry("Verify", "y captures new poses and verifies these parameters")]
        else:
            glyph, role = ("✓ ", "text") if s.verification.holds else ("▲ ", "warn")
            text = f"{glyph}{verified_words(s.verification)}"
            rows = wrapped_entry("Verified", text, width, role=role)
        where = "r writes report.html" if s.report is None else f"✓ {s.report}"
        rows.append(entry("Report", where))
        rows.append(entry("Session", f"{s.folder}"))
        # The session is last, where it may be cut off: the path of the parameters file shows the folder too.
        return [clip(row, width) for row in rows[:height]]


class ExportView(StepView):
    """View of step 7: file, difference, record."""

    PANELS = ({"file": _FilePanel, "diff": _DiffPanel, "record": RecordPanel},)
    MAIN = "diff"


def _difference_table(s: SessionSnapshot) -> FactTable | None:
    if s.solution is None or not s.diff:
        return None
    format_of = formats(s.solution.identified)

    def cells(row: DiffRow) -> tuple[Cell, ...]:
        figure, unit = format_of(row), quantity_of(row).unit
        new = figure(row.new, role="found")
        if row.active is None:
            return (row.name, unit, "none", new, "")
        change = row.new - row.active
        change = float(wrap_angle(change)) if row.is_angle else change
        return (row.name, unit, figure(row.active), new, figure(change, signed=True))

    return FactTable(
        ident="difference",
        title="Difference from the controller's active parameters",
        columns=(*words("parameter", "unit"), *figures("active", "new", "change")),
        rows=tuple(map(cells, s.diff)),
    )
