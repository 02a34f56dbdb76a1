"""Whether the drive joints can go straight from where the arm stands, by a calibrated loop. Knows no arm in motion.

Where a procedure says where its drives may go, somebody has looked for folds and stops in there. Where it
leaves that to the program, a straight way may lead over a fold, at which the drives push against the
fixture until one of them trips: then the loop is asked first.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from operator_app.planning.task import STOP_MARGIN_RAD, ranges_of
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.closing import close_loops
from solver.design.drive_line import drive_straight
from solver.design.paths import LINE_STEP_RAD, MotionLimits
from solver.loops.closure import ClosureModel


def is_clear(
    arm: ArmModel,
    model: ClosureModel,
    x: FloatArray,
    here_rad: FloatArray,
    targets_rad: Mapping[int, float],
) -> bool:
    """Whether drives that go straight to `targets_rad` keep away from folds and from the ends of ranges.

    Parameters
    ----------
    model, x
        A closed loop and its parameters (P,), as calibrated.
    here_rad
        Where all joints stand (n,).
    """
    limits, drives = MotionLimits(), tuple(targets_rad)
    start = close_loops(model, x, here_rad[None, :])
    goal = np.array([list(targets_rad.values())])
    way = float(np.abs(goal - here_rad[[j - 1 for j in drives]]).max())
    traces = drive_straight(
        model, x, start.q, start.u, drives, goal, steps=max(1, int(np.ceil(way / LINE_STEP_RAD)))
    )
    safe = traces.safe(
        ranges_of(arm).within(STOP_MARGIN_RAD),
        least_leverage=limits.least_leverage,
        most_rate=limits.most_rate,
    )
    return bool(start.closed[0] and safe[0])
