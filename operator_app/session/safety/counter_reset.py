"""Counters that may have been reset: they read zero, or near zero if the arm has sagged since.

A reset sets a counter to zero at the present position. Hydraulic valves leak, so that the arm, and the counter, may
sag until the next connection.
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
"""Largest reading of a counter that was just reset: the noise of its last bit."""

MAX_SAG_RAD = float(np.deg2rad(5.0))
"""Largest sag since the reset. By chance a joint is rarely this close to zero."""


def counters_near_zero(arm: ArmModel, reading_rad: FloatArray) -> dict[int, float]:
    """Joints (1-based) whose counter is within `MAX_SAG_RAD` of zero, the nearest first.

    The value is the distance in units of `AT_ZERO_COUNTS`, at least 1: the probability of being that close by
    chance is in proportion to it.
    """
    times = {
        j: max(1.0, abs(float(q)) / (AT_ZERO_COUNTS * joint.sensor.resolution_rad))
        for j, (joint, q) in enumerate(zip(arm.joints, reading_rad, strict=True), 1)
        if isinstance(joint.sensor, Encoder) and abs(q) <= MAX_SAG_RAD
    }
    return dict(sorted(times.items(), key=lambda item: item[1]))


def counters_at_zero(arm: ArmModel, reading_rad: FloatArray) -> tuple[int, ...]:
    """Joints (1-based) whose counter reads zero."""
    return tuple(
        sorted(j for j, times in counters_near_zero(arm, reading_rad).items() if times <= 1.0)
    )


def zero_position(arm: ArmModel, reading_rad: FloatArray, joints: Sequence[int]) -> str:
    """Return ``at zero``, or ``near zero`` if one of these joints is not exactly there."""
    return "at zero" if set(joints) <= set(counters_at_zero(arm, reading_rad)) else "near zero"


def check_counters(arm: ArmModel, reading_rad: FloatArray) -> None:
    """Refuse joints whose reading is outside their range and closer to zero than to it.

    Raises
    ------
    ConnectAgainError
    """
    fresh = []
    for number, times in sorted(counters_near_zero(arm, reading_rad).items()):
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
            f"{'; '.join(fresh)}: the counter was reset, as after a loss of power",
            "home the joint, then connect again",
            probability=None,
        )
