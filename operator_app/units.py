"""Formats of numbers: quantity, unit, digits and role, all defined here.

Text, page and screen show `Figure.shown`; JSON has `Figure.in_json` under `Figure.key`. Quantities shown in several
places have a `Kind` in this module.
"""

import math
import re
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from typing import Protocol

Key = tuple[str | int, ...]

MOST_WHOLE = 2**53
"""Largest whole number in files and options: not all larger ones are exact as double-precision numbers."""


@dataclass(frozen=True, slots=True)
class Quantity:
    """A display unit; `per_si` and `json_per_si` convert from SI to this unit and to the unit in JSON."""

    unit: str
    per_si: float = 1.0
    json_per_si: float = 1.0


ANGLE = Quantity("deg", 180.0 / math.pi, 180.0 / math.pi)
LENGTH = Quantity("mm", 1e3, 1.0)
CLOSURE_ANGLE = Quantity("mrad", 1e3, 1e3)
CLOSURE_LENGTH = Quantity("mm", 1e3, 1e3)
NOISE_ANGLE = Quantity("mdeg", 180e3 / math.pi)
SHARE = Quantity("%", 100.0)
LSB = Quantity("LSB")
COUNTS = Quantity("counts")
SPEED = Quantity("deg/s", 180.0 / math.pi)
TORQUE = Quantity("Nm")
TIME = Quantity("s")
AGE = Quantity("ms", 1e3)
NUMBER = Quantity("")


class Valued(Protocol):
    """A parameter, or the change of a parameter between calibrations: an angle (rad) or a length (m)."""

    @property
    def is_angle(self) -> bool:
        """Whether the value is an angle."""


def quantity_of(parameter: Valued) -> Quantity:
    """Return the display unit of a parameter: `ANGLE` or `LENGTH`."""
    return ANGLE if parameter.is_angle else LENGTH


def in_json(parameter: Valued, value: float) -> float | None:
    """Return a parameter's value in the units of the JSON output, deg and m; None if it is not finite."""
    return Figure(float(value), quantity_of(parameter)).in_json


@dataclass(frozen=True, slots=True)
class Figure:
    """A number for display and JSON.

    Attributes
    ----------
    value
        Value in SI units; None or not finite if unknown.
    places, digits
        Number of decimal places or, if `places` is None, of significant digits.
    role
        Role of the text: ``text``, ``found`` (an identified value) or ``warn``.
    key
        Path of the number in the JSON object; empty if the number is not in JSON.
    """

    value: float | None
    quantity: Quantity = NUMBER
    places: int | None = None
    digits: int = 3
    signed: bool = False
    role: str = "text"
    key: Key = ()

    @property
    def shown(self) -> str:
        """The number as shown, without its unit."""
        if self.value is None:
            return NOT_AVAILABLE
        value = self.quantity.per_si * self.value
        if self.places is None:
            return significant(value, self.digits)
        return fixed(value, self.places, signed=self.signed)

    @property
    def with_unit(self) -> str:
        """The number with its unit."""
        return f"{self.shown} {self.quantity.unit}".rstrip()

    @property
    def in_json(self) -> float | None:
        """The number at full precision, in the units of the JSON output; None if unknown."""
        if self.value is None or not math.isfinite(self.value):
            return None
        factor = self.quantity.json_per_si
        return self.value if factor == 1.0 else factor * self.value  # counts stay integers


@dataclass(frozen=True, slots=True)
class Kind:
    """Display format of one kind of quantity; called with a value in SI units, it returns a `Figure`."""

    quantity: Quantity
    places: int | None = None
    digits: int = 3
    signed: bool = False

    def __call__(self, value: float | None, *, role: str = "text", key: Key = ()) -> Figure:
        """Return a value in SI units as a `Figure` in the format of this `Kind`."""
        return Figure(
            value, self.quantity, self.places, self.digits, signed=self.signed, role=role, key=key
        )

    def not_zero(self, value: float) -> Figure:
        """Return the figure of a value, with enough digits that a non-zero value is not shown as zero."""
        shown = abs(self.quantity.per_si * value)
        if self.places is None or not 0.0 < shown < 0.5 * 10.0**-self.places:
            return self(value)
        places = math.ceil(-math.log10(shown))
        return Figure(value, self.quantity, places, signed=self.signed)


# Calibration.
SIGMA_POS = Kind(CLOSURE_LENGTH, digits=4)
SIGMA_ORI = Kind(CLOSURE_ANGLE, digits=4)
CONDITION = Kind(NUMBER)
CHI2 = Kind(NUMBER)
COST = Kind(NUMBER, digits=5)
PREDICTED = Kind(CLOSURE_LENGTH, places=3)
"""Closure error of a pose, calculated with the estimate from the earlier poses."""

# Arm.
POSITION = Kind(ANGLE, places=3, signed=True)
TARGET = Kind(ANGLE, places=2, signed=True)
REACH = Kind(ANGLE, places=1, signed=True)
SPAN = Kind(ANGLE, places=1)
WHOLE_DEGREES = Kind(ANGLE, places=0)
WHOLE_MM = Kind(LENGTH, places=0)
MOVED = Kind(ANGLE, places=1, signed=True)
SLIP_SIGMA = Kind(ANGLE, places=3)
SHIFTED = Kind(LENGTH, places=1)
TURNED = Kind(ANGLE, places=2)
JOINT_SPEED = Kind(SPEED, places=2, signed=True)
JOINT_TORQUE = Kind(TORQUE, places=1, signed=True)
READING_SD = Kind(ANGLE, places=4)

# Fixture file.
NOMINAL_LENGTH = Kind(LENGTH, places=0)
MOUNTED_LENGTH = Kind(LENGTH, places=1)
NOMINAL_TWIST = Kind(ANGLE, places=1)
NOMINAL_OFFSET = Kind(ANGLE, places=2)
LENGTH_TOLERANCE = Kind(LENGTH, digits=2)
ANGLE_TOLERANCE = Kind(ANGLE, digits=2)

# Comparisons.
ENTRY_ANGLE = Kind(ANGLE, places=4)
ENTRY_LENGTH = Kind(LENGTH, places=4)
SIGMAS = Kind(NUMBER, digits=2)

# Faults.
STEP = Kind(ANGLE, places=4, signed=True)
"""Step of a reading, with enough decimal places to show a step of a few counts."""
LOST_COUNTS = Kind(COUNTS, places=0, signed=True)
LOST_LSB = Kind(LSB, places=0, signed=True)
SCATTER = Kind(ANGLE, places=3)
DEVIATION = Kind(ANGLE, places=2)
READING = Kind(ANGLE, places=2)
GREW = Kind(LENGTH, places=2, signed=True)
OFF_LENGTH = Kind(LENGTH, places=1, signed=True)
FAR_ANGLE = Kind(ANGLE, places=0, signed=True)
FAR_LENGTH = Kind(LENGTH, places=0, signed=True)
DEFLECTION_ANGLE = Kind(CLOSURE_ANGLE, digits=2)
DEFLECTION_LENGTH = Kind(CLOSURE_LENGTH, digits=2)
OF_FULL_SCALE = Kind(SHARE, places=1)
OFF_SCALE = Kind(SHARE, places=1, signed=True)
LINEARITY = Kind(SHARE, digits=2)
PERCENT = Kind(SHARE, places=0)
TIMES = Kind(NUMBER, places=1)
MANY_TIMES = Kind(NUMBER, places=0)
POS_LIMIT = Kind(CLOSURE_LENGTH, places=2)
ORI_LIMIT = Kind(CLOSURE_ANGLE, places=2)

# Times.
DATA_AGE = Kind(AGE, places=0)
SILENCE = Kind(TIME, places=1)


MINUS = "\N{MINUS SIGN}"
NOT_AVAILABLE = "n/a"
SUPERSCRIPTS = str.maketrans("-0123456789", "⁻⁰¹²³⁴⁵⁶⁷⁸⁹")


def fixed(value: float, places: int, *, signed: bool = False) -> str:
    """Return `value` with this many decimal places; zero has no sign."""
    if not math.isfinite(value):
        return NOT_AVAILABLE
    # Rounded first, so that zero has no sign.
    rounded = round(value, places) + 0.0
    return f"{rounded:{'+' if signed and rounded > 0.0 else ''}.{places}f}"


def significant(value: float, digits: int = 3) -> str:
    """Return `value` with this many significant digits, with a power of ten instead of many zeros."""
    if not math.isfinite(value):
        return "infinite" if value == math.inf else NOT_AVAILABLE
    if value == 0.0:
        return "0"
    written = f"{value:.{digits - 1}e}"
    power = int(written.partition("e")[2])
    return fixed(value, max(0, digits - 1 - power)) if -4 <= power < 5 else written


def typeset(text: str) -> str:
    """Return `text` with typographic minus signs and with powers of ten as superscripts."""
    raised = re.sub(
        r"(?<=\d)e([+-]\d+)\b", lambda m: "·10" + str(int(m[1])).translate(SUPERSCRIPTS), text
    )
    return re.sub(r"(?<![\w-])-(?=\d)", MINUS, raised)


def places_to_show(precisions: Iterable[float], *, least: int = 1, most: int = 9) -> int:
    """Return how many decimal places (`least` to `most`) show two digits of the finest precision above 0."""
    finest = min((p for p in precisions if math.isfinite(p) and p > 0.0), default=0.0)
    if finest == 0.0:
        return least
    return min(most, max(least, 1 - math.floor(math.log10(finest))))


def places_needed(values: Iterable[float], *, least: int, most: int) -> int:
    """Return the fewest decimal places, from `least` to `most`, that show all `values` exactly; `most` if none do."""
    listed = list(values)
    return next(
        (n for n in range(least, most) if all(abs(v - round(v, n)) < 1e-9 for v in listed)), most
    )


def plural(count: int, noun: str) -> str:
    """Return a number with its noun, such as ``1 pose`` or ``2 poses``."""
    return f"{count} {noun}{'' if count == 1 else 's'}"


def joints_named(joints: Sequence[int]) -> str:
    """Return joints as text, such as ``joint 5`` or ``joints 1 and 5``."""
    return f"joint{'s' if len(joints) > 1 else ''} {names(joints)}"


def others_free(driven: int, joint_count: int) -> str:
    """Return the end of a list of `driven` joints (a count): ", the others free", or "" if all joints are driven."""
    return "" if driven == joint_count else ", the others free"


def names(items: Iterable[object]) -> str:
    """Return items as text, such as ``1, 2 and 3``."""
    listed = [str(item) for item in items]
    return " and ".join(filter(None, (", ".join(listed[:-1]), *listed[-1:])))
