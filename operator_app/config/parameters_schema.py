"""The schema of a parameters document, and the checks between its parts. Knows no reading or writing."""

from __future__ import annotations

import re
from datetime import datetime
from typing import Annotated, Literal

from pydantic import Field, StringConstraints, ValidationInfo, field_validator

from operator_app.config.quantities import (
    Count,
    ExactText,
    LengthM,
    NonNegativeNumber,
    Number,
    TurnDeg,
    Whole,
    refuse,
)
from operator_app.config.schema import StrictModel, report
from solver.chain.parameters import DhEntry

Int32 = Annotated[int, Field(strict=True, ge=-(2**31), le=2**31 - 1)]
Code = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Sha256 = Annotated[str, StringConstraints(strict=True, pattern=r"^[0-9a-f]{64}$")]
UTC_FORM = re.compile(r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{6})?Z")


class ArmPart(StrictModel):
    """Which arm."""

    model: ExactText
    serial: ExactText


class JointPart(StrictModel):
    """One joint."""

    joint: Count
    theta_off_deg: TurnDeg
    sigma_deg: NonNegativeNumber | None
    home_offset_counts: Int32 | None


class RowPart(StrictModel):
    """One D-H row."""

    row: Whole
    theta_off_deg: TurnDeg
    s_m: LengthM
    a_m: LengthM
    alpha_deg: TurnDeg


class CalibratedPart(StrictModel):
    """One calibrated entry: angles have a sigma in degrees, lengths in metres."""

    entry: ExactText
    sigma_deg: NonNegativeNumber | None = None
    sigma_m: NonNegativeNumber | None = None

    @field_validator("entry")
    @classmethod
    def _is_entry(cls, value: str) -> str:
        try:
            entry = DhEntry.parse(value)
        except ValueError as error:
            raise refuse(str(error), "write for example theta_off_1") from error
        if entry.name != value:
            raise refuse(f"{value} has a leading zero", f"write {entry.name}")
        return value


class FixturePart(StrictModel):
    """Which fixture."""

    name: ExactText
    kind: ExactText


class FiguresPart(StrictModel):
    """Both readings of a sigma."""

    rms: NonNegativeNumber
    as_printed: NonNegativeNumber


class QualityPart(StrictModel):
    """Quality figures."""

    poses: Count
    rank: Whole
    scaled_condition_number: Annotated[Number, Field(ge=1.0)]
    sigma_pos_mm: FiguresPart
    sigma_ori_mrad: FiguresPart
    chi2_per_dof: NonNegativeNumber | None


class WarningPart(StrictModel):
    """One warning."""

    code: Code
    text: ExactText


class ParametersFile(StrictModel):
    """The whole file, without its ``schema`` line."""

    arm: ArmPart
    utc: ExactText
    software_version: ExactText
    estimator: Literal["paper", "implicit"]
    fixture: FixturePart
    joints: Annotated[tuple[JointPart, ...], Field(min_length=1, max_length=32)]
    dh: tuple[RowPart, ...]
    calibrated: tuple[CalibratedPart, ...]
    quality: QualityPart
    warnings: tuple[WarningPart, ...]
    pose_set_sha256: Sha256

    @field_validator("utc")
    @classmethod
    def _is_utc(cls, value: str) -> str:
        if UTC_FORM.fullmatch(value):
            try:
                datetime.fromisoformat(value)
            except ValueError:
                pass
            else:
                return value
        raise refuse(f"{value[:40]!r} is no UTC time", "write for example 2026-01-31T12:00:00Z")

    @field_validator("joints")
    @classmethod
    def _joints_in_order(
        cls, value: tuple[JointPart, ...], info: ValidationInfo
    ) -> tuple[JointPart, ...]:
        for k, part in enumerate(value):
            if part.joint != k + 1:
                report(
                    info,
                    ("joints", k, "joint"),
                    f"joint {part.joint} stands where joint {k + 1} belongs",
                    "list joints 1 to n in order, each once",
                )
        return value

    @field_validator("dh")
    @classmethod
    def _table_fits(cls, value: tuple[RowPart, ...], info: ValidationInfo) -> tuple[RowPart, ...]:
        for k, part in enumerate(value):
            if part.row != k:
                report(
                    info,
                    ("dh", k, "row"),
                    f"row {part.row} stands where row {k} belongs",
                    "list rows 0 to n in order, each once",
                )
        joints = info.data.get("joints")
        if joints is None:
            return value
        if len(value) != len(joints) + 1:
            report(
                info,
                ("dh",),
                f"has {len(value)} rows for {len(joints)} joints",
                "write rows 0 to n",
            )
            return value
        for k, (row, joint) in enumerate(zip(value[1:], joints, strict=True), 1):
            if row.theta_off_deg != joint.theta_off_deg:
                report(
                    info,
                    ("dh", k, "theta_off_deg"),
                    f"{row.theta_off_deg!r} is not the {joint.theta_off_deg!r} of joint {k} above",
                    "the document was changed in one place only",
                )
        return value

    @field_validator("calibrated")
    @classmethod
    def _calibrated_fits(
        cls, value: tuple[CalibratedPart, ...], info: ValidationInfo
    ) -> tuple[CalibratedPart, ...]:
        joints = info.data.get("joints")
        names = [part.entry for part in value]
        for k, part in enumerate(value):
            for text, remedy in _entry_complaints(part, names[:k], joints):
                report(info, ("calibrated", k), text, remedy)
        for k, joint in enumerate(joints or ()):
            if joint.sigma_deg is not None and f"theta_off_{joint.joint}" not in names:
                report(
                    info,
                    ("joints", k, "sigma_deg"),
                    f"theta_off_{joint.joint} is not listed as calibrated",
                    "an entry that was not calibrated has no sigma: write null",
                )
        return value

    @field_validator("quality")
    @classmethod
    def _rank_fits(cls, value: QualityPart, info: ValidationInfo) -> QualityPart:
        calibrated = info.data.get("calibrated")
        if calibrated is not None and value.rank > len(calibrated):
            report(
                info,
                ("quality", "rank"),
                f"rank {value.rank} for {len(calibrated)} calibrated entries",
                "the document was changed in one place only",
            )
        return value


def _entry_complaints(
    part: CalibratedPart, before: list[str], joints: tuple[JointPart, ...] | None
) -> list[tuple[str, str]]:
    entry = DhEntry.parse(part.entry)
    if part.entry in before:
        return [("is listed twice", "keep one of them")]
    key, other = ("sigma_deg", "sigma_m") if entry.kind.is_angle else ("sigma_m", "sigma_deg")
    if getattr(part, key) is None or getattr(part, other) is not None:
        return [(f"has no {key} or has a {other}", f"write {key} and nothing else")]
    if joints is None:
        return []
    if entry.row > len(joints):
        return [(f"there is no row {entry.row}", f"the arm has rows 0 to {len(joints)}")]
    if entry.name.startswith("theta_off_") and entry.row > 0:
        stated = joints[entry.row - 1].sigma_deg
        if stated != part.sigma_deg:
            shown = "null" if stated is None else repr(stated)
            return [
                (
                    f"{part.sigma_deg!r} is not the {shown} of joint {entry.row} above",
                    "the document was changed in one place only",
                )
            ]
    return []
