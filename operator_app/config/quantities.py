"""Units of numbers in files: conversion to SI units and back without loss, and checks for plausible sizes."""

from __future__ import annotations

import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, StringConstraints, WithJsonSchema
from pydantic_core import PydanticCustomError

from solver.arrays import FloatArray

UNITS = {
    "m": "metres",
    "mm": "millimetres",
    "deg": "degrees",
    "rad": "radians",
    "mrad": "milliradians",
    "s": "seconds",
    "counts": "counts",
    "deg_per_s": "degrees per second",
    "rad_per_s": "radians per second",
    "nm": "newton metres",
}
"""Units, as the endings of keys."""
UNIT = re.compile(rf"(.+?)_({'|'.join(sorted(UNITS, key=len, reverse=True))})")

TO_SI: Mapping[str, tuple[str, Callable[[float], float]]] = {
    "mm": ("m", lambda value: value / 1e3),
    "mrad": ("rad", lambda value: value / 1e3),
    "deg": ("rad", math.radians),
    "deg_per_s": ("rad_per_s", math.radians),
}

LONGEST_M = 10.0
"""Largest length of an arm or fixture; a larger number of metres is an angle or millimetres."""

LARGEST_DEG = 3600.0
"""Sensor angles are continuous and may exceed one turn, but not ten; larger numbers are counts."""


def refuse(text: str, remedy: str = "") -> PydanticCustomError:
    """Return the error with which a schema refuses a value, with a text for the operator."""
    return PydanticCustomError("refused", "{what}", {"what": text, "remedy": remedy})


def in_si(values: Mapping[str, Any]) -> dict[str, Any]:
    """Convert numbers (and tuples of numbers) to SI units, and rename them accordingly: a_mm to a_m."""
    found = {}
    for key, value in values.items():
        match = UNIT.fullmatch(key)
        unit, convert = TO_SI.get(match[2], ("", float)) if match is not None else ("", float)
        if match is None or not unit:
            found[key] = value
        elif isinstance(value, tuple):
            found[f"{match[1]}_{unit}"] = tuple(convert(item) for item in value)
        else:
            found[f"{match[1]}_{unit}"] = convert(value)
    return found


def length_doubt(value_m: float) -> str:
    """Return why a number of metres is implausible, as text; empty if it is plausible."""
    if abs(value_m) <= LONGEST_M:
        return ""
    return (
        f"{value_m:g} m is longer than any arm (limit {LONGEST_M:g} m): "
        "it may be in millimetres or degrees"
    )


def angle_doubt(value_deg: float) -> str:
    """Return why a number of degrees is implausible, as text; empty if it is plausible."""
    if abs(value_deg) <= LARGEST_DEG:
        return ""
    return (
        f"{value_deg:g} deg is more than ten turns (limit {LARGEST_DEG:g} deg): it may be in counts"
    )


def looks_like_radians(value_deg: float) -> bool:
    """Whether a nominal twist given in degrees equals a well-known number of radians (pi/2, pi)."""
    return any(
        math.isclose(abs(value_deg), known, abs_tol=2e-3)
        for known in (0.5 * math.pi, math.pi, 1.5 * math.pi)
    )


def _doubted(doubt: Callable[[float], str], remedy: str) -> AfterValidator:
    """Refuse a value with the doubt about it, unless that is empty."""

    def check(value: float) -> float:
        if said := doubt(value):
            raise refuse(said, remedy)
        return value

    return AfterValidator(check)


def _too_long_mm(value: float) -> str:
    limit = 1e3 * LONGEST_M
    said = f"{value:g} mm is longer than any fixture (limit {limit:g} mm)"
    return said if abs(value) > limit else ""


def _more_than_a_turn(value: float) -> str:
    return f"{value:g} deg is more than a turn" if abs(value) > 360.0 else ""


def _twist_deg(value: float) -> float:
    if looks_like_radians(value):
        raise refuse(f"{value:g} deg looks like radians", f"write {math.degrees(value):.6g}")
    return value


def _stated(limit: float, unit: str) -> Callable[[float], float]:
    """Refuse an implausibly large uncertainty."""

    def check(value: float) -> float:
        if value > limit:
            raise refuse(
                f"{value:g} {unit} is too large for an uncertainty (limit {limit:g} {unit})",
                "write one standard deviation; 0 is exact",
            )
        return value

    return check


def _range(largest: float, smallest: float | None = None) -> WithJsonSchema:
    """Return the JSON Schema equivalent of one of these checks."""
    low = -largest if smallest is None else smallest
    return WithJsonSchema({"type": "number", "minimum": low, "maximum": largest})


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
PositiveNumber = Annotated[Number, Field(gt=0.0)]
NonNegativeNumber = Annotated[Number, Field(ge=0.0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Integer = Annotated[int, Field(strict=True)]
Yes = Annotated[bool, Field(strict=True)]

LengthM = Annotated[Number, _doubted(length_doubt, "write metres, e.g. 0.355"), _range(LONGEST_M)]
LengthMm = Annotated[Number, _doubted(_too_long_mm, "write millimetres"), _range(1e3 * LONGEST_M)]
AngleDeg = Annotated[Number, _doubted(angle_doubt, "write degrees"), _range(LARGEST_DEG)]
"""An angle of a joint: may exceed one turn."""
TurnDeg = Annotated[
    Number, _doubted(_more_than_a_turn, "write degrees between -360 and 360"), _range(360.0)
]
"""An offset: within a turn."""
TwistDeg = Annotated[TurnDeg, AfterValidator(_twist_deg)]
"""A nominal twist: within a turn, and not pi/2."""

StatedMm = Annotated[NonNegativeNumber, AfterValidator(_stated(50.0, "mm")), _range(50.0, 0.0)]
StatedDeg = Annotated[NonNegativeNumber, AfterValidator(_stated(10.0, "deg")), _range(10.0, 0.0)]
StatedMrad = Annotated[
    NonNegativeNumber, AfterValidator(_stated(200.0, "mrad")), _range(200.0, 0.0)
]
"""An uncertainty, as one standard deviation; 0 is exact."""

Text = Annotated[str, StringConstraints(strict=True, strip_whitespace=True, min_length=1)]
ExactText = Annotated[str, StringConstraints(strict=True, min_length=1)]
"""Text kept exactly, with its spaces: a program wrote it and will compare it."""
Name = Annotated[str, StringConstraints(strict=True, pattern=r"^[A-Za-z][A-Za-z0-9_.-]{0,63}$")]


def degrees_for_file(angle_rad: FloatArray | float) -> FloatArray:
    """Degrees whose ``np.deg2rad`` is exactly `angle_rad`; if there is no such double, the nearest.

    If there are several, the one with the fewest digits. An angle that came from a file in degrees always has such a
    double, so that reading, writing and reading again changes no bit.
    """
    wanted = np.asarray(angle_rad, dtype=np.float64)
    degrees = [_degrees(float(value)) for value in wanted.reshape(-1)]
    return np.array(degrees, dtype=np.float64).reshape(wanted.shape)


def _degrees(wanted_rad: float) -> float:
    near = float(np.rad2deg(wanted_rad))
    for digits in (12, 15):
        short = float(f"{near:.{digits}g}")
        if float(np.deg2rad(short)) == wanted_rad:
            return short
    steps = [near]
    for direction in (-np.inf, np.inf):
        step = near
        for _ in range(4):
            step = float(np.nextafter(step, direction))
            steps.append(step)
    return min(steps, key=lambda deg: abs(float(np.deg2rad(deg)) - wanted_rad))


def short_degrees(angle_rad: FloatArray) -> list[float]:
    """Round proposed angles (n,) to 1e-6 deg, so that they can be copied into a file."""
    return [round(angle, 6) + 0.0 for angle in np.rad2deg(angle_rad).tolist()]
