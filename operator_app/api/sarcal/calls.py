"""Checks of the arguments of the library's functions, and the limit to one BLAS thread.

An error names the argument, its value and the valid values: TypeError for a wrong type, ValueError for a wrong value.
"""

import math
import operator
import reprlib
from collections.abc import Callable, Iterable, Sequence
from contextlib import suppress
from functools import wraps
from threading import Lock
from typing import Any, ParamSpec, TypeVar

import numpy as np
from numpy.typing import NDArray

from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel

WholeNumbers = Sequence[int] | NDArray[np.integer[Any]]
"""Whole numbers, such as joint numbers: a sequence or an array."""

LARGEST_TOLERANCE_MM = 100.0
"""Largest permitted standard deviation of lengths, as for ``--length-tolerance``."""

LONGEST_SHOWN = 80
"""Maximum number of characters of a value in an error message."""


def shown(value: Any) -> str:
    """Return a value as one short line of text."""
    short = reprlib.Repr()
    short.maxother = short.maxstring = LONGEST_SHOWN
    return " ".join(short.repr(value).split())


def whole(name: str, value: Any, *, least: int = 0) -> int:
    """Return a whole number after checking that it is `least` or more."""
    expected = f"give a whole number, {least} or more"
    if isinstance(value, bool | np.bool_):
        raise TypeError(f"{name}={value}: {expected}")
    try:
        number_read = operator.index(value)
    except TypeError:
        raise TypeError(f"{name}={shown(value)}: {expected}") from None
    if number_read < least:
        raise ValueError(f"{name}={number_read}: {expected}")
    return number_read


def numbers(name: str, value: Any) -> FloatArray:
    """Return an array of floats after checking that all numbers are real and finite."""
    if np.ma.is_masked(value):
        raise ValueError(
            f"{name} has masked entries: every number must be known (leave out poses without readings)"
        )
    if value is None:
        raise TypeError(f"{name}: give real numbers, not None")
    try:
        array = np.asarray(value)
    except ValueError:
        raise ValueError(
            f"{name}: rows of different lengths; give the same number of values in each"
        ) from None
    if array.dtype.kind == "O":
        with suppress(TypeError, ValueError):
            array = array.astype(np.float64)
    if array.dtype.kind not in "iuf":
        kind = "complex numbers" if array.dtype.kind == "c" else shown(value)
        raise TypeError(f"{name}: give real numbers, not {kind}")
    array = array.astype(np.float64)
    if not np.isfinite(array).all():
        where = [int(k) for k in np.argwhere(~np.isfinite(array))[0]]
        place = f" at index {where[0] if len(where) == 1 else where}" if where else ""
        remedy = " (leave out poses without readings)" if where else ""
        raise ValueError(
            f"{name} contains {array[tuple(where)]}{place}: every number must be finite{remedy}"
        )
    return array


def number(name: str, value: Any) -> float:
    """Return a number after checking that it is real and finite."""
    array = numbers(name, value)
    if array.ndim:
        raise TypeError(f"{name} has shape {array.shape}: give one number")
    return float(array)


def tolerance_m(name: str, value_mm: Any) -> float | None:
    """Convert a standard deviation of lengths from mm to m; None stays None."""
    if value_mm is None:
        return None
    tolerance_mm = number(name, value_mm)
    if not 0.0 < tolerance_mm <= LARGEST_TOLERANCE_MM:
        raise ValueError(
            f"{name}={value_mm}: give millimetres, more than 0 and at most {LARGEST_TOLERANCE_MM:g}"
        )
    return tolerance_mm / 1e3


def joints(name: str, value: Any, joint_count: int) -> tuple[int, ...]:
    """Return joint numbers (from 1) after checking them, in ascending order, without repetition."""
    expected = f"give a list of joint numbers from 1 to {joint_count}, such as [6, 7]"
    if isinstance(value, str | bytes) or not isinstance(value, Iterable):
        raise TypeError(f"{name}={shown(value)}: {expected}")
    chosen = set()
    for joint in value:
        try:
            chosen.add(whole(name, joint))
        except (TypeError, ValueError) as error:
            raise type(error)(f"{name} contains {joint!r}: {expected}") from None
    if wrong := chosen.difference(range(1, joint_count + 1)):
        raise ValueError(f"{name} contains {min(wrong)}: {expected}")
    return tuple(sorted(chosen))


def one_of(name: str, value: Any, choices: tuple[str, ...]) -> None:
    """Raise ValueError if a value is not one of the choices."""
    if value not in choices:
        raise ValueError(f"{name}={shown(value)}: give {' or '.join(map(repr, choices))}")


def readings_rad(q_rad: Any, arm: ArmModel) -> FloatArray:
    """Return sensor readings (n,) or (m, n), rad; refuse readings more than a turn beyond the joint ranges."""
    readings, lower_rad, upper_rad = numbers("q_rad", q_rad), arm.lower_rad, arm.upper_rad
    if readings.ndim == 0 or readings.shape[-1] != arm.joint_count:
        shape = required_shape(readings.shape, arm.joint_count)
        raise ValueError(f"q_rad has shape {readings.shape}: {shape}")
    far = np.argwhere((readings < lower_rad - math.tau) | (readings > upper_rad + math.tau))
    if len(far):
        q, joint = readings[tuple(far[0])], int(far[0][-1])
        raise ValueError(
            f"q_rad contains {q:g} rad for joint {joint + 1}, whose range is {lower_rad[joint]:.3g} to "
            f"{upper_rad[joint]:.3g} rad: convert degrees to radians with np.deg2rad"
        )
    return readings


def required_shape(shape: tuple[int, ...], joint_count: int) -> str:
    """Return the required shape of readings, as text."""
    turned = len(shape) == 2 and shape[0] == joint_count
    return (
        f"the arm has {joint_count} joints; give one column per joint, in the arm's order, and one row per pose"
        f"{' (transpose the array with .T)' if turned else ''}"
    )


_limiting = Lock()
"""Held while a call limits the BLAS threads."""

P = ParamSpec("P")
R = TypeVar("R")


def one_blas_thread(function: Callable[P, R]) -> Callable[P, R]:
    """Return a function that runs `function` with one BLAS thread.

    With matrices of only some tens of rows, several threads wait for each other. On busy cores, a call then takes
    seconds instead of a third of a second. The limit applies to the whole process until `function` returns. If calls
    overlap, only the first one sets and removes the limit. A second one would later restore the limited state.
    """

    @wraps(function)
    def limited(*args: P.args, **kwargs: P.kwargs) -> R:
        import scipy.linalg  # noqa: F401 - its BLAS must be loaded before it can be limited
        from threadpoolctl import threadpool_limits

        if not _limiting.acquire(blocking=False):
            return function(*args, **kwargs)
        try:
            with threadpool_limits(limits=1, user_api="blas"):
                return function(*args, **kwargs)
        finally:
            _limiting.release()

    return limited
