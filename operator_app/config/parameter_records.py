"""Records of a parameters document: joints, rows, entries, RVDT corrections, quality, correlations, budget."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from itertools import pairwise
from typing import Annotated, Literal

import numpy as np
from pydantic import Field, field_validator

from operator_app.config import quantities
from operator_app.config.schema import StrictRecord
from solver.arrays import FloatArray
from solver.chain.parameters import DhEntry

Int32 = Annotated[int, Field(strict=True, ge=-(2**31), le=2**31 - 1)]
FORCED, NOT_ACCEPTED = "FORCED", "NOT_ACCEPTED"
REFUSED = (FORCED, NOT_ACCEPTED)
"""Codes of the warning that a calibration was not accepted; `FORCED`: it was exported with a stated reason."""
Code = Annotated[str, *quantities.in_form("[A-Za-z][A-Za-z0-9_]*", "code", "write e.g. RANGE_3")]
Side = Literal["arm", "ground", "hand"]


@dataclass(frozen=True, slots=True, kw_only=True)
class WhichArm(StrictRecord):
    """Model, e.g. ``sarcos_dextrous``, and serial number of an arm."""

    model: quantities.ExactText
    serial: quantities.ExactText


@dataclass(frozen=True, slots=True, kw_only=True)
class WhichFixture(StrictRecord):
    """Name and kind of the fixture."""

    name: quantities.ExactText
    kind: quantities.ExactText


@dataclass(frozen=True, slots=True, kw_only=True)
class JointParameters(StrictRecord):
    """Parameters of one joint.

    Attributes
    ----------
    theta_off_deg
        Joint-angle offset: theta' = theta + theta_off.
    sigma_deg
        Standard deviation of the offset; None if it was not calibrated.
    home_offset_counts
        The same offset in counts of the joint's sensor, for object 607Ch; None for a joint without a sensor.
    """

    joint: quantities.Count
    theta_off_deg: quantities.TurnDeg
    sigma_deg: quantities.NonNegativeNumber | None
    home_offset_counts: Int32 | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DhRow(StrictRecord):
    """One D-H row; row 0 describes the fixture. `beta_deg` is Hayati's angle, written if it is not 0."""

    row: quantities.Whole
    theta_off_deg: quantities.TurnDeg
    s_m: quantities.LengthM
    a_m: quantities.LengthM
    alpha_deg: quantities.TurnDeg
    beta_deg: quantities.TurnDeg = 0.0


@dataclass(frozen=True, slots=True, kw_only=True)
class CalibratedEntry(StrictRecord):
    """A calibrated D-H entry and its standard deviation: `sigma_deg` of an angle, `sigma_m` of a length.

    `side`: "arm" for an entry of the arm itself, "ground" for the place of the fixture on the table, "hand" for that on
    the tool. Only entries of the arm stay valid in another mounting. In version 1, `side` is None.
    """

    entry: quantities.ExactText
    side: Side | None = None
    sigma_deg: quantities.NonNegativeNumber | None = None
    sigma_m: quantities.NonNegativeNumber | None = None

    @classmethod
    def of(cls, entry: str, sigma: float, side: Side | None = None) -> CalibratedEntry:
        """Return the record of an entry; `sigma` is in deg for an angle, in m for a length."""
        if DhEntry.parse(entry).kind.is_angle:
            return cls(entry=entry, side=side, sigma_deg=sigma)
        return cls(entry=entry, side=side, sigma_m=sigma)

    @property
    def sigma(self) -> float:
        """Standard deviation, deg for an angle, m for a length."""
        return self.sigma_deg if self.sigma_deg is not None else self.sigma_m or 0.0

    @field_validator("entry")
    @classmethod
    def _is_entry(cls, value: str) -> str:
        try:
            entry = DhEntry.parse(value)
        except ValueError as error:
            raise quantities.refuse(str(error), "write for example theta_off_1") from error
        if entry.name != value:
            raise quantities.refuse(f"{value} has a leading zero", f"write {entry.name}")
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class Correction(StrictRecord):
    """Correction to add to one reading of an RVDT, and its standard deviation."""

    reading_deg: quantities.AngleDeg
    add_deg: quantities.Number
    sigma_deg: quantities.NonNegativeNumber


@dataclass(frozen=True, slots=True, kw_only=True)
class RvdtRemedy(StrictRecord):
    """Corrections of one RVDT, determined by the closed loop without the RVDT's own readings.

    Attributes
    ----------
    theta_off_deg
        Joint-angle offset to be used with corrected readings.
    gain
        Change of reading per change of angle, ideally 1; the corrections in `table` include it.
    table
        Corrections in rising order of the reading, over the range that the poses cover; to be interpolated linearly.
    """

    joint: quantities.Count
    theta_off_deg: quantities.TurnDeg
    gain: quantities.PositiveNumber
    table: Annotated[tuple[Correction, ...], Field(min_length=2, max_length=1000)]

    @field_validator("table")
    @classmethod
    def _require_rising_readings(cls, value: tuple[Correction, ...]) -> tuple[Correction, ...]:
        for before, after in pairwise(value):
            if after.reading_deg <= before.reading_deg:
                text = f"{after.reading_deg:g} deg follows {before.reading_deg:g} deg"
                raise quantities.refuse(text, "list the readings from the lowest to the highest")
        return value


@dataclass(frozen=True, slots=True, kw_only=True)
class TwoFigures(StrictRecord):
    """Sigma of N residuals, from the sum of their squares: sqrt(sum / N), and as the paper has it (eqs. 14, 15)."""

    rms: quantities.NonNegativeNumber
    as_printed: quantities.NonNegativeNumber


@dataclass(frozen=True, slots=True, kw_only=True)
class Quality(StrictRecord):
    """Quality figures of the calibration."""

    poses: quantities.Count
    rank: quantities.Whole
    scaled_condition_number: Annotated[quantities.Number, Field(ge=1.0)]
    sigma_pos_mm: TwoFigures
    sigma_ori_mrad: TwoFigures | None
    chi2_per_dof: quantities.NonNegativeNumber | None


@dataclass(frozen=True, slots=True, kw_only=True)
class DocumentWarning(StrictRecord):
    """A warning, as shown to the operator."""

    code: Code
    text: quantities.ExactText


CORRELATION_PLACES, SHARE_PLACES = 5, 4
BUDGET_SUM_TOLERANCE = 0.01
"""Largest deviation from 1, due to rounding, of the sum of an entry's shares."""

Correlation = Annotated[quantities.Number, Field(ge=-1.0, le=1.0)]
Share = Annotated[quantities.Number, Field(ge=0.0, le=1.0)]

Correlations = Mapping[str, tuple[Correlation, ...]]
"""For each calibrated entry after the first, in the order of `calibrated`: its correlation with every earlier entry."""
Budget = Mapping[str, Mapping[str, Share]]
"""Share of each source of error in the variance of a calibrated entry."""


def correlations_of(names: Sequence[str], covariance: FloatArray) -> dict[str, tuple[float, ...]]:
    """Return the `Correlations` of the k parameters `names` from their covariance (k, k); 0 if a variance is 0."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    scale = np.where(sd > 0.0, sd, np.inf)
    correlation = np.clip(covariance / np.outer(scale, scale), -1.0, 1.0)
    # Adding 0.0 turns -0.0 into 0.0.
    rounded = np.round(correlation, CORRELATION_PLACES) + 0.0
    return {name: tuple(rounded[k, :k].tolist()) for k, name in enumerate(names) if k}


def budget_of(
    names: Sequence[str], variance: FloatArray, parts: Mapping[str, FloatArray]
) -> dict[str, dict[str, float]]:
    """Return the `Budget` of the k parameters `names`; a parameter of zero variance is left out.

    `parts`: by source, the part (k,) of `variance` (k,). A share is part / variance; shares rounded to 0 are left out.
    """
    by_source = {}
    for k, name in enumerate(names):
        if variance[k] > 0.0:
            shares = {s: round(float(v[k] / variance[k]), SHARE_PLACES) for s, v in parts.items()}
            by_source[name] = {source: share for source, share in shares.items() if share > 0.0}
    return by_source
