"""The fixture file (``sarcal/fixture/1``): where the metal is, and how well that is known.

Knows no arm. What each kind of fixture has in its file is in `fixture_models`.
"""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path

from fixtures.base import Fixture
from operator_app.config.fixture_models import MODELS
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
    checklist
        What the operator confirms before anything moves.
    """

    name: str
    fixture: Fixture
    checklist: tuple[str, ...]

    @property
    def kind(self) -> str:
        """``hinge``, ``rigid``, ..."""
        return self.fixture.kind

    @property
    def tolerance_m(self) -> float:
        """How well the placement was measured: the true one is believed to be within this."""
        return self.fixture.tolerance.position_m

    @property
    def tolerance_rad(self) -> float:
        """The same of its angles."""
        return self.fixture.tolerance.orientation_rad


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
        checklist=found.checklist,
    )


def load_fixture(reference: str | Path) -> FixtureSpec:
    """Read a fixture by built-in name or path; raises as `parse_fixture`."""
    found = resolve("fixture", reference)
    return parse_fixture(found.data, found.file)
