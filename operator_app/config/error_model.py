"""What files state about what is not known exactly, and what is assumed where they do not.

The figures assumed are those that an ordinary shop reaches. All are one standard deviation, 0 is
exact: a plain ``tolerance: 0`` or ``give: 0`` stands for all figures of that mapping.
"""

from __future__ import annotations

import math
from collections.abc import Iterator, Mapping, Sequence
from typing import Any

from pydantic import ConfigDict, model_validator

from fixtures.base import Compliance
from operator_app.config.quantities import StatedDeg, StatedMm, StatedMrad
from operator_app.config.schema import StrictModel
from solver.chain.arm_model import RowTolerance

LENGTH_MM, TWIST_DEG = 0.5, 0.1
ACCURACY_DEG = BACKLASH_DEG = SAG_DEG = 0.01
GAIN = 0.005
"""Share of an RVDT's reading. Data sheets hold linearity against the best-fit line and state the scale
factor apart, trimmed to 1 % or better with its electronics: two standard deviations of this."""
GIVE_MM, GIVE_MRAD = 0.2, 0.2


class Uncertain(StrictModel):
    """Figures that are all 0 where the file has a plain 0 in their place."""

    # In JSON Schema bounds concern numbers only, keys mappings only.
    model_config = ConfigDict(
        json_schema_extra={"type": ["object", "number"], "minimum": 0, "maximum": 0}
    )

    @model_validator(mode="before")
    @classmethod
    def _exact(cls, data: Any) -> Any:
        zero = isinstance(data, int | float) and not isinstance(data, bool) and data == 0
        return dict.fromkeys(cls.model_fields, 0.0) if zero else data


class ToleranceModel(Uncertain):
    """How well the maker's table states lengths and twists."""

    length_mm: StatedMm = LENGTH_MM
    twist_deg: StatedDeg = TWIST_DEG


class RowToleranceModel(Uncertain):
    """The same of one row, where it differs."""

    length_mm: StatedMm | None = None
    twist_deg: StatedDeg | None = None

    def over(self, arm: ToleranceModel) -> RowTolerance:
        """Domain object; what is not stated here is as in the whole arm."""
        length = arm.length_mm if self.length_mm is None else self.length_mm
        twist = arm.twist_deg if self.twist_deg is None else self.twist_deg
        return RowTolerance(length_m=length / 1e3, twist_rad=math.radians(twist))


class GiveModel(Uncertain):
    """How far a fixture yields under load."""

    position_mm: StatedMm = GIVE_MM
    orientation_mrad: StatedMrad = GIVE_MRAD

    def compliance(self, held: Sequence[str]) -> Compliance:
        """Domain object of a fixture that holds ``position_mm`` or ``orientation_mrad`` or both."""
        missing = (key for key in held if key not in self.model_fields_set)
        return Compliance(
            position_m=self.position_mm / 1e3,
            orientation_rad=self.orientation_mrad / 1e3,
            assumed=tuple(f"give.{key}: {getattr(self, key):g}" for key in missing),
        )


def assumed_of_rows(arm: ToleranceModel, rows: Sequence[RowToleranceModel]) -> Iterator[str]:
    """Figures of the table that some row takes from nobody."""
    for key in ToleranceModel.model_fields:
        if key not in arm.model_fields_set and any(getattr(row, key) is None for row in rows):
            yield f"tolerance.{key}: {getattr(arm, key):g}"


def assumed_of_joints(key: str, models: Mapping[int, StrictModel]) -> Iterator[str]:
    """Say of which joints, by number, the figure `key` is not in the file."""
    silent = [j for j, model in models.items() if key not in model.model_fields_set]
    if silent:
        value = getattr(models[silent[0]], key)
        yield f"{key}: {value:g} (joint{'s' * (len(silent) > 1)} {', '.join(map(str, silent))})"
