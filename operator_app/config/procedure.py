"""A procedure as the workflow sees it: arm, fixture, bus, capture plan, limits. Knows no file format."""

from __future__ import annotations

import math
from collections.abc import Mapping
from dataclasses import dataclass, field
from typing import Literal

from operator_app.config.fixture_file import FixtureSpec
from operator_app.config.resources import Resource
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import NoSensor


@dataclass(frozen=True, slots=True, kw_only=True)
class AcceptanceLimits:
    """What a calibration must reach to be accepted; None is no limit.

    The sigmas are the ``rms`` reading of eqs. 14 and 15. Without a limit of its own, chi2/dof must
    lie below the upper end of its 99.9 % band.
    """

    scaled_condition_number: float = 100.0
    chi2_per_dof: float | None = None
    sigma_pos_m: float | None = None
    sigma_ori_rad: float | None = None


@dataclass(frozen=True, slots=True, kw_only=True)
class BusSettings:
    """Which bus, in python-can's words; None leaves it to python-can's own configuration."""

    interface: str
    channel: str | None
    bitrate: int | None


@dataclass(frozen=True, slots=True, kw_only=True)
class Exploration:
    """How far one drive joint is taken from where it starts: `lower_rad` <= 0 <= `upper_rad`."""

    joint: int
    lower_rad: float
    upper_rad: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SettleRule:
    """When the arm counts as still: every joint's spread over `window_syncs` SYNCs is small.

    Small is `spread_sigmas` standard deviations of the joint's sensor, but never less than
    `spread_min_rad`; after `timeout_syncs` the pose is given up.
    """

    window_syncs: int
    spread_sigmas: float
    spread_min_rad: float
    timeout_syncs: int

    def spread_rad(self, arm: ArmModel) -> tuple[float, ...]:
        """Allowed spread of every joint of `arm`; infinite for a joint without a sensor."""
        return tuple(
            math.inf
            if isinstance(joint.sensor, NoSensor)
            else max(self.spread_min_rad, self.spread_sigmas * joint.sensor.sigma_rad)
            for joint in arm.joints
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturePlan:
    """Which poses are taken, and how.

    Attributes
    ----------
    poses
        How many.
    exploration
        The box the drive joints are taken through; empty when the modes are chosen automatically.
    speed_rad_per_s
        Command speed of the drive joints.
    samples_per_pose
        SYNC samples averaged into one pose.
    seed
        Of the sequence of poses.
    strategy
        ``explore``: visit the box as it comes; ``planned``: explore a little, then plan on what was
        found and take `poses` chosen poses more.
    requested
        With a plan: standard deviations by parameter name (rad, m) at which it may end sooner.
    """

    poses: int
    exploration: tuple[Exploration, ...]
    speed_rad_per_s: float
    settle: SettleRule
    samples_per_pose: int
    seed: int
    strategy: Literal["explore", "planned"] = "explore"
    requested: Mapping[str, float] = field(default_factory=dict)


@dataclass(frozen=True, slots=True, kw_only=True)
class Procedure:
    """A procedure with the arm and the fixture it names.

    Attributes
    ----------
    name
        What the operator calls it.
    arm, fixture
        As read from their files.
    sources
        The three files as found (procedure, arm, fixture), for the session's snapshot.
    position_joints
        Joints (1-based) in position mode; None: chosen automatically.
    trial
        Whether that choice also asks the arm, by small wiggles.
    unsensed_joints
        Joints whose readings are not used.
    estimator
        ``paper`` or ``implicit``.
    upload
        Whether the parameters go to the controller.
    length_tolerance_m
        How well the maker's link lengths are known (standard deviation); None: exact.
    """

    name: str
    arm: ArmModel
    fixture: FixtureSpec
    sources: tuple[Resource, Resource, Resource]
    bus: BusSettings
    position_joints: tuple[int, ...] | None
    unsensed_joints: tuple[int, ...]
    capture: CapturePlan
    estimator: Literal["paper", "implicit"]
    acceptance: AcceptanceLimits
    upload: bool
    length_tolerance_m: float | None = None
    trial: bool = False
