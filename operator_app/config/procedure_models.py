"""What a procedure file holds, key by key. Knows no arm: what fits the arm is checked elsewhere."""

from __future__ import annotations

from typing import Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from operator_app.config.quantities import (
    AngleDeg,
    Count,
    Name,
    NonNegativeNumber,
    PositiveNumber,
    Text,
    Whole,
    Yes,
    refuse,
)
from operator_app.config.schema import StrictModel


class BusModel(StrictModel):
    """Bus settings."""

    interface: Text
    channel: Text | None = None
    bitrate: Annotated[int, Field(strict=True, ge=10_000, le=8_000_000)] | None = None


class ModesModel(StrictModel):
    """Drive joints, by number or chosen by the program; `trial`: by small wiggles on the arm, too."""

    position: Literal["auto"] | Annotated[tuple[Count, ...], Field(min_length=1)]
    trial: Yes = False

    @property
    def listed(self) -> tuple[int, ...]:
        """The joints that are named; none when the program chooses."""
        return () if self.position == "auto" else self.position


class ExplorationModel(StrictModel):
    """Travel of one drive joint, relative to where it starts (checked from the arm's home)."""

    joint: Count
    from_deg: Annotated[AngleDeg, Field(le=0.0)]
    to_deg: Annotated[AngleDeg, Field(ge=0.0)]

    @field_validator("to_deg")
    @classmethod
    def _some_travel(cls, value: float, info: ValidationInfo) -> float:
        low = info.data.get("from_deg")
        if low is not None and value - low < 1.0:
            raise refuse(f"the joint would travel {value - low:g} deg", "give it more than 1 deg")
        return value


class SettleModel(StrictModel):
    """Settle rule."""

    window_syncs: Annotated[int, Field(strict=True, ge=2, le=10_000)]
    spread_sigmas: PositiveNumber
    spread_min_deg: NonNegativeNumber = 0.0
    timeout_syncs: Annotated[int, Field(strict=True, ge=2, le=1_000_000)]

    @field_validator("timeout_syncs")
    @classmethod
    def _longer_than_window(cls, value: int, info: ValidationInfo) -> int:
        window = info.data.get("window_syncs")
        if window is not None and value < window:
            raise refuse(f"{value} SYNCs are over before the window of {window}", "allow more")
        return value


class CaptureModel(StrictModel):
    """Capture plan."""

    plan: Literal["explore", "planned"] = "explore"
    poses: Annotated[Count, Field(le=100_000)]
    exploration: tuple[ExplorationModel, ...] = ()
    speed_deg_per_s: Annotated[PositiveNumber, Field(le=360.0)]
    settle: SettleModel
    samples_per_pose: Annotated[Count, Field(le=100_000)]
    seed: Annotated[Whole, Field(le=2**63 - 1)] = 0
    requested_sigma: dict[str, PositiveNumber] = Field(default_factory=dict)


class AcceptanceModel(StrictModel):
    """Acceptance limits."""

    scaled_condition_number: Annotated[PositiveNumber, Field(ge=1.0)] = 100.0
    chi2_per_dof: PositiveNumber | None = None
    sigma_pos_mm: PositiveNumber | None = None
    sigma_ori_mrad: PositiveNumber | None = None


class ExportModel(StrictModel):
    """What happens with the result."""

    upload: Yes


class ProcedureFile(StrictModel):
    """The whole file, without its ``schema`` line."""

    name: Name
    arm: Text
    fixture: Text
    bus: BusModel
    modes: Literal["auto"] | ModesModel
    unsensed_joints: tuple[Count, ...] = ()
    capture: CaptureModel
    estimator: Literal["paper", "implicit"]
    acceptance: AcceptanceModel
    export: ExportModel
