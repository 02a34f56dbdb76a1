"""What a parameters document lists, record by record: joints, rows, entries, corrections, quality. Knows no YAML."""

from __future__ import annotations

from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

from pydantic import (
    Field,
    StringConstraints,
    field_validator,
)

from operator_app.config.quantities import (
    AngleDeg,
    Count,
    ExactText,
    LengthM,
    NonNegativeNumber,
    Number,
    PositiveNumber,
    TurnDeg,
    Whole,
    refuse,
)
from operator_app.config.schema import StrictRecord
from solver.chain.parameters import DhEntry

Int32 = Annotated[int, Field(strict=True, ge=-(2**31), le=2**31 - 1)]
FORCED, NOT_ACCEPTED = "FORCED", "NOT_ACCEPTED"
REFUSED = (FORCED, NOT_ACCEPTED)
"""Codes of the warning that a calibration was not accepted: used all the same for a reason, or not used."""
Code = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_]*$")]
Side = Literal["arm", "ground", "hand"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WhichArm(StrictRecord):
    """Model, e.g. ``sarcos_dextrous``, and serial number of an arm."""

    model: ExactText
    serial: ExactText


@dataclass(frozen=True, slots=True, kw_only=True)
class WhichFixture(StrictRecord):
    """What the operator calls the fixture that closed the loop, and its kind."""

    name: ExactText
    kind: ExactText


@dataclass(frozen=True, slots=True, kw_only=True)
class JointParameters(StrictRecord):
    """One joint.

    Attributes
    ----------
    theta_off_deg
        Joint-angle offset: theta' = theta + theta_off.
    sigma_deg
        Its standard deviation; None where it was not calibrated.
    home_offset_counts
        The offset in counts of the joint's sensor, for 607Ch; None for a joint without a sensor.
    """

    joint: Count
    theta_off_deg: TurnDeg
    sigma_deg: NonNegativeNumber | None
    home_offset_counts: Int32 | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DhRow(StrictRecord):
    """One D-H row, 0 (the fixture) to n; `beta_deg` is Hayati's, written where it is not zero."""

    row: Whole
    theta_off_deg: TurnDeg
    s_m: LengthM
    a_m: LengthM
    alpha_deg: TurnDeg
    beta_deg: TurnDeg = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedEntry(StrictRecord):
    """An entry that was calibrated, with its standard deviation: an angle's in deg, a length's in m.

    `side` says whose it is: the arm's outlives the mounting, the ground's and the hand's do not. None in
    files of version 1.
    """

    entry: ExactText
    side: Side | None = None
    sigma_deg: NonNegativeNumber | None = None
    sigma_m: NonNegativeNumber | None = None

    @classmethod
    def of(cls, entry: str, sigma: float, side: Side | None = None) -> CalibratedEntry:
        """Entry with `sigma` in its unit, deg or m."""
        if DhEntry.parse(entry).kind.is_angle:
            return cls(entry=entry, side=side, sigma_deg=sigma)
        return cls(entry=entry, side=side, sigma_m=sigma)

    @property
    def sigma(self) -> float:
        """Standard deviation, deg or m."""
        return self.sigma_deg if self.sigma_deg is not None else self.sigma_m or 0.0

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


@dataclass(frozen=True, slots=True, kw_only=True)
class Correction(StrictRecord):
    """What to add to one reading of an RVDT, and how well that is known (one standard deviation)."""

    reading_deg: AngleDeg
    add_deg: Number
    sigma_deg: NonNegativeNumber


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtRemedy(StrictRecord):
    """What the closed loop says of one RVDT, its own readings taking no part.

    Attributes
    ----------
    theta_off_deg
        Offset that belongs to corrected readings.
    gain
        Reading per angle; 1 is right. Its line is in the table as well.
    table
        By rising reading, over the range that the poses cover; linear in between.
    """

    joint: Count
    theta_off_deg: TurnDeg
    gain: PositiveNumber
    table: Annotated[tuple[Correction, ...], Field(min_length=2, max_length=1000)]

    @field_validator("table")
    @classmethod
    def _rises(cls, value: tuple[Correction, ...]) -> tuple[Correction, ...]:
        for before, after in pairwise(value):
            if after.reading_deg <= before.reading_deg:
                raise refuse(
                    f"{after.reading_deg:g} deg stands after {before.reading_deg:g} deg",
                    "list the readings from the lowest to the highest",
                )
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoFigures(StrictRecord):
    """A figure in both readings of eqs. 14 and 15."""

    rms: NonNegativeNumber
    as_printed: NonNegativeNumber


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality(StrictRecord):
    """How good the calibration is."""

    poses: Count
    rank: Whole
    scaled_condition_number: Annotated[Number, Field(ge=1.0)]
    sigma_pos_mm: TwoFigures
    sigma_ori_mrad: TwoFigures | None
    chi2_per_dof: NonNegativeNumber | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentWarning(StrictRecord):
    """A warning, as the operator saw it."""

    code: Code
    text: ExactText
