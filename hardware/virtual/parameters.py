"""What a parameter document must say to be taken by this arm. Knows arms and limits, no schema and no bus.

The strict parse is given from outside: the schema belongs to the operator's program.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from dataclasses import dataclass

from hardware.virtual.axis import AxisSettings


@dataclass(frozen=True, slots=True, kw_only=True)
class ValidatedParameters:
    """What the controller takes from a document that passed the strict schema.

    Attributes
    ----------
    arm_serial
        Serial number of the arm it was made for.
    home_offset_counts
        607Ch of joints 1..n.
    theta_off_rad
        The same offsets in radians, joints 1..n.
    """

    arm_serial: str
    home_offset_counts: tuple[int, ...]
    theta_off_rad: tuple[float, ...]


Validate = Callable[[bytes], ValidatedParameters]
"""Parses a document; raises `ValueError` with words for the operator."""


def takes_no_documents(_document: bytes) -> ValidatedParameters:
    """A `Validate` for a controller that was given no schema: refuses everything."""
    raise ValueError("this controller was started without a parameter schema and takes no document")


def objection(
    parameters: ValidatedParameters, axes: Sequence[AxisSettings], serial_number: str
) -> str | None:
    """Why this arm cannot take the parameters, in words, or None."""
    if parameters.arm_serial != serial_number:
        return f"the document is for arm {parameters.arm_serial}, this is arm {serial_number}"
    joints = len(axes)
    counts, angles = parameters.home_offset_counts, parameters.theta_off_rad
    if len(counts) != joints or len(angles) != joints:
        return f"{len(counts)} home offsets and {len(angles)} angles for {joints} joints"
    for axis, offset, angle in zip(axes, counts, angles, strict=True):
        if not math.isfinite(angle):
            return f"theta_off of joint {axis.joint} is not a finite number"
        limit = axis.home_offset_limit_counts
        if abs(offset) > limit:
            return f"home offset {offset} of joint {axis.joint} is beyond +-{limit} counts"
        if abs(angle * axis.scale.counts_per_rad - offset) > 1.0:
            return (
                f"home offset {offset} of joint {axis.joint} is not its theta_off, which is "
                f"{angle * axis.scale.counts_per_rad:.1f} counts"
            )
    return None
