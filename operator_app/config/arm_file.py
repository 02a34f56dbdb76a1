"""The arm file (``sarcal/arm/1``): D-H rows, free entries, ranges, sensors.

An uncertainty that the file does not state has a default value: the standard deviation usual in a workshop.
"""

import math
from collections.abc import Iterator, Sequence
from functools import partial
from pathlib import Path
from typing import Annotated, Any, ClassVar, Literal

import numpy as np
from pydantic import Field, field_validator, model_validator

from operator_app.config import error_model, quantities
from operator_app.config.errors import value_in_words
from operator_app.config.resources import resolve
from operator_app.config.schema import Fields, StrictModel, checked, numbered, read_model
from operator_app.config.strict_yaml import Complaint
from solver.arrays import FloatArray, frozen
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind
from solver.chain.sensors import Encoder, NoSensor, Rvdt, Sensor
from solver.chain.statics import UPRIGHT_DOWN


class RowModel(StrictModel):
    """One D-H row; ``fixture`` marks an entry that the fixture determines (asterisk in the paper's Table 1).

    ``beta_deg``: Hayati's angle in a row between parallel axes; it is identified instead of s, and ``s_m`` is optional.
    """

    row: quantities.Count
    theta_off_deg: quantities.TurnDeg
    s_m: quantities.LengthM | Literal["fixture"]
    a_m: quantities.LengthM | Literal["fixture"]
    alpha_deg: quantities.TwistDeg | Literal["fixture"]
    beta_deg: quantities.TwistDeg | None = None
    tolerance: error_model.RowToleranceModel = error_model.RowToleranceModel()

    @model_validator(mode="before")
    @classmethod
    def _beta_in_place_of_s(cls, value: Any) -> Any:
        if isinstance(value, dict) and "beta_deg" in value:
            return {"s_m": 0.0} | value
        return value


class SensorFields(StrictModel):
    """Base of sensor models. All keys but ``kind``, converted to SI units, are the arguments of the class `makes`."""

    makes: ClassVar[type[Sensor]]

    def sensor(self) -> Sensor:
        """Return the sensor as a domain object."""
        return self.makes(**quantities.in_si(self.model_dump(exclude={"kind"})))


class EncoderModel(SensorFields):
    """Incremental encoder."""

    makes = Encoder
    kind: Literal["encoder"]
    counts_per_rev: Annotated[int, Field(strict=True, ge=4, le=2**31 - 1)]
    noise_counts: quantities.NonNegativeNumber = 0.0
    accuracy_deg: quantities.StatedDeg = 0.01


class RvdtModel(SensorFields):
    """RVDT with an ADC that covers the full scale."""

    makes = Rvdt
    kind: Literal["rvdt"]
    bits: Annotated[int, Field(strict=True, ge=4, le=32)]
    full_scale_deg: Annotated[quantities.PositiveNumber, Field(le=360.0)]
    linearity: Annotated[quantities.NonNegativeNumber, Field(le=0.5)]
    noise_lsb: quantities.NonNegativeNumber
    # Gain error as a share of the reading. Data sheets state the scale factor separately from linearity; it is trimmed
    # to 1 % or better, here taken as two standard deviations.
    gain: Annotated[quantities.NonNegativeNumber, Field(le=0.5)] = 0.005

    @field_validator("full_scale_deg")
    @classmethod
    def _degrees(cls, value: float) -> float:
        if value <= 2.0 * math.pi:
            text = f"a full scale of {value:g} deg looks like radians"
            raise quantities.refuse(text, f"write {math.degrees(value):.6g}")
        return value


class NoSensorModel(SensorFields):
    """A joint without a sensor."""

    makes = NoSensor
    kind: Literal["none"]


SensorModel = Annotated[EncoderModel | RvdtModel | NoSensorModel, Field(discriminator="kind")]


class JointModel(StrictModel):
    """One joint of an arm file."""

    joint: quantities.Count
    name: quantities.Text
    range_deg: tuple[quantities.AngleDeg, quantities.AngleDeg]
    sensor: SensorModel
    max_speed_deg_per_s: Annotated[quantities.PositiveNumber, Field(le=3600.0)]
    max_torque_nm: Annotated[quantities.PositiveNumber, Field(le=100000.0)]
    backlash_deg: quantities.StatedDeg = 0.01
    sag_deg: quantities.StatedDeg = 0.01

    @field_validator("range_deg")
    @classmethod
    def _range(cls, value: tuple[float, float]) -> tuple[float, float]:
        low, high = value
        if low >= high:
            text = f"the range goes from {low:g} to {high:g} deg"
            raise quantities.refuse(text, "write the lower end first")
        if high - low < 2.0 * math.pi and max(abs(low), abs(high)) < 2.0 * math.pi:
            text = f"a range of {low:g} to {high:g} deg looks like radians"
            raise quantities.refuse(text, "write degrees")
        return value


def check_home(
    home_deg: Sequence[float], ranges_deg: Sequence[tuple[float, float]]
) -> Iterator[Complaint]:
    """Yield a problem for each home angle outside its joint's range, or one problem if their number is wrong."""
    if len(home_deg) != len(ranges_deg):
        text = f"has {len(home_deg)} angles for {len(ranges_deg)} joints"
        yield ("home_deg",), text, "write one angle per joint"
        return
    for k, (angle, (low, high)) in enumerate(zip(home_deg, ranges_deg, strict=True)):
        if not low <= angle <= high:
            text = f"{angle:g} deg is outside joint {k + 1}'s range {low:g} to {high:g} deg"
            yield ("home_deg", k), text, "correct the home or the range"


def _per_row(name: str, remedy: str, items: Sequence[Any], fields: Fields) -> Iterator[Complaint]:
    rows = fields.get("dh")
    if rows is not None and len(rows) != len(items):
        yield (f"{name}s",), f"there are {len(items)} {name}s for {len(rows)} D-H rows", remedy


def _check_rows(rows: Sequence[RowModel], _: Fields) -> Iterator[Complaint]:
    if rows[-1].beta_deg is not None:
        text = "the last row joins no two axes of the arm, so that it has no beta"
        yield ("dh", len(rows) - 1, "beta_deg"), text, "remove beta_deg"


def _check_links(links: Sequence[error_model.LinkModel], fields: Fields) -> Iterator[Complaint]:
    remedy = "write one link per row, with mass_kg: 0 for links without mass"
    yield from _per_row("link", remedy, links, fields)
    if fields.get("gravity", links) is None:
        text = "the links have masses, but the direction of gravity is missing"
        yield ("links",), text, "write for example gravity: {down: [0, 0, -1]}"


def _check_free(free: Sequence[str], fields: Fields) -> Iterator[Complaint]:
    rows, joints = fields.get("dh"), fields.get("joints", ())
    unsensed = [k for k, j in enumerate(joints, 1) if isinstance(j.sensor, NoSensorModel)]
    for k, name in enumerate(free):
        place = ("free", k)
        try:
            entry = DhEntry.parse(name)
        except ValueError as error:
            yield place, str(error), "write for example theta_off_1"
            continue
        if entry.name != name:
            yield place, f"{name} has a leading zero", f"write {entry.name}"
        elif name in free[:k]:
            yield place, f"{name} is listed twice", "keep one of them"
        offset_of = entry.row if entry.kind is DhKind.THETA_OFF else 0
        if rows is not None and not 1 <= entry.row <= len(rows):
            text = f"{name}: the arm has rows 1 to {len(rows)}"
            yield place, text, "entries of row 0 belong to the fixture"
        elif offset_of in unsensed:
            text = f"joint {entry.row} has no sensor, so that it has no offset"
            yield place, text, f"take {name} out"


def _check_home(home_deg: Sequence[float], fields: Fields) -> Iterator[Complaint]:
    if (joints := fields.get("joints")) is not None:
        yield from check_home(home_deg, [joint.range_deg for joint in joints])


class ArmFile(StrictModel):
    """Content of an arm file, without the key ``schema``."""

    name: quantities.Name
    source: quantities.Text | None = None
    tolerance: error_model.ToleranceModel = error_model.ToleranceModel()
    offset_tolerance_deg: (
        Annotated[quantities.PositiveNumber, Field(le=180.0)] | Literal["unknown"]
    ) = "unknown"
    dh: Annotated[
        tuple[RowModel, ...],
        Field(min_length=1, max_length=32),
        numbered("dh", "row"),
        checked(_check_rows),
    ]
    joints: Annotated[
        tuple[JointModel, ...],
        numbered("joints", "joint"),
        checked(partial(_per_row, "joint", "write one joint per row")),
    ]
    free: Annotated[tuple[quantities.Text, ...], checked(_check_free)]
    home_deg: Annotated[tuple[quantities.AngleDeg, ...], checked(_check_home)]
    gravity: error_model.GravityModel | None = None
    links: (
        Annotated[
            tuple[error_model.LinkModel, ...], numbered("links", "link"), checked(_check_links)
        ]
        | None
    ) = None

    @field_validator("offset_tolerance_deg", mode="before")
    @classmethod
    def _require_tolerance_or_unknown(cls, value: Any) -> Any:
        """Refuse a value that is neither a number nor `unknown`, with one error instead of pydantic's two."""
        number = isinstance(value, int | float) and not isinstance(value, bool)
        if value == "unknown" or (number and 0.0 < value <= 180.0):
            return value
        text = f"must be a number (above 0, at most 180) or the word `unknown`, not {value_in_words(value)}"
        remedy = "write the standard deviation of the joints' zeros in degrees, or `unknown`"
        raise quantities.refuse(text, remedy)

    def model(self) -> ArmModel:
        """Return the arm as a domain object, in SI units; entries that the fixture determines are zero."""

        def column(name: str) -> list[float]:
            values = [getattr(row, name) for row in self.dh]
            return [0.0 if value == "fixture" else float(value) for value in values]

        def tolerances(key: str) -> FloatArray:
            stated = [getattr(row.tolerance, key) for row in self.dh]
            return np.array([getattr(self.tolerance, key) if v is None else v for v in stated])

        hayati = tuple(row.row for row in self.dh[:-1] if _is_hayati(row))
        offset, links, gravity = self.offset_tolerance_deg, self.links, self.gravity
        # In a Hayati row, beta is identified in place of s.
        free = (
            DhEntry(DhKind.BETA, e.row) if e.kind is DhKind.S and e.row in hayati else e
            for e in map(DhEntry.parse, self.free)
        )
        return ArmModel(
            name=self.name,
            table=DhTable(
                theta_off_rad=np.deg2rad(column("theta_off_deg")),
                s_m=frozen(column("s_m")),
                a_m=frozen(column("a_m")),
                alpha_rad=np.deg2rad(column("alpha_deg")),
                beta_rad=np.deg2rad([row.beta_deg or 0.0 for row in self.dh]),
            ),
            joints=tuple(
                Joint(
                    lower_rad=math.radians(joint.range_deg[0]),
                    upper_rad=math.radians(joint.range_deg[1]),
                    sensor=joint.sensor.sensor(),
                    **quantities.in_si(joint.model_dump(exclude={"joint", "range_deg", "sensor"})),
                )
                for joint in self.joints
            ),
            free=tuple(dict.fromkeys(free)),
            home_rad=frozen(np.deg2rad(self.home_deg)),
            length_tolerance_m=frozen(tolerances("length_mm") / 1e3),
            twist_tolerance_rad=frozen(np.deg2rad(tolerances("twist_deg"))),
            offset_tolerance_rad=None if isinstance(offset, str) else math.radians(offset),
            down=gravity.direction if gravity else UPRIGHT_DOWN,
            masses=error_model.link_masses(links, gravity) if links and gravity else None,
            hayati_rows=hayati,
            assumed=tuple(self._assumed()),
        )

    def _assumed(self) -> Iterator[str]:
        yield from error_model.assumed_of_rows(self.tolerance, [row.tolerance for row in self.dh])
        # A joint without a sensor has no play or sag that affects a reading.
        sensed = {j.joint: j for j in self.joints if not isinstance(j.sensor, NoSensorModel)}
        encoders = {k: j.sensor for k, j in sensed.items() if isinstance(j.sensor, EncoderModel)}
        rvdts = {k: j.sensor for k, j in sensed.items() if isinstance(j.sensor, RvdtModel)}
        yield from error_model.assumed_of_joints("accuracy_deg", encoders)
        yield from error_model.assumed_of_joints("gain", rvdts)
        yield from error_model.assumed_of_joints("backlash_deg", sensed)
        yield from error_model.assumed_of_joints("sag_deg", sensed)


PARALLEL_RAD = math.radians(10.0)
"""Neighbouring axes nearer to parallel than this need a row with Hayati's beta (paper, [9]): a twist error of 0.1 deg
would move the foot of their common normal, from which s is measured, by at least 1 % of the entry a."""


def _is_hayati(row: RowModel) -> bool:
    if row.beta_deg is not None or row.alpha_deg == "fixture":
        return row.beta_deg is not None
    return abs(math.sin(math.radians(row.alpha_deg))) < math.sin(PARALLEL_RAD)


def parse_arm(data: bytes, file: str) -> ArmModel:
    """Read an arm from the bytes of its file, called `file` in messages; raises ConfigError with all its problems."""
    return read_model(ArmFile, data, kind="arm", file=file).model()


def load_arm(reference: str | Path) -> ArmModel:
    """Read an arm by built-in name or path; raises the same errors as `parse_arm`."""
    resource = resolve("arm", reference)
    return parse_arm(resource.data, resource.file)
