"""The parameters document of a calibration (``sarcal/parameters/3``), for the controller.

The document has the content and the units of the file (degrees, metres, millimetres, milliradians), so that writing and
reading it changes no bit; `ParametersDocument.table` is in SI units. The document is checked when written or read.

Version 1 had no `side`, `rvdt` and `forced`. The first documents of version 2 had no `correlations` and `budget`, and
programs of that time refuse these keys. Any further key needs a new version number, because old programs report an
unknown version more clearly than an unknown key. Version 3 adds ``beta_deg`` to rows; a document without ``beta_deg``
is written as version 2.
"""

from __future__ import annotations

import re
from collections.abc import Iterator
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    StringConstraints,
    ValidationInfo,
    WithJsonSchema,
    field_validator,
)

from operator_app.config.parameter_records import (
    Budget,
    CalibratedEntry,
    Correlations,
    DhRow,
    DocumentWarning,
    JointParameters,
    Quality,
    RvdtRemedy,
    WhichArm,
    WhichFixture,
    complaints_of_budget,
    complaints_of_correlations,
)
from operator_app.config.quantities import ExactText, refuse
from operator_app.config.schema import StrictRecord, check_numbered, report
from solver.arrays import FloatArray, frozen
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry

CHANGED_IN_ONE_PLACE = "the document was changed in one place only: make the two values agree"
UTC_FORM = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{6})?Z"


def _time_from_text(value: Any) -> datetime:
    if isinstance(value, str) and re.fullmatch(UTC_FORM, value):
        try:
            return datetime.fromisoformat(value).astimezone(UTC)
        except (ValueError, OverflowError):
            pass
    shown = repr(value)[:42]
    raise refuse(f"{shown} is not a UTC time", "write for example 2026-01-31T12:00:00Z")


def _time_in_text(value: datetime) -> str:
    return value.astimezone(UTC).replace(tzinfo=None).isoformat() + "Z"


Sha256 = Annotated[str, StringConstraints(strict=True, pattern=r"^[0-9a-f]{64}$")]
UtcTime = Annotated[
    datetime,
    BeforeValidator(_time_from_text),
    PlainSerializer(_time_in_text),
    WithJsonSchema({"type": "string", "pattern": f"^{UTC_FORM}$"}),
]


BESIDE_THE_TABLE = {"ball": 6, "measured": 12}
"""Number of parameters outside the D-H table: points of ball and socket, or poses of instrument and target."""


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametersDocument(StrictRecord):
    """Parameters of one arm from one calibration.

    Attributes
    ----------
    software_version, utc
        Version of the program, and time of writing (UTC, with time zone).
    joints, dh, calibrated
        Offsets, the whole D-H table (rows 0..n), and its calibrated entries. Row 0 describes a hinge or a rigid
        fixture; for other fixtures it is zero.
    pose_set_sha256
        `solver.chain.poses.PoseSet.sha256` of the poses.
    correlations
        Correlations of each calibrated entry except the first with all entries before it, in their order. Together
        with the sigmas they define the whole covariance.
    budget
        Share of each source of error in the variance of each calibrated entry. Lengths and twists corrected within
        tolerances have no budget.
    rvdt
        Corrections of the readings of each RVDT that the poses could determine.
    forced
        Reason for using a calibration that was not accepted; None if it was accepted.
    """

    arm: WhichArm
    utc: UtcTime
    software_version: ExactText
    estimator: Literal["paper", "implicit"]
    fixture: WhichFixture
    joints: Annotated[tuple[JointParameters, ...], Field(min_length=1, max_length=32)]
    dh: tuple[DhRow, ...]
    calibrated: tuple[CalibratedEntry, ...]
    quality: Quality
    warnings: tuple[DocumentWarning, ...]
    pose_set_sha256: Sha256
    correlations: Correlations = field(default_factory=dict)
    budget: Budget = field(default_factory=dict)
    rvdt: tuple[RvdtRemedy, ...] = ()
    forced: ExactText | None = None

    def __post_init__(self) -> None:
        if len(self.dh) != len(self.joints) + 1:
            raise ValueError("an arm of n joints has D-H rows 0 to n")
        if self.utc.utcoffset() != UTC.utcoffset(None):
            raise ValueError("the time of a document is UTC")

    @property
    def table(self) -> DhTable:
        """The whole table, rows 0..n, in SI units."""
        return DhTable(
            theta_off_rad=np.deg2rad([row.theta_off_deg for row in self.dh]),
            s_m=frozen([row.s_m for row in self.dh]),
            a_m=frozen([row.a_m for row in self.dh]),
            alpha_rad=np.deg2rad([row.alpha_deg for row in self.dh]),
            beta_rad=np.deg2rad([row.beta_deg for row in self.dh]),
        )

    @property
    def theta_off_rad(self) -> FloatArray:
        """Offsets of joints 1..n, shape (n,), rad."""
        return np.deg2rad([joint.theta_off_deg for joint in self.joints])

    @field_validator("joints")
    @classmethod
    def _joints_in_order(
        cls, value: tuple[JointParameters, ...], info: ValidationInfo
    ) -> tuple[JointParameters, ...]:
        check_numbered(info, value, 1, "joint")
        return value

    @field_validator("dh")
    @classmethod
    def _table_fits(cls, value: tuple[DhRow, ...], info: ValidationInfo) -> tuple[DhRow, ...]:
        check_numbered(info, value, 0, "row")
        joints = info.data.get("joints")
        if joints is None:
            return value
        if len(value) != len(joints) + 1:
            text = f"has {len(value)} rows for {len(joints)} joints"
            report(info, ("dh",), text, "write rows 0 to n")
            return value
        for k, (row, joint) in enumerate(zip(value[1:], joints, strict=True), 1):
            if row.theta_off_deg != joint.theta_off_deg:
                text = f"{row.theta_off_deg!r} differs from the {joint.theta_off_deg!r} of joint {k} above"
                report(info, ("dh", k, "theta_off_deg"), text, CHANGED_IN_ONE_PLACE)
        return value

    @field_validator("calibrated")
    @classmethod
    def _calibrated_fits(
        cls, value: tuple[CalibratedEntry, ...], info: ValidationInfo
    ) -> tuple[CalibratedEntry, ...]:
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

    @field_validator("correlations", "budget")
    @classmethod
    def _entries_fit(cls, value: Any, info: ValidationInfo) -> Any:
        calibrated, name = info.data.get("calibrated"), str(info.field_name)
        of_budget = name == "budget"
        complaints = complaints_of_budget if of_budget else complaints_of_correlations
        if calibrated is not None:
            for place, text, remedy in complaints(value, [part.entry for part in calibrated]):
                report(info, (name, *place), text, remedy)
        return value

    @field_validator("rvdt")
    @classmethod
    def _rvdt_fits(
        cls, value: tuple[RvdtRemedy, ...], info: ValidationInfo
    ) -> tuple[RvdtRemedy, ...]:
        joints = info.data.get("joints")
        for k, remedy in enumerate(value):
            if joints is not None and remedy.joint > len(joints):
                text = f"there is no joint {remedy.joint}"
                report(info, ("rvdt", k, "joint"), text, f"joints are 1 to {len(joints)}")
            if remedy.joint in [earlier.joint for earlier in value[:k]]:
                report(info, ("rvdt", k, "joint"), "is listed twice", "keep one of them")
        return value

    @field_validator("quality")
    @classmethod
    def _rank_fits(cls, value: Quality, info: ValidationInfo) -> Quality:
        calibrated, fixture = info.data.get("calibrated"), info.data.get("fixture")
        if calibrated is None:
            return value
        beside = 0 if fixture is None else BESIDE_THE_TABLE.get(fixture.kind, 0)
        if value.rank > len(calibrated) + beside:
            text = f"rank {value.rank} exceeds the number of calibrated entries ({len(calibrated)})"
            report(info, ("quality", "rank"), text, CHANGED_IN_ONE_PLACE)
        return value


def _entry_complaints(
    part: CalibratedEntry, before: list[str], joints: tuple[JointParameters, ...] | None
) -> Iterator[tuple[str, str]]:
    """Yield text and remedy of the first problem of one calibrated entry; `before`: names of the entries before it."""
    entry = DhEntry.parse(part.entry)
    key, other = ("sigma_deg", "sigma_m") if entry.kind.is_angle else ("sigma_m", "sigma_deg")
    if part.entry in before:
        yield "is listed twice", "keep one of them"
    elif getattr(part, key) is None or getattr(part, other) is not None:
        yield f"has no {key} or has a {other}", f"write {key}, and leave {other} out"
    elif joints is not None and entry.row > len(joints):
        yield f"there is no row {entry.row}", f"the arm has rows 0 to {len(joints)}"
    elif joints is not None and entry.name.startswith("theta_off_") and entry.row > 0:
        stated = joints[entry.row - 1].sigma_deg
        if stated != part.sigma_deg:
            shown = "null" if stated is None else repr(stated)
            text = f"{part.sigma_deg!r} differs from the {shown} of joint {entry.row} above"
            yield text, CHANGED_IN_ONE_PLACE
