"""The fixture file (``sarcal/fixture/1``): where the metal is, and how well that is known.

Knows no arm. What each kind of fixture has in its file is in `fixture_models`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fixtures.base import Fixture
from operator_app.config.fixture_models import MODELS
from operator_app.config.quantities import in_si
from operator_app.config.resources import resolve
from operator_app.config.schema import read_by_kind


@dataclass(frozen=True, slots=True, kw_only=True)
class FixtureSpec:
    """A fixture as its file describes it.

    Attributes
    ----------
    name
        What the operator calls it.
    fixture
        The loop it closes, at its nominal placement.
    tolerance_m, tolerance_rad
        How well the placement was measured: the true one is believed to be within this.
    checklist
        What the operator confirms before anything moves.
    """

    name: str
    fixture: Fixture
    tolerance_m: float
    tolerance_rad: float
    checklist: tuple[str, ...]

    @property
    def kind(self) -> str:
        """``hinge``, ``rigid``, ..."""
        return self.fixture.kind


def parse_fixture(data: bytes, file: str) -> FixtureSpec:
    """Read a fixture from the bytes of its file; `file` is its name in messages.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    found = read_by_kind(MODELS, data, kind="fixture", file=file)
    return FixtureSpec(
        name=found.name,
        fixture=found.fixture(),
        **in_si({"tolerance_mm": found.tolerance_mm, "tolerance_deg": found.tolerance_deg}),
        checklist=found.checklist,
    )


def load_fixture(reference: str | Path) -> FixtureSpec:
    """Read a fixture by built-in name or path; raises as `parse_fixture`."""
    found = resolve("fixture", reference)
    return parse_fixture(found.data, found.file)
