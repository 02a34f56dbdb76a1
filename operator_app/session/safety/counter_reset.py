"""Counters that may have begun anew: they stand at zero, or near it where the arm has sagged since. Knows no loop.

A counter that begins anew does so where the arm stands. Hydraulic valves leak: until somebody connects, the arm
may have sagged, and the counter with it.
"""

from __future__ import annotations

from collections.abc import Sequence

import numpy as np

from operator_app.errors import ConnectAgainError
from operator_app.units.figure import POSITION, SPAN
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder

AT_ZERO_COUNTS = 2.5
"""A counter that has just begun anew, and the noise of its last bit."""

SAGGED_RAD = float(np.deg2rad(5.0))
"""As far as this an arm may have sagged since; a joint is farther from zero nearly everywhere."""


def from_zero(arm: ArmModel, reading_rad: FloatArray) -> dict[int, float]:
    """Joints (1-based) whose counter is not farther from zero than an arm sags, the nearest first.

    Of each how many times as far as a counter that has just begun anew: by chance a joint stands as near as that so
    many times as often as at zero.
    """
    times = {
        j: max(1.0, abs(float(q)) / (AT_ZERO_COUNTS * joint.sensor.resolution_rad))
        for j, (joint, q) in enumerate(zip(arm.joints, reading_rad, strict=True), 1)
        if isinstance(joint.sensor, Encoder) and abs(q) <= SAGGED_RAD
    }
    return dict(sorted(times.items(), key=lambda item: item[1]))


def at_zero(arm: ArmModel, reading_rad: FloatArray) -> tuple[int, ...]:
    """Joints (1-based) whose counter stands at zero."""
    return tuple(sorted(j for j, times in from_zero(arm, reading_rad).items() if times <= 1.0))


def where_near(arm: ArmModel, reading_rad: FloatArray, joints: Sequence[int]) -> str:
    """``at zero``, or ``near zero`` where one of these joints has left it."""
    return "at zero" if set(joints) <= set(at_zero(arm, reading_rad)) else "near zero"


def check_counters(arm: ArmModel, reading_rad: FloatArray) -> None:
    """Refuse joints whose counter stands where the joint cannot be, nearer to zero than to their range.

    Raises
    ------
    ConnectAgainError
    """
    fresh = []
    for number, times in sorted(from_zero(arm, reading_rad).items()):
        joint, q = arm.joints[number - 1], float(reading_rad[number - 1])
        beyond = max(joint.lower_rad - q, q - joint.upper_rad)
        if beyond > abs(q):
            reads = POSITION(q).with_unit if times > 1.0 else "0.000 deg"
            fresh.append(
                f"joint {number} reads {reads}, outside its range "
                f"{SPAN(joint.lower_rad).shown} .. {SPAN(joint.upper_rad).with_unit}"
            )
    if fresh:
        raise ConnectAgainError(
            f"{'; '.join(fresh)}: its counter began anew, as after a loss of power",
            "home the joint, then connect again",
            probability=None,
        )
