"""Units of numbers in files: lossless conversion to SI units and back, and plausibility checks."""

import math
import re
from collections.abc import Callable, Mapping
from typing import Annotated, Any

import numpy as np
from pydantic import AfterValidator, Field, StringConstraints, WithJsonSchema
from pydantic_core import PydanticCustomError

from operator_app.config.errors import shortened
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
"""Names of units, by the ending of a key."""
UNIT = re.compile(rf"(.+?)_({'|'.join(sorted(UNITS, key=len, reverse=True))})")

TO_SI: Mapping[str, tuple[str, Callable[[float], float]]] = {
    "mm": ("m", lambda value: value / 1e3),
    "mrad": ("rad", lambda value: value / 1e3),
    "deg": ("rad", math.radians),
    "deg_per_s": ("rad_per_s", math.radians),
}

LONGEST_M = 10.0
"""Largest length of an arm or fixture; a larger number was probably written in millimetres or degrees."""

LARGEST_DEG = 3600.0
"""Sensor angles are continuous and may exceed one turn. A number above ten turns is probably in counts."""


def refuse(text: str, remedy: str = "") -> PydanticCustomError:
    """Return the error that a schema raises to refuse a value; `text` and `remedy` are for the operator."""
    return PydanticCustomError("refused", "{what}", {"what": text, "remedy": remedy})


def in_form(
    pattern: str, what: str, remedy: str
) -> tuple[StringConstraints, AfterValidator, WithJsonSchema]:
    """Return annotations for text that must match `pattern`; `what` (name of such text) and `remedy` are for errors."""

    def check(text: str) -> str:
        if not re.fullmatch(pattern, text):
            raise refuse(f"{shortened(text)!r} is not a valid {what}", remedy)
        return text

    schema = {"type": "string", "pattern": f"^{pattern}$"}
    return StringConstraints(strict=True), AfterValidator(check), WithJsonSchema(schema)


def in_si(values: Mapping[str, Any]) -> dict[str, Any]:
    """Return numbers (or tuples of numbers) in SI units, with keys renamed to match: ``a_mm`` becomes ``a_m``."""
    converted = {}
    for key, value in values.items():
        match = UNIT.fullmatch(key)
        if match is None or match[2] not in TO_SI:
            converted[key] = value
            continue
        unit, convert = TO_SI[match[2]]
        in_unit = tuple(map(convert, value)) if isinstance(value, tuple) else convert(value)
        converted[f"{match[1]}_{unit}"] = in_unit
    return converted


TOO_LONG = (
    f"{{:g}} m exceeds the limit for an arm ({LONGEST_M:g} m): it may be in millimetres or an angle"
)
TOO_FAR = f"{{:g}} deg exceeds the limit of ten turns ({LARGEST_DEG:g} deg): it may be in counts"


def length_doubt(value_m: float) -> str:
    """Return why a number of metres is implausible, as text; empty if it is plausible."""
    return TOO_LONG.format(value_m) if abs(value_m) > LONGEST_M else ""


def angle_doubt(value_deg: float) -> str:
    """Return why a number of degrees is implausible, as text; empty if it is plausible."""
    return TOO_FAR.format(value_deg) if abs(value_deg) > LARGEST_DEG else ""


def _limited(
    largest: float, text: str, remedy: str, *, smallest: float | None = None
) -> tuple[AfterValidator, WithJsonSchema]:
    least = -largest if smallest is None else smallest

    def check(value: float) -> float:
        if not least <= value <= largest:
            raise refuse(text.format(value), remedy)
        return value

    schema = {"type": "number", "minimum": least, "maximum": largest}
    return AfterValidator(check), WithJsonSchema(schema)


def _uncertainty(limit: float, unit: str) -> tuple[AfterValidator, WithJsonSchema]:
    text = f"{{:g}} {unit} is too large for an uncertainty (limit {limit:g} {unit})"
    return _limited(limit, text, "write one standard deviation (0: exact)", smallest=0.0)


def _twist_deg(value: float) -> float:
    """Return a nominal twist, deg; refuse a number such as 1.5708 (pi/2), probably in radians."""
    quarters = (0.5 * math.pi, math.pi, 1.5 * math.pi)
    if any(math.isclose(abs(value), known, abs_tol=2e-3) for known in quarters):
        raise refuse(f"{value:g} deg looks like radians", f"write {math.degrees(value):.6g}")
    return value


Number = Annotated[float, Field(strict=True, allow_inf_nan=False)]
PositiveNumber = Annotated[Number, Field(gt=0.0)]
NonNegativeNumber = Annotated[Number, Field(ge=0.0)]
Count = Annotated[int, Field(strict=True, ge=1)]
Whole = Annotated[int, Field(strict=True, ge=0)]
Integer = Annotated[int, Field(strict=True)]
Yes = Annotated[bool, Field(strict=True)]

LengthM = Annotated[Number, *_limited(LONGEST_M, TOO_LONG, "write metres, e.g. 0.355")]
LONGEST_MM = 1e3 * LONGEST_M
TOO_LONG_MM = f"{{:g}} mm exceeds the limit for a fixture ({LONGEST_MM:g} mm)"
LengthMm = Annotated[
    Number, *_limited(LONGEST_MM, TOO_LONG_MM, "check that the value is in millimetres")
]
AngleDeg = Annotated[Number, *_limited(LARGEST_DEG, TOO_FAR, "write degrees")]
"""An angle of a joint, deg; it may exceed one turn."""
BEYOND_A_TURN = "{:g} deg is more than a turn"
TurnDeg = Annotated[Number, *_limited(360.0, BEYOND_A_TURN, "write degrees between -360 and 360")]
"""An offset, deg: between -360 and 360."""
TwistDeg = Annotated[TurnDeg, AfterValidator(_twist_deg)]
"""A nominal twist, deg: within a turn; a number such as 1.5708 (pi/2) is refused, as it is probably in radians."""

StatedMm = Annotated[NonNegativeNumber, *_uncertainty(50.0, "mm")]
StatedDeg = Annotated[NonNegativeNumber, *_uncertainty(10.0, "deg")]
StatedMrad = Annotated[NonNegativeNumber, *_uncertainty(200.0, "mrad")]
"""An uncertainty, as one standard deviation; 0 means that the value is exact."""

Text = Annotated[str, StringConstraints(strict=True, strip_whitespace=True, min_length=1)]
ExactText = Annotated[str, StringConstraints(strict=True, min_length=1)]
"""Text that is kept exactly, including its spaces, because a program wrote the text and will compare it."""
_NAME_RULE = "begin with a letter; use at most 64 letters, digits, _ . or -, without spaces"
Name = Annotated[str, *in_form(r"[A-Za-z][A-Za-z0-9_.-]{0,63}", "name", _NAME_RULE)]


def degrees_for_file(angle_rad: FloatArray | float) -> FloatArray:
    """Return degrees whose ``np.deg2rad`` is exactly `angle_rad` or, if there is no such double, the nearest to it.

    Of several such doubles, the one with the fewest digits is returned. An angle that was read from a file in degrees
    always has such a double, so that writing the angle and reading it again changes no bit.
    """
    target_rad = np.asarray(angle_rad, dtype=np.float64)
    degrees = [_degrees(float(value)) for value in target_rad.reshape(-1)]
    return np.array(degrees, dtype=np.float64).reshape(target_rad.shape)


def _degrees(angle_rad: float) -> float:
    near = float(np.rad2deg(angle_rad))
    for digits in (12, 15):
        short = float(f"{near:.{digits}g}")
        if float(np.deg2rad(short)) == angle_rad:
            return short
    steps = [near]
    for direction in (-np.inf, np.inf):
        step = near
        for _ in range(4):
            step = float(np.nextafter(step, direction))
            steps.append(step)
    return min(steps, key=lambda deg: abs(float(np.deg2rad(deg)) - angle_rad))


def short_degrees(angle_rad: FloatArray) -> list[float]:
    """Return angles (n,) in degrees, rounded to 1e-6 deg, for a proposal that the user copies into a file."""
    return [round(angle, 6) + 0.0 for angle in np.rad2deg(angle_rad).tolist()]
