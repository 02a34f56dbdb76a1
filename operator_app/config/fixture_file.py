"""The fixture file (``sarcal/fixture/1``): where the metal is, and how well that is known.

Knows no arm. An operator measures a fixture with a rule, so its lengths are in millimetres. Entries
carry the paper's names; ``a_n_mm``, ``s_n_mm`` and ``alpha_n_deg`` belong to the last link, from the
arm's last joint to the hinge axis (a_7, s_7, alpha_7 of the paper).
"""

from __future__ import annotations

import math
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from fixtures.base import Fixture
from fixtures.hinge import Hinge
from fixtures.rigid import Rigid
from operator_app.config.quantities import LengthMm, Name, PositiveNumber, Text, TwistDeg
from operator_app.config.resources import resolve
from operator_app.config.schema import StrictModel, read_by_kind, report


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
    stiffness_n_per_m, stiffness_nm_per_rad
        Of the fixture and its mounting; None where it is not known.
    checklist
        What the operator confirms before anything moves.
    """

    name: str
    fixture: Fixture
    tolerance_m: float
    tolerance_rad: float
    stiffness_n_per_m: float | None
    stiffness_nm_per_rad: float | None
    checklist: tuple[str, ...]

    @property
    def kind(self) -> str:
        """``hinge`` or ``rigid``."""
        return self.fixture.kind


class _Placement(StrictModel):
    """Base of placements: refuses one that was plainly written in metres."""


def _lengths_in_mm(placement: _Placement, info: ValidationInfo) -> None:
    lengths = {k: v for k, v in placement.model_dump().items() if k.endswith("_mm") and v != 0.0}
    if lengths and max(abs(v) for v in lengths.values()) < 5.0:
        shown = ", ".join(f"{k} {v:g}" for k, v in lengths.items())
        report(
            info,
            ("placement",),
            f"no dimension reaches 5 mm ({shown}): metres where millimetres belong?",
            "write millimetres",
        )


class HingePlacement(_Placement):
    """Nominal placement of a hinge, as `fixtures.hinge.Hinge`."""

    a_0_mm: LengthMm
    s_0_mm: LengthMm
    alpha_0_deg: TwistDeg
    s_1_mm: LengthMm
    a_n_mm: LengthMm
    s_n_mm: LengthMm
    alpha_n_deg: TwistDeg

    def fixture(self) -> Hinge:
        """Domain object."""
        return Hinge(
            a_0_m=self.a_0_mm / 1e3,
            s_0_m=self.s_0_mm / 1e3,
            alpha_0_rad=math.radians(self.alpha_0_deg),
            s_1_m=self.s_1_mm / 1e3,
            a_n_m=self.a_n_mm / 1e3,
            s_n_m=self.s_n_mm / 1e3,
            alpha_n_rad=math.radians(self.alpha_n_deg),
        )


class RigidPlacement(_Placement):
    """Nominal placement of a rigid attachment, as `fixtures.rigid.Rigid`."""

    a_0_mm: LengthMm
    s_0_mm: LengthMm
    alpha_0_deg: TwistDeg
    s_1_mm: LengthMm

    def fixture(self) -> Rigid:
        """Domain object."""
        return Rigid(
            a_0_m=self.a_0_mm / 1e3,
            s_0_m=self.s_0_mm / 1e3,
            alpha_0_rad=math.radians(self.alpha_0_deg),
            s_1_m=self.s_1_mm / 1e3,
        )


class StiffnessModel(StrictModel):
    """Stiffness of the fixture, where it is known."""

    n_per_m: PositiveNumber
    nm_per_rad: PositiveNumber


class _CommonFields(StrictModel):
    name: Name
    tolerance_mm: Annotated[PositiveNumber, Field(le=1000.0)]
    tolerance_deg: Annotated[PositiveNumber, Field(le=180.0)]
    stiffness: StiffnessModel | None = None
    checklist: Annotated[tuple[Text, ...], Field(min_length=1)]


class HingeFixtureModel(_CommonFields):
    """A hinge."""

    kind: Literal["hinge"]
    placement: HingePlacement

    @field_validator("placement")
    @classmethod
    def _unit(cls, value: HingePlacement, info: ValidationInfo) -> HingePlacement:
        _lengths_in_mm(value, info)
        return value


class RigidFixtureModel(_CommonFields):
    """A rigid attachment."""

    kind: Literal["rigid"]
    placement: RigidPlacement

    @field_validator("placement")
    @classmethod
    def _unit(cls, value: RigidPlacement, info: ValidationInfo) -> RigidPlacement:
        _lengths_in_mm(value, info)
        return value


MODELS: dict[str, type[HingeFixtureModel | RigidFixtureModel]] = {
    "hinge": HingeFixtureModel,
    "rigid": RigidFixtureModel,
}


def parse_fixture(data: bytes, file: str) -> FixtureSpec:
    """Read a fixture from the bytes of its file; `file` is its name in messages.

    Raises
    ------
    ConfigError
        With all that is wrong.
    """
    found = read_by_kind(MODELS, data, kind="fixture", file=file)
    stiffness = found.stiffness
    return FixtureSpec(
        name=found.name,
        fixture=found.placement.fixture(),
        tolerance_m=found.tolerance_mm / 1e3,
        tolerance_rad=math.radians(found.tolerance_deg),
        stiffness_n_per_m=None if stiffness is None else stiffness.n_per_m,
        stiffness_nm_per_rad=None if stiffness is None else stiffness.nm_per_rad,
        checklist=found.checklist,
    )


def load_fixture(reference: str | Path) -> FixtureSpec:
    """Read a fixture by built-in name or path; raises as `parse_fixture`."""
    found = resolve("fixture", reference)
    return parse_fixture(found.data, found.file)
