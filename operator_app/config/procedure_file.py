"""The procedure file (``sarcal/procedure/1``): what ``sarcal run`` does. Knows no bus and no session."""

from __future__ import annotations

import math
from collections.abc import Callable, Iterator, Mapping
from pathlib import Path
from typing import Annotated, Literal, TypeVar

from pydantic import Field, ValidationInfo, field_validator

from operator_app.config.arm_file import parse_arm
from operator_app.config.errors import ConfigError, Problem
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.procedure import (
    BusSettings,
    CapturePlan,
    Exploration,
    Procedure,
    SettleRule,
)
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
from operator_app.config.resources import Kind, Resource, resolve
from operator_app.config.schema import StrictModel, check_model
from operator_app.config.strict_yaml import load_strict
from operator_app.config.yaml_document import Path as KeyPath
from operator_app.config.yaml_document import YamlDocument
from operator_app.judgement import AcceptanceLimits
from solver.arm_model import ArmModel

T = TypeVar("T")


class BusModel(StrictModel):
    """Bus settings."""

    interface: Text
    channel: Text | None = None
    bitrate: Annotated[int, Field(strict=True, ge=10_000, le=8_000_000)] | None = None


class ModesModel(StrictModel):
    """Drive joints, by number."""

    position: Annotated[tuple[Count, ...], Field(min_length=1)]


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

    poses: Annotated[Count, Field(le=100_000)]
    exploration: tuple[ExplorationModel, ...] = ()
    speed_deg_per_s: Annotated[PositiveNumber, Field(le=360.0)]
    settle: SettleModel
    samples_per_pose: Annotated[Count, Field(le=100_000)]
    seed: Annotated[Whole, Field(le=2**63 - 1)] = 0


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


def parse_procedure(
    source: Resource, *, snapshot: Mapping[Kind, Resource] | None = None
) -> Procedure:
    """Read a procedure and the arm and fixture it names.

    Names are built-in names or paths; relative paths start from the procedure's own folder. With a
    `snapshot` the arm and fixture in it are taken instead, whatever the procedure names.

    Raises
    ------
    ConfigError
        With all that is wrong in any of the three files.
    """
    document = load_strict(source.data, source.file)
    found = check_model(ProcedureFile, document, kind="procedure")
    problems: list[Problem] = []
    known = snapshot or {}
    arm = _referred("arm", document, source, known, parse=parse_arm, problems=problems)
    fixture = _referred("fixture", document, source, known, parse=parse_fixture, problems=problems)
    problems += _check_joints(found, None if arm is None else arm[1], document)
    if problems or arm is None or fixture is None:
        raise ConfigError(problems)
    capture, accept = found.capture, found.acceptance
    return Procedure(
        name=found.name,
        arm=arm[1],
        fixture=fixture[1],
        sources=(source, arm[0], fixture[0]),
        bus=BusSettings(
            interface=found.bus.interface, channel=found.bus.channel, bitrate=found.bus.bitrate
        ),
        position_joints=None if found.modes == "auto" else found.modes.position,
        unsensed_joints=found.unsensed_joints,
        capture=CapturePlan(
            poses=capture.poses,
            exploration=tuple(
                Exploration(
                    joint=item.joint,
                    lower_rad=math.radians(item.from_deg),
                    upper_rad=math.radians(item.to_deg),
                )
                for item in capture.exploration
            ),
            speed_rad_per_s=math.radians(capture.speed_deg_per_s),
            settle=SettleRule(
                window_syncs=capture.settle.window_syncs,
                spread_sigmas=capture.settle.spread_sigmas,
                spread_min_rad=math.radians(capture.settle.spread_min_deg),
                timeout_syncs=capture.settle.timeout_syncs,
            ),
            samples_per_pose=capture.samples_per_pose,
            seed=capture.seed,
        ),
        estimator=found.estimator,
        acceptance=AcceptanceLimits(
            scaled_condition_number=accept.scaled_condition_number,
            chi2_per_dof=accept.chi2_per_dof,
            sigma_pos_m=None if accept.sigma_pos_mm is None else accept.sigma_pos_mm / 1e3,
            sigma_ori_rad=None if accept.sigma_ori_mrad is None else accept.sigma_ori_mrad / 1e3,
        ),
        upload=found.export.upload,
    )


def load_procedure(reference: str | Path) -> Procedure:
    """Read a procedure by built-in name or path; raises as `parse_procedure`."""
    return parse_procedure(resolve("procedure", reference))


def _referred(
    kind: Kind,
    document: YamlDocument,
    source: Resource,
    known: Mapping[Kind, Resource],
    *,
    parse: Callable[[bytes, str], T],
    problems: list[Problem],
) -> tuple[Resource, T] | None:
    """File that the procedure names under the key `kind`; what is wrong with it goes to `problems`."""
    try:
        found = known.get(kind) or resolve(kind, str(document.data[kind]), folder=source.folder)
    except ConfigError as error:
        # The reference is what is wrong: say where it stands.
        problems += (
            document.problem((kind,), f"{p.file} {p.text}", p.remedy) for p in error.problems
        )
        return None
    try:
        return found, parse(found.data, found.file)
    except ConfigError as error:
        problems += error.problems
        return None


def _check_joints(
    found: ProcedureFile, arm: ArmModel | None, document: YamlDocument
) -> Iterator[Problem]:
    """Joint numbers that contradict each other or, where it is known, the arm."""
    drives = found.modes.position if isinstance(found.modes, ModesModel) else ()
    lists: tuple[tuple[KeyPath, tuple[int, ...]], ...] = (
        (("modes", "position"), drives),
        (("unsensed_joints",), found.unsensed_joints),
    )
    for path, joints in lists:
        for k, joint in enumerate(joints):
            if arm is not None and joint > arm.joint_count:
                text, remedy = f"there is no joint {joint}", f"joints are 1 to {arm.joint_count}"
                yield document.problem((*path, k), text, remedy)
            elif joint in joints[:k]:
                text = f"joint {joint} is listed twice"
                yield document.problem((*path, k), text, "list each joint once")
    for k, joint in enumerate(drives):
        if joint in found.unsensed_joints:
            yield document.problem(
                ("modes", "position", k),
                f"joint {joint} is in position mode and unsensed",
                "a joint whose reading is not used cannot be driven to a position",
            )
    yield from _check_exploration(found, drives, arm, document)
    if arm is not None:
        yield from _check_limits(found, arm, document)


def _check_exploration(
    found: ProcedureFile, drives: tuple[int, ...], arm: ArmModel | None, document: YamlDocument
) -> Iterator[Problem]:
    """Each drive joint that exists has one travel, and no other joint has any."""
    here: KeyPath = ("capture", "exploration")
    named = [item.joint for item in found.capture.exploration]
    for k, joint in enumerate(named):
        if joint in named[:k]:
            text = f"joint {joint} is listed twice"
            yield document.problem((*here, k, "joint"), text, "keep one of them")
        elif joint not in drives:
            text = f"joint {joint} is not in position mode"
            yield document.problem((*here, k, "joint"), text, "explore with the drive joints only")
    for joint in sorted(set(drives) - set(named)):
        if arm is None or joint <= arm.joint_count:
            remedy = f"add {{joint: {joint}, from_deg: ..., to_deg: ...}}"
            yield document.problem(here, f"joint {joint} has no travel", remedy)


def _check_limits(found: ProcedureFile, arm: ArmModel, document: YamlDocument) -> Iterator[Problem]:
    """Travels from home stay inside the ranges; no drive joint is faster than it may be."""
    boxes = [
        (k, item)
        for k, item in enumerate(found.capture.exploration)
        if item.joint <= arm.joint_count
    ]
    for k, item in boxes:
        joint, home = arm.joints[item.joint - 1], math.degrees(arm.home_rad[item.joint - 1])
        low, high = math.degrees(joint.lower_rad), math.degrees(joint.upper_rad)
        for key, travel in (("from_deg", item.from_deg), ("to_deg", item.to_deg)):
            if not low - 1e-9 <= home + travel <= high + 1e-9:
                yield document.problem(
                    ("capture", "exploration", k, key),
                    f"takes joint {item.joint} from home {home:.6g} to {home + travel:.6g} deg, "
                    f"outside its range {low:.6g} to {high:.6g} deg",
                    "shorten the travel",
                )
    slowest = min(
        boxes, key=lambda box: arm.joints[box[1].joint - 1].max_speed_rad_per_s, default=None
    )
    if slowest is not None:
        number = slowest[1].joint
        limit = math.degrees(arm.joints[number - 1].max_speed_rad_per_s)
        if found.capture.speed_deg_per_s > limit * (1.0 + 1e-9):
            text = f"is more than joint {number} may do ({limit:.6g} deg/s)"
            yield document.problem(("capture", "speed_deg_per_s"), text, "slow down")
