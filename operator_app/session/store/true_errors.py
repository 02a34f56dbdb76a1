"""True errors of a calibration of a simulated arm, whose true parameters are known."""

import math
from collections.abc import Callable, Mapping
from dataclasses import replace

import numpy as np

from operator_app.calibration.calibrated_arm import (
    calibrated_arm,
    even_poses,
    last_placement,
    with_entries,
)
from operator_app.calibration.result import Solution
from operator_app.calibration.tool_accuracy import TrueErrors
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind
from solver.diagnostics.statistics import intervals
from solver.loops.endpoints import TIP

Truths = Callable[[int], Mapping[str, float]]
"""Function of the number of a placement (from 1); returns the true value, rad or m, of each unknown by name."""


def with_truth(solution: Solution, arm: ArmModel, truths: Truths, *, last: int = 1) -> Solution:
    """Return `solution` with its errors relative to `truths`; `last`: number of the last placement with poses.

    The true tool position error does not include the error of the fixture's placement.
    """
    estimate = solution.identified
    inside, of = 0, 0
    for parameter, x, low, high in zip(
        estimate.parameters, estimate.x.tolist(), *intervals(estimate), strict=True
    ):
        name, _, number = parameter.name.partition("[")
        true = truths(int(number[:-1]) if number else last).get(name)
        if true is None:  # the orientation of a target has no true value with that name
            continue
        error = true - x
        if parameter.is_angle:
            error = math.remainder(error, 2.0 * math.pi)
        of += 1
        inside += bool(low <= x + error <= high)
    # Compare the identified entries: the best table for uncorrected readings also compensates errors of readings.
    calibrated = replace(calibrated_arm(solution, arm), best=None)
    part = last_placement(solution)[0].with_all_joints_sensed()
    values = dict(truths(last))
    tool_side = {
        entry.name: values[entry.name]
        for row in range(1, arm.joint_count + 1)
        for kind in DhKind
        if (entry := DhEntry(kind=kind, row=row)).name not in part.ground_side
    }
    true_arm = replace(
        calibrated,
        hand=with_entries(calibrated.hand, tool_side),
        tip_m=np.array([values.get(n, v) for n, v in zip(TIP, calibrated.tip_m, strict=True)]),
    )
    q = even_poses(arm)
    tip, sigma = calibrated.tip_with_sigma_m(q)
    off_m = np.linalg.norm(tip - true_arm.T_base(q)[:, :3, 3], axis=-1)
    return replace(
        solution,
        truth=TrueErrors(
            inside_95=inside,
            of=of,
            tool_rms_m=float(np.sqrt(np.mean(off_m**2))),
            predicted_rms_m=float(np.sqrt(np.mean(sigma**2))),
        ),
    )
