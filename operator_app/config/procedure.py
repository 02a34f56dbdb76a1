"""A procedure (``sarcal/procedure/1``): the settings of ``sarcal run``.

`ProcedureFile` is the content of the file; some properties convert values to SI units. The module `procedure_file`
checks this content against the arm. `Procedure` has the settings, the arm, the fixture and the operator's choices.
"""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import TYPE_CHECKING, Annotated, Literal

from pydantic import Field, ValidationInfo, field_validator

from operator_app.config import quantities
from operator_app.config.schema import StrictRecord
from operator_app.units import MOST_WHOLE
from solver.chain.sensors import NoSensor

if TYPE_CHECKING:
    from hardware.canopen.bus_profile import BusProfile
    from operator_app.config.fixture_file import FixtureSpec
    from operator_app.config.resources import Resource
    from solver.chain.arm_model import ArmModel

MOST_POSES = 100_000
MOST_PLACEMENTS = 20
DEFAULT_PROFILE = "sarcos"


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceLimits(StrictRecord):
    """Limits that a calibration must meet to be accepted, besides the tests that always apply; None means no limit.

    `sigma_pos_mm`, `sigma_ori_mrad`: limits of the rms closure error in position and orientation (eqs. 14 and 15).
    A condition number above `scaled_condition_number` causes only a warning.
    """

    scaled_condition_number: Annotated[quantities.PositiveNumber, Field(ge=1.0)] = 100.0
    chi2_per_dof: quantities.PositiveNumber | None = None
    sigma_pos_mm: quantities.PositiveNumber | None = None
    sigma_ori_mrad: quantities.PositiveNumber | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcedureBus(StrictRecord):
    """The bus: `interface`, `channel` and `bitrate` as in python-can, whose configuration applies to missing values.

    `sdo_timeout_s`: time-out of an SDO access. `profile`: built-in name or path of the bus profile.
    """

    interface: quantities.Text
    channel: quantities.Text | None = None
    bitrate: Annotated[int, Field(strict=True, ge=10_000, le=8_000_000)] | None = None
    sdo_timeout_s: Annotated[quantities.PositiveNumber, Field(ge=0.05, le=60.0)] | None = None
    profile: quantities.Text = DEFAULT_PROFILE


@dataclass(frozen=True, slots=True, kw_only=True)
class Modes(StrictRecord):
    """Drive joints: numbers from 1, or ``auto`` if the program chooses. `trial`: whether it uses trial motions."""

    position: Literal["auto"] | Annotated[tuple[quantities.Count, ...], Field(min_length=1)]
    trial: quantities.Yes = False

    @property
    def listed(self) -> tuple[int, ...]:
        """Drive joints listed in the file; empty if the program chooses them."""
        return () if self.position == "auto" else self.position


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration(StrictRecord):
    """Exploration range of a drive joint, relative to its angle at home."""

    joint: quantities.Count
    from_deg: Annotated[quantities.AngleDeg, Field(le=0.0)]
    to_deg: Annotated[quantities.AngleDeg, Field(ge=0.0)]

    @property
    def lower_rad(self) -> float:
        """Lower end of the range, rad; at most 0."""
        return math.radians(self.from_deg)

    @property
    def upper_rad(self) -> float:
        """Upper end of the range, rad; at least 0."""
        return math.radians(self.to_deg)

    @field_validator("to_deg")
    @classmethod
    def _require_width(cls, value: float, info: ValidationInfo) -> float:
        low = info.data.get("from_deg")
        if low is not None and value - low < 1.0:
            text = f"the exploration range is {value - low:g} deg wide"
            raise quantities.refuse(text, "make it at least 1 deg wide")
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class SettleRule(StrictRecord):
    """Criterion for standstill: the spread of every joint's readings over `window_syncs` SYNCs is below a limit.

    The limit is `spread_sigmas` standard deviations of the joint's sensor, but at least `spread_min_deg`. If the arm
    does not stand still within `timeout_syncs` SYNCs, the pose is skipped.
    """

    window_syncs: Annotated[int, Field(strict=True, ge=2, le=10_000)]
    spread_sigmas: quantities.PositiveNumber
    spread_min_deg: quantities.NonNegativeNumber = 0.0
    timeout_syncs: Annotated[int, Field(strict=True, ge=2, le=1_000_000)]

    def spread_rad(self, arm: ArmModel) -> tuple[float, ...]:
        """Allowed spread of each joint's readings, rad; infinite for a joint without a sensor."""
        return tuple(
            math.inf
            if isinstance(joint.sensor, NoSensor)
            else max(math.radians(self.spread_min_deg), self.spread_sigmas * joint.sensor.sigma_rad)
            for joint in arm.joints
        )

    @field_validator("timeout_syncs")
    @classmethod
    def _longer_than_window(cls, value: int, info: ValidationInfo) -> int:
        window = info.data.get("window_syncs")
        if window is not None and value < window:
            text = f"{value} SYNCs are fewer than the window of {window}"
            raise quantities.refuse(text, "increase this time-out")
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturePlan(StrictRecord):
    """Number, strategy and sampling of poses.

    Attributes
    ----------
    strategy
        The key ``plan`` of the file. ``explore``: capture poses at waypoints inside the ranges `exploration`.
        ``planned``: explore until an estimate is good enough for planning, then capture planned poses.
    poses
        Number of poses; with ``planned``, those of the exploration are not counted.
    exploration
        Range of each drive joint; empty if the program chooses the drive joints.
    speed_deg_per_s
        Speed at which the drive joints are commanded to move.
    samples_per_pose
        Readings averaged into one pose, one per SYNC.
    seed
        Seed of the sequence of poses.
    requested_sigma
        Combined standard uncertainties at which a planned capture may end early, by parameter name with unit.
    """

    strategy: Annotated[Literal["explore", "planned"], Field(alias="plan")] = "explore"
    poses: Annotated[quantities.Count, Field(le=MOST_POSES)]
    exploration: tuple[Exploration, ...] = ()
    speed_deg_per_s: Annotated[quantities.PositiveNumber, Field(ge=0.05, le=360.0)]
    settle: SettleRule
    samples_per_pose: Annotated[quantities.Count, Field(le=100_000)]
    seed: Annotated[quantities.Whole, Field(le=MOST_WHOLE)] = 0
    requested_sigma: dict[str, quantities.PositiveNumber] = field(default_factory=dict)

    @property
    def speed_rad_per_s(self) -> float:
        """Speed at which the drive joints are commanded to move, rad/s."""
        return math.radians(self.speed_deg_per_s)

    @property
    def requested(self) -> Mapping[str, float]:
        """Requested standard deviations by parameter name, rad and m."""
        return {
            key.rpartition("_")[0]: v for key, v in quantities.in_si(self.requested_sigma).items()
        }


@dataclass(frozen=True, slots=True, kw_only=True)
class ExportChoice(StrictRecord):
    """Use of the result; `upload`: whether the parameters are uploaded to the controller."""

    upload: quantities.Yes


@dataclass(frozen=True, slots=True, kw_only=True)
class ProcedureFile(StrictRecord):
    """Content of a procedure file, without the key ``schema``.

    `arm`, `fixture`: built-in names or paths. `home_deg` replaces the arm's home, for example if the loop does not
    close there. `held`: entries that are free in the arm file but fixed in this procedure, each with the reason.
    `tracker`: source of an instrument's measurements, as in ``--tracker``.
    """

    name: quantities.Name
    arm: quantities.Text
    fixture: quantities.Text
    bus: ProcedureBus
    modes: Literal["auto"] | Modes
    unsensed_joints: tuple[quantities.Count, ...] = ()
    home_deg: tuple[quantities.AngleDeg, ...] | None = None
    held: dict[str, quantities.Text] = field(default_factory=dict)
    capture: CapturePlan
    estimator: Literal["paper", "implicit"]
    acceptance: AcceptanceLimits
    export: ExportChoice
    tracker: quantities.Text | None = None

    @property
    def chosen_modes(self) -> Modes:
        """The key ``modes`` as `Modes`, also if the file has the word ``auto`` instead of a mapping."""
        return Modes(position="auto") if self.modes == "auto" else self.modes


@dataclass(frozen=True, slots=True, kw_only=True)
class Procedure:
    """A procedure with its arm, fixture and bus profile; for the other fields of its file, see `ProcedureFile`.

    Attributes
    ----------
    arm, fixture
        As in their files, except that the arm has this procedure's home, and that the entries in `held` are fixed.
    sources
        The files of procedure, arm, fixture and profile. The session keeps copies of them.
    position_joints
        Joints (1-based) in position mode; None: chosen automatically.
    trial
        Whether the automatic choice of these joints also uses small trial motions of the arm.
    length_tolerance_m
        Standard deviation of the maker's link lengths; None: as the arm file states.
    placements
        Number of placements of the fixture; the poses are captured in each.
    """

    name: str
    arm: ArmModel
    fixture: FixtureSpec
    profile: BusProfile
    sources: tuple[Resource, Resource, Resource, Resource]
    bus: ProcedureBus
    position_joints: tuple[int, ...] | None
    unsensed_joints: tuple[int, ...]
    capture: CapturePlan
    estimator: Literal["paper", "implicit"]
    acceptance: AcceptanceLimits
    upload: bool
    length_tolerance_m: float | None = None
    trial: bool = False
    held: Mapping[str, str] = field(default_factory=dict)
    tracker: str | None = None
    placements: int = 1
