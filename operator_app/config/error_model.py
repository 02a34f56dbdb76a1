"""Uncertainties and masses in files, and defaults for uncertainties that are not stated.

The defaults are what an ordinary workshop achieves. All are one standard deviation; 0 means exact. A plain 0 instead of
a mapping, such as ``give: 0``, sets all uncertainties of the mapping to 0.
"""

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Annotated, Any

import numpy as np
from pydantic import ConfigDict, Field, field_validator, model_validator

from fixtures.base import Compliance
from operator_app.config import quantities
from operator_app.config.schema import StrictModel
from solver.chain.statics import LinkMasses


class Uncertain(StrictModel):
    """Base of mappings of uncertainties; a plain 0 instead of the mapping sets all of them to 0."""

    # In JSON Schema, bounds apply to numbers only and keys to mappings only.
    model_config = ConfigDict(
        json_schema_extra={"type": ["object", "number"], "minimum": 0, "maximum": 0}
    )

    @model_validator(mode="before")
    @classmethod
    def _exact(cls, data: Any) -> Any:
        zero = isinstance(data, int | float) and not isinstance(data, bool) and data == 0
        return dict.fromkeys(cls.model_fields, 0.0) if zero else data


class ToleranceModel(Uncertain):
    """Uncertainty of the lengths (s, a) and twists (alpha, beta) in the D-H table of the arm's maker."""

    length_mm: quantities.StatedMm = 0.5
    twist_deg: quantities.StatedDeg = 0.1


class RowToleranceModel(Uncertain):
    """Uncertainty of the lengths and twists of a single row, if it differs from that of the whole table."""

    length_mm: quantities.StatedMm | None = None
    twist_deg: quantities.StatedDeg | None = None


class GiveModel(Uncertain):
    """Compliance of a fixture under load."""

    position_mm: quantities.StatedMm = 0.2
    orientation_mrad: quantities.StatedMrad = 0.2

    def compliance(self, held: Sequence[str]) -> Compliance:
        """Return the compliance. The fixture constrains `held`: ``position_mm``, ``orientation_mrad`` or both."""
        missing = (key for key in held if key not in self.model_fields_set)
        return Compliance(
            position_m=self.position_mm / 1e3,
            orientation_rad=self.orientation_mrad / 1e3,
            assumed=tuple(f"give.{key}: {getattr(self, key):g}" for key in missing),
        )


def assumed_of_rows(arm: ToleranceModel, rows: Sequence[RowToleranceModel]) -> Iterator[str]:
    """Yield, as text, each default uncertainty that applies to a row because the file states no value."""
    for key in ToleranceModel.model_fields:
        if key not in arm.model_fields_set and any(getattr(row, key) is None for row in rows):
            yield f"tolerance.{key}: {getattr(arm, key):g}"


def assumed_of_joints(key: str, models: Mapping[int, StrictModel]) -> Iterator[str]:
    """Yield a text with the default of `key` and the joints, of those in `models`, for which no `key` is stated."""
    if silent := [j for j, model in models.items() if key not in model.model_fields_set]:
        value = getattr(models[silent[0]], key)
        yield f"{key}: {value:g} (joint{'s' * (len(silent) > 1)} {', '.join(map(str, silent))})"


class LinkModel(StrictModel):
    """Mass and centre of mass of the parts that move with one joint.

    Without masses, deflections under load are modelled as an arbitrary smooth function of the pose.
    """

    link: Annotated[quantities.Count, Field(description="Number of its joint, from 1.")]
    mass_kg: Annotated[quantities.NonNegativeNumber, Field(le=10_000.0)]
    centre_m: Annotated[
        tuple[quantities.LengthM, quantities.LengthM, quantities.LengthM],
        Field(
            description="Centre of mass, from the origin of frame j-1 for link j, in axes that turn "
            "with the link: z along the axis of joint j, x along the D-H length a_j."
        ),
    ]
    mass_tolerance_percent: Annotated[
        quantities.NonNegativeNumber, Field(le=100.0, description="One standard deviation.")
    ] = 20.0
    centre_tolerance_mm: Annotated[
        quantities.StatedMm, Field(description="One standard deviation of each component.")
    ] = 15.0


class GravityModel(StrictModel):
    """Direction of gravity in the arm's base (frame 0)."""

    down: Annotated[
        tuple[quantities.Number, quantities.Number, quantities.Number],
        Field(description="Any length: [-1, 0, 0] is along -x."),
    ]
    tolerance_deg: quantities.StatedDeg = 3.0

    @field_validator("down")
    @classmethod
    def _require_direction(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not math.hypot(*value) > 0.0:
            raise quantities.refuse("has no direction", "write for example [0, 0, -1]")
        return value

    @property
    def direction(self) -> tuple[float, float, float]:
        """Unit vector along gravity."""
        largest = max(map(abs, self.down))  # so that `hypot` neither overflows nor underflows
        x, y, z = (component / largest for component in self.down)
        length = math.hypot(x, y, z)
        return x / length, y / length, z / length


def link_masses(links: Sequence[LinkModel], gravity: GravityModel) -> LinkMasses:
    """Return the masses as a domain object."""
    mass = np.array([link.mass_kg for link in links])
    return LinkMasses(
        mass_kg=mass,
        centre_m=np.array([link.centre_m for link in links], dtype=np.float64),
        mass_sd_kg=mass * np.array([link.mass_tolerance_percent for link in links]) / 100.0,
        centre_sd_m=np.array([link.centre_tolerance_mm for link in links]) / 1e3,
        down=np.array(gravity.direction),
        down_sd_rad=math.radians(gravity.tolerance_deg),
    )
