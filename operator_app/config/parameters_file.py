"""The parameters file of a calibration (``sarcal/parameters/3``): content, checks, reading and writing.

The document has the content and the units of the file (degrees, metres, millimetres, milliradians). Writing and reading
therefore change no bit. `ParametersDocument.table` is in SI units. The document is checked when written or read.

Version 1 had no `side`, `rvdt` and `forced`. The first programs for version 2 refuse the keys `correlations` and
`budget`, which were added later. Version 3 adds ``beta_deg`` to rows; a document without ``beta_deg`` is written as
version 2. Any further key needs a new version number, because an old program reports an unknown version more clearly
than an unknown key.
"""

import math
import re
from collections.abc import Iterator, Sequence
from contextlib import suppress
from dataclasses import dataclass, field, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Annotated, Any, Literal

import numpy as np
from pydantic import BeforeValidator, Field, PlainSerializer, WithJsonSchema

from operator_app.config import parameter_records as records
from operator_app.config import schema
from operator_app.config.atomic import dump_strict, write_atomically
from operator_app.config.errors import ConfigError, only, value_in_words
from operator_app.config.quantities import ExactText, degrees_for_file, in_form, refuse
from operator_app.config.resources import YAML_LIMIT_BYTES, expanded, read_limited
from operator_app.config.strict_yaml import Complaint
from solver.arrays import FloatArray, frozen
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry
from solver.chain.sensors import NoSensor

CHANGED_IN_ONE_PLACE = "the document was changed in one place only: make the two values agree"
UTC_FORM = r"\d{4}-\d\d-\d\dT\d\d:\d\d:\d\d(\.\d{6})?Z"


def _time_from_text(value: Any) -> datetime:
    if isinstance(value, str) and re.fullmatch(UTC_FORM, value):
        with suppress(ValueError, OverflowError):
            return datetime.fromisoformat(value).astimezone(UTC)
    shown = value_in_words(value)
    raise refuse(f"{shown} is not a UTC time", "write for example 2026-01-31T12:00:00Z")


Sha256 = Annotated[str, *in_form("[0-9a-f]{64}", "SHA-256 digest", "write 64 digits 0-9, a-f")]
UtcTime = Annotated[
    datetime,
    BeforeValidator(_time_from_text),
    PlainSerializer(lambda time: time.astimezone(UTC).replace(tzinfo=None).isoformat() + "Z"),
    WithJsonSchema({"type": "string", "pattern": f"^{UTC_FORM}$"}),
]

BESIDE_THE_TABLE = {"ball": 6, "measured": 12}
"""Number of parameters outside the D-H table, by fixture: points of ball and socket, poses of instrument and target."""


def _check_table(rows: Sequence[records.DhRow], fields: schema.Fields) -> Iterator[Complaint]:
    joints = fields.get("joints")
    if joints is not None and len(rows) != len(joints) + 1:
        yield ("dh",), f"has {len(rows)} rows for {len(joints)} joints", "write rows 0 to n"
        return
    for k, (row, joint) in enumerate(zip(rows[1:], joints or (), strict=False), 1):
        here, above = row.theta_off_deg, joint.theta_off_deg
        if here != above:
            text = f"{here!r} differs from the {above!r} of joint {k} above"
            yield ("dh", k, "theta_off_deg"), text, CHANGED_IN_ONE_PLACE


def _check_calibrated(
    entries: Sequence[records.CalibratedEntry], fields: schema.Fields
) -> Iterator[Complaint]:
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
    part: records.CalibratedEntry,
    before: list[str],
    joints: tuple[records.JointParameters, ...] | None,
) -> Iterator[tuple[str, str]]:
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


def _check_rank(quality: records.Quality, fields: schema.Fields) -> Iterator[Complaint]:
    calibrated, fixture = fields.get("calibrated"), fields.get("fixture")
    beside = 0 if fixture is None else BESIDE_THE_TABLE.get(fixture.kind, 0)
    if calibrated is not None and quality.rank > len(calibrated) + beside:
        text = f"rank {quality.rank} exceeds the number of calibrated entries ({len(calibrated)})"
        yield ("quality", "rank"), text, CHANGED_IN_ONE_PLACE


def _check_correlations(value: records.Correlations, fields: schema.Fields) -> Iterator[Complaint]:
    if "calibrated" not in fields:
        return
    remedy = "`calibrated` and `correlations` do not match: edit both or neither"
    if value and list(value) != [part.entry for part in fields["calibrated"]][1:]:
        text = (
            "must list every calibrated entry except the first, in the same order as `calibrated`"
        )
        yield ("correlations",), text, remedy
        return
    for k, (name, row) in enumerate(value.items(), 1):
        if len(row) != k:
            text = f"has {len(row)} correlations; expected {k} (one for each calibrated entry listed before {name})"
            yield ("correlations", name), text, remedy


def _check_budget(value: records.Budget, fields: schema.Fields) -> Iterator[Complaint]:
    if "calibrated" not in fields:
        return
    for name, shares in value.items():
        place, total = ("budget", name), sum(shares.values())
        if name not in [part.entry for part in fields["calibrated"]]:
            yield place, "is not listed as calibrated", "leave its budget out"
        elif abs(total - 1.0) > records.BUDGET_SUM_TOLERANCE:
            yield place, f"has shares that add up to {total:g}, not 1", "correct the shares"


def _check_rvdt(
    corrections: Sequence[records.RvdtRemedy], fields: schema.Fields
) -> Iterator[Complaint]:
    joints = fields.get("joints")
    for k, correction in enumerate(corrections):
        joint, place = correction.joint, ("rvdt", k, "joint")
        if joints is not None and joint > len(joints):
            yield place, f"there is no joint {joint}", f"joints are 1 to {len(joints)}"
        if joint in [earlier.joint for earlier in corrections[:k]]:
            yield place, "is listed twice", "keep one of them"


@dataclass(frozen=True, slots=True, kw_only=True)
class ParametersDocument(schema.StrictRecord):
    """Parameters of one arm from one calibration.

    Attributes
    ----------
    software_version, utc
        Version of the program that wrote the file, and time of the calibration (UTC, with time zone).
    joints, dh, calibrated
        Offsets, the whole D-H table (rows 0..n), and its calibrated entries. Row 0 describes a hinge or a rigid
        fixture; for other fixtures it is zero.
    pose_set_sha256
        `solver.chain.poses.PoseSet.sha256` of the poses.
    correlations
        Correlations of each calibrated entry except the first with all entries before it, in the order of
        `calibrated`. Together with the sigmas they define the whole covariance.
    budget
        Share of each source of error in the variance of each calibrated entry. Lengths and twists corrected within
        tolerances have no budget.
    rvdt
        For each RVDT whose errors the poses could determine: corrections of its readings.
    forced
        Reason for using a calibration that was not accepted; None if it was accepted.
    """

    arm: records.WhichArm
    utc: UtcTime
    software_version: ExactText
    estimator: Literal["paper", "implicit"]
    fixture: records.WhichFixture
    joints: Annotated[
        tuple[records.JointParameters, ...],
        Field(min_length=1, max_length=32),
        schema.numbered("joints", "joint"),
    ]
    dh: Annotated[
        tuple[records.DhRow, ...],
        schema.numbered("dh", "row", first=0),
        schema.checked(_check_table),
    ]
    calibrated: Annotated[tuple[records.CalibratedEntry, ...], schema.checked(_check_calibrated)]
    quality: Annotated[records.Quality, schema.checked(_check_rank)]
    warnings: tuple[records.DocumentWarning, ...]
    pose_set_sha256: Sha256
    correlations: Annotated[records.Correlations, schema.checked(_check_correlations)] = field(
        default_factory=dict
    )
    budget: Annotated[records.Budget, schema.checked(_check_budget)] = field(default_factory=dict)
    rvdt: Annotated[tuple[records.RvdtRemedy, ...], schema.checked(_check_rvdt)] = ()
    forced: ExactText | None = None

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


COMMENT = "Written by sarcal. A controller checks it against this schema; edit it only on purpose."
WITHOUT_BETA = "sarcal/parameters/2"
RESULT = "the result"
REMEDY = "this calibration cannot be exported: take more poses that differ more from each other"


def parse_parameters(data: bytes, file: str = "parameters") -> ParametersDocument:
    """Read a parameters document from its bytes; raises ConfigError with all its problems."""
    return schema.read_model(ParametersDocument, data, kind="parameters", file=file)


def load_parameters(path: str | Path) -> ParametersDocument:
    """Read a parameters file; raises the same errors as `parse_parameters`."""
    where = expanded(path)
    return parse_parameters(read_limited(where, str(path), limit=YAML_LIMIT_BYTES), str(path))


def format_parameters(document: ParametersDocument) -> bytes:
    """Format a document so that `parse_parameters` returns the same document, bit for bit.

    Raises ConfigError for an invalid document, e.g. after a diverged fit: a controller must not get such a file.
    """
    # An entry has one sigma of the two (deg or m); the other is left out.
    body = schema.adapter(ParametersDocument).dump_python(document, exclude_defaults=True)
    # Programs of version 2 can read a document without beta.
    name = schema.schema_name("parameters") if document.table.beta_rad.any() else WITHOUT_BETA
    try:
        data = dump_strict({"schema": name, **body}, comment=COMMENT)
        parse_parameters(data, RESULT)
    except ValueError as error:
        raise only(RESULT, str(error), REMEDY) from error
    except ConfigError as error:
        raise ConfigError(replace(p, line=None, remedy=REMEDY) for p in error.problems) from error
    return data


def save_parameters(path: Path, document: ParametersDocument) -> None:
    """Write a parameters file atomically; raises WriteError, and the errors of `format_parameters`."""
    write_atomically(path, format_parameters(document))


def rows_from_table(table: DhTable) -> tuple[records.DhRow, ...]:
    """Convert rows 0..n of a table in SI units to the units of the document."""
    angles = (table.theta_off_rad, table.alpha_rad, table.beta_rad)
    columns = (*map(degrees_for_file, angles), table.s_m, table.a_m)
    return tuple(
        records.DhRow(row=k, theta_off_deg=theta_off, alpha_deg=alpha, beta_deg=beta, s_m=s, a_m=a)
        for k, (theta_off, alpha, beta, s, a) in enumerate(np.column_stack(columns).tolist())
    )


def joints_from_table(
    arm: ArmModel, table: DhTable, calibrated: tuple[records.CalibratedEntry, ...]
) -> tuple[records.JointParameters, ...]:
    """Return the records of joints 1..n: the offset in `table`, in deg and in counts, and its sigma if calibrated."""
    sigma = {entry.entry: entry.sigma for entry in calibrated}
    return tuple(
        records.JointParameters(
            joint=row.row,
            theta_off_deg=row.theta_off_deg,
            sigma_deg=sigma.get(f"theta_off_{row.row}"),
            home_offset_counts=home_offset_counts(arm, row.row, math.radians(row.theta_off_deg)),
        )
        for row in rows_from_table(table)[1:]
    )


def home_offset_counts(arm: ArmModel, joint: int, theta_off_rad: float) -> int | None:
    """Return `theta_off_rad` in counts of the joint's sensor, for object 607Ch (home offset); None without a sensor."""
    sensor = arm.joints[joint - 1].sensor
    return None if isinstance(sensor, NoSensor) else round(theta_off_rad / sensor.resolution_rad)
