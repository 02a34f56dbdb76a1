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
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from datetime import UTC, datetime
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import (
    BeforeValidator,
    Field,
    PlainSerializer,
    StringConstraints,
    WithJsonSchema,
)

from operator_app.config.parameter_records import (
    BUDGET_SUM_TOLERANCE,
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
)
from operator_app.config.quantities import ExactText, refuse
from operator_app.config.schema import Fields, StrictRecord, checked, numbered
from operator_app.config.strict_yaml import Complaint
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


def _check_table(rows: Sequence[DhRow], fields: Fields) -> Iterator[Complaint]:
    joints = fields.get("joints")
    if joints is None:
        return
    if len(rows) != len(joints) + 1:
        yield ("dh",), f"has {len(rows)} rows for {len(joints)} joints", "write rows 0 to n"
        return
    for k, (row, joint) in enumerate(zip(rows[1:], joints, strict=True), 1):
        if row.theta_off_deg != joint.theta_off_deg:
            text = (
                f"{row.theta_off_deg!r} differs from the {joint.theta_off_deg!r} of joint {k} above"
            )
            yield ("dh", k, "theta_off_deg"), text, CHANGED_IN_ONE_PLACE


def _check_calibrated(entries: Sequence[CalibratedEntry], fields: Fields) -> Iterator[Complaint]:
    joints = fields.get("joints")
    names = [part.entry for part in entries]
    for k, part in enumerate(entries):
        for text, remedy in _entry_complaints(part, names[:k], joints):
            yield ("calibrated", k), text, remedy
    for k, joint in enumerate(joints or ()):
        if joint.sigma_deg is not None and f"theta_off_{joint.joint}" not in names:
            text = f"theta_off_{joint.joint} is not listed as calibrated"
            remedy = "an entry that was not calibrated has no sigma: write null"
            yield ("joints", k, "sigma_deg"), text, remedy


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


def _check_rank(quality: Quality, fields: Fields) -> Iterator[Complaint]:
    calibrated, fixture = fields.get("calibrated"), fields.get("fixture")
    beside = 0 if fixture is None else BESIDE_THE_TABLE.get(fixture.kind, 0)
    if calibrated is not None and quality.rank > len(calibrated) + beside:
        text = f"rank {quality.rank} exceeds the number of calibrated entries ({len(calibrated)})"
        yield ("quality", "rank"), text, CHANGED_IN_ONE_PLACE


def _check_correlations(value: Correlations, fields: Fields) -> Iterator[Complaint]:
    names = [part.entry for part in fields.get("calibrated", ())]
    place = "correlations"
    remedy = "`calibrated` and `correlations` do not match: edit both or neither"
    if "calibrated" not in fields:
        return
    if value and list(value) != names[1:]:
        text = (
            "must list every calibrated entry except the first, in the same order as `calibrated`"
        )
        yield (place,), text, remedy
        return
    for k, (name, row) in enumerate(value.items(), 1):
        if len(row) != k:
            text = f"has {len(row)} correlations; expected {k} (one for each calibrated entry listed before {name})"
            yield (place, name), text, remedy


def _check_budget(value: Budget, fields: Fields) -> Iterator[Complaint]:
    if "calibrated" not in fields:
        return
    for name, shares in value.items():
        place, total = ("budget", name), sum(shares.values())
        if name not in [part.entry for part in fields["calibrated"]]:
            yield place, "is not listed as calibrated", "leave its budget out"
        elif abs(total - 1.0) > BUDGET_SUM_TOLERANCE:
            yield place, f"has shares that add up to {total:g}, not 1", "correct the shares"


def _check_rvdt(corrections: Sequence[RvdtRemedy], fields: Fields) -> Iterator[Complaint]:
    joints = fields.get("joints")
    for k, correction in enumerate(corrections):
        joint, place = correction.joint, ("rvdt", k, "joint")
        if joints is not None and joint > len(joints):
            yield place, f"there is no joint {joint}", f"joints are 1 to {len(joints)}"
        if joint in [earlier.joint for earlier in corrections[:k]]:
            yield place, "is listed twice", "keep one of them"


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
    joints: Annotated[
        tuple[JointParameters, ...],
        Field(min_length=1, max_length=32),
        numbered("joints", "joint"),
    ]
    dh: Annotated[tuple[DhRow, ...], numbered("dh", "row", first=0), checked(_check_table)]
    calibrated: Annotated[tuple[CalibratedEntry, ...], checked(_check_calibrated)]
    quality: Annotated[Quality, checked(_check_rank)]
    warnings: tuple[DocumentWarning, ...]
    pose_set_sha256: Sha256
    correlations: Annotated[Correlations, checked(_check_correlations)] = field(
        default_factory=dict
    )
    budget: Annotated[Budget, checked(_check_budget)] = field(default_factory=dict)
    rvdt: Annotated[tuple[RvdtRemedy, ...], checked(_check_rvdt)] = ()
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
