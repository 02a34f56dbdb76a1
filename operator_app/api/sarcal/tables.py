"""A table of figures with their units: text in a terminal, HTML in a notebook, rows for a program."""

import copyreg
from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field
from types import MappingProxyType
from typing import Any

from operator_app.report.html.markup import table_html
from operator_app.report.table import FactTable as Facts
from operator_app.report.table import shown
from operator_app.report.text import table_text
from operator_app.units import ANGLE, LENGTH
from solver.chain.parameters import Parameter


@dataclass(frozen=True, slots=True)
class Table:
    """A table returned by `Result.table`.

    Its ``str`` is text for 80 columns (``correlations``: wider, with a column per parameter); a notebook shows HTML.

    Attributes
    ----------
    name, title
        Name by which `Result.table` finds the table; heading of the table.

    Examples
    --------
    >>> import sarcal
    >>> made = sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=30, seed=0)
    >>> result = sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)
    >>> result.table()
    <sarcal.Table parameters: 14 rows>
    >>> result.table().columns[:3]
    ('parameter', 'unit', 'nominal')
    >>> result.table("dh").rows[0][0]
    '0'
    """

    name: str
    title: str
    _facts: Facts = field(repr=False)

    @property
    def columns(self) -> tuple[str, ...]:
        """Headers, with the unit in brackets if one unit applies to the whole column."""
        return tuple(
            " ".join(filter(None, (c.group, c.title, f"[{c.unit}]" if c.unit else "")))
            for c in self._facts.whole.columns
        )

    @property
    def rows(self) -> tuple[tuple[str, ...], ...]:
        """Cells as printed; the exact numbers are in `Result.values` and `Result.to_json`."""
        return tuple(tuple(shown(cell) for cell in row) for row in self._facts.whole.rows)

    def to_frame(self) -> Any:
        """Return a pandas data frame; raises ImportError if pandas is not installed."""
        import pandas as pd  # type: ignore[import-not-found,import-untyped,unused-ignore]

        return pd.DataFrame(list(self.rows), columns=list(self.columns))

    def __str__(self) -> str:
        return table_text(self._facts)

    def __repr__(self) -> str:
        return f"<sarcal.Table {self.name}: {len(self._facts.rows)} rows>"

    def _repr_html_(self) -> str:
        return str(table_html(self._facts))


def _read_only(values: dict[Any, Any]) -> MappingProxyType[Any, Any]:
    return MappingProxyType(values)


# Results go to and from worker processes, and are copied; the standard library cannot pickle a mapping proxy.
copyreg.pickle(MappingProxyType, lambda proxy: (_read_only, (dict(proxy),)))


def with_units(parameters: Iterable[Parameter], values: Iterable[float]) -> Mapping[str, float]:
    """Return values (rad, m) converted to deg and mm, read-only; keys: parameter names with unit (``a_0_mm``)."""
    return MappingProxyType(
        {
            f"{p.name}_deg" if p.is_angle else f"{p.name}_mm": (
                float(v) * (ANGLE if p.is_angle else LENGTH).per_si
            )
            for p, v in zip(parameters, values, strict=True)
        }
    )
