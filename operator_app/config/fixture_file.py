"""Reads the fixture file (``sarcal/fixture/1``), and builds the fixture from its placement and tolerances."""

import math
from abc import ABC, abstractmethod
from collections.abc import Iterator
from dataclasses import dataclass
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal, Self

from pydantic import Field, field_validator, model_validator

from fixtures.ball import Ball, KnownDistance
from fixtures.base import EndpointConstraint, Tolerance
from fixtures.hinge import Hinge
from fixtures.measured import Measured
from fixtures.rigid import Rigid
from operator_app.config import quantities
from operator_app.config.error_model import GiveModel
from operator_app.config.resources import resolve
from operator_app.config.schema import Fields, StrictModel, checked, read_by_kind
from operator_app.config.strict_yaml import Complaint


@dataclass(frozen=True, slots=True, kw_only=True)
class FixtureSpec:
    """A fixture as described in its file, at its nominal placement.

    `checklist`: what the operator confirms before anything moves.
    """

    name: str
    fixture: EndpointConstraint
    checklist: tuple[str, ...]

    @property
    def kind(self) -> str:
        """Kind of the fixture: ``hinge``, ``rigid``, ..."""
        return self.fixture.kind


def parse_fixture(data: bytes, file: str) -> FixtureSpec:
    """Read a fixture from the bytes of its file, called `file` in messages; raises ConfigError with its problems."""
    model = read_by_kind(MODELS, data, kind="fixture", file=file)
    return FixtureSpec(name=model.name, fixture=model.fixture(), checklist=model.checklist)


def load_fixture(reference: str | Path) -> FixtureSpec:
    """Read a fixture by built-in name or path; raises the same errors as `parse_fixture`."""
    resource = resolve("fixture", reference)
    return parse_fixture(resource.data, resource.file)


PointMm = tuple[quantities.LengthMm, quantities.LengthMm, quantities.LengthMm]
TurnVectorDeg = tuple[quantities.TwistDeg, quantities.TwistDeg, quantities.TwistDeg]

PlacementNumber = Annotated[int, Field(ge=1)]

SMALLEST_MM = 5.0
"""A placement whose dimensions are all smaller than this was probably written in metres."""


class Placement(StrictModel):
    """Base class of nominal placements of a fixture."""

    @model_validator(mode="after")
    def _in_millimetres(self) -> Self:
        lengths = {}
        for name, entry in self:
            if name.endswith("_mm"):
                lengths[name] = max(entry if isinstance(entry, tuple) else (entry,), key=abs)
        if 0.0 < max(map(abs, lengths.values())) < SMALLEST_MM:
            shown = ", ".join(f"{k} {v:g}" for k, v in lengths.items() if v)
            text = f"no dimension reaches {SMALLEST_MM:g} mm ({shown}): they may be in metres"
            raise quantities.refuse(text, "write millimetres")
        return self


class CommonFields(StrictModel, ABC):
    """Common fields of all fixture files."""

    makes: ClassVar[type[Hinge | Rigid | Ball | Measured]]

    name: quantities.Name
    tolerance_mm: Annotated[quantities.PositiveNumber, Field(le=1000.0)]
    tolerance_deg: Annotated[quantities.PositiveNumber, Field(le=180.0)]
    checklist: Annotated[tuple[quantities.Text, ...], Field(min_length=1)]
    placement: Placement
    stays_on_hand: quantities.Yes = False

    def fixture(self) -> EndpointConstraint:
        """Return the fixture as a domain object."""
        placed = quantities.in_si(self.placement.model_dump(exclude_none=True))
        tolerance = Tolerance(
            position_m=self.tolerance_mm / 1e3, orientation_rad=math.radians(self.tolerance_deg)
        )
        return self.makes(
            **placed, stays_on_hand=self.stays_on_hand, tolerance=tolerance, **self.own()
        )

    @abstractmethod
    def own(self) -> dict[str, Any]:
        """Return those keyword arguments of the class in `makes` that only this kind of fixture has."""


class MetalFields(CommonFields):
    """Common fields in the files of fixtures that constrain the tool.

    `give`: compliance. `stiffness` has no effect, but files of earlier versions may state it.
    """

    holds: ClassVar[tuple[str, ...]] = ("position_mm", "orientation_mrad")

    give: GiveModel = GiveModel()
    stiffness: Any = None

    def own(self) -> dict[str, Any]:
        """Return the compliance, as a keyword argument of the class in `makes`."""
        return {"compliance": self.give.compliance(self.holds)}


class RigidPlacement(Placement):
    """Nominal placement of a tool attached rigidly to the ground."""

    a_0_mm: quantities.LengthMm
    s_0_mm: quantities.LengthMm
    alpha_0_deg: quantities.TwistDeg
    s_1_mm: quantities.LengthMm


class HingePlacement(RigidPlacement):
    """Nominal placement of a hinge.

    ``theta_off_1_deg`` and ``theta_off_n_deg``: offsets of the first and last joint. They depend on the hinge, since
    x_0 and x_n are the common normals to the hinge axis. If a key is missing, the offset in the arm file applies.
    """

    a_n_mm: quantities.LengthMm
    s_n_mm: quantities.LengthMm
    alpha_n_deg: quantities.TwistDeg
    theta_off_1_deg: quantities.TurnDeg | None = None
    theta_off_n_deg: quantities.TurnDeg | None = None


class HingeModel(MetalFields):
    """A hinge."""

    makes = Hinge
    kind: Literal["hinge"]
    placement: HingePlacement


class RigidModel(MetalFields):
    """A rigid attachment of the tool to the ground."""

    makes = Rigid
    kind: Literal["rigid"]
    placement: RigidPlacement


class BallPlacement(Placement):
    """Nominal centres of the ball (in the last frame) and of the socket (in the base frame)."""

    tip_mm: PointMm
    ground_mm: PointMm


class DistanceModel(StrictModel):
    """Measured distance between the sockets of two placements, mm."""

    between: tuple[PlacementNumber, PlacementNumber]
    mm: Annotated[quantities.LengthMm, Field(gt=0.0)]
    sigma_mm: quantities.PositiveNumber

    @field_validator("between")
    @classmethod
    def _require_two_placements(cls, value: tuple[int, int]) -> tuple[int, int]:
        if value[0] == value[1]:
            raise quantities.refuse(f"names placement {value[0]} twice", "name two placements")
        return value


class BallModel(MetalFields):
    """A ball in a socket."""

    makes = Ball
    holds = ("position_mm",)
    kind: Literal["ball"]
    placement: BallPlacement
    stays_on_hand: quantities.Yes = True
    distance: tuple[DistanceModel, ...] = ()

    @field_validator("distance")
    @classmethod
    def _require_each_pair_once(cls, value: tuple[DistanceModel, ...]) -> tuple[DistanceModel, ...]:
        pairs = [tuple(sorted(d.between)) for d in value]
        for k, pair in enumerate(pairs):
            if pair in pairs[:k]:
                text = f"placements {pair[0]} and {pair[1]} have two distances"
                raise quantities.refuse(text, "keep one of them, or their mean")
        return value

    def own(self) -> dict[str, Any]:
        """Return keyword arguments of `Ball`: the compliance and the measured distances between sockets."""
        known = tuple(
            KnownDistance(between=d.between, value_m=d.mm / 1e3, sigma_m=d.sigma_mm / 1e3)
            for d in self.distance
        )
        return {**super().own(), "distances": known}


class MeasuredPlacement(Placement):
    """Nominal placement of the arm's base in the instrument's frame, and of the target on the tool."""

    base_mm: PointMm
    base_turn_deg: TurnVectorDeg
    tip_mm: PointMm
    tip_turn_deg: TurnVectorDeg = (0.0, 0.0, 0.0)


def _check_sigma(sigma_deg: float, fields: Fields) -> Iterator[Complaint]:
    if fields.get("measures") == "pose" and sigma_deg == 0.0:
        text = "an instrument that measures poses needs an angular standard deviation"
        yield ("instrument_sigma_deg",), text, "state it, or write `measures: position`"


class MeasuredModel(CommonFields):
    """An instrument that measures the endpoint."""

    makes = Measured
    kind: Literal["measured"]
    measures: Literal["pose", "position"]
    instrument_sigma_mm: quantities.PositiveNumber
    instrument_sigma_deg: Annotated[
        quantities.NonNegativeNumber, Field(validate_default=True), checked(_check_sigma)
    ] = 0.0
    placement: MeasuredPlacement
    base_known: quantities.Yes = False
    tip_known: quantities.Yes = False
    stays_on_hand: quantities.Yes = True

    def own(self) -> dict[str, Any]:
        """Return keyword arguments of `Measured`: sigmas, and flags for full poses, known base and known tip."""
        return {
            "sigma_m": self.instrument_sigma_mm / 1e3,
            "sigma_rad": math.radians(self.instrument_sigma_deg),
            "full_pose": self.measures == "pose",
            "base_known": self.base_known,
            "tip_known": self.tip_known,
        }


MODELS: dict[str, type[CommonFields]] = {
    model.makes.kind: model for model in (HingeModel, RigidModel, BallModel, MeasuredModel)
}
