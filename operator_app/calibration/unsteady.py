"""Joints that moved or shook while a pose was read: the spread of their readings says so. Knows no loop, no screen."""

from __future__ import annotations

import numpy as np

from operator_app.calibration.causes import NamedCause, poses_named
from operator_app.units.figure import SCATTER
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Encoder

SIGMAS = 6.0
"""A spread by so many times the noise of a single reading is no noise."""

LEAST_RAD = np.deg2rad(0.05)
"""And a smaller one averages out to what encoders are off anyway."""


def unsteady(
    arm: ArmModel, poses: PoseSet, unsensed: tuple[int, ...], labels: tuple[str, ...]
) -> tuple[NamedCause, ...]:
    """Name the encoders whose readings spread within poses by more than their noise, in the poses' own words.

    RVDTs have a verdict of their own. What moves while it is sampled joint by joint closes no loop, and its mean
    is no pose; the fit itself may not show it.
    """
    if poses.sd_rad is None:
        return ()
    found = []
    for j, joint in enumerate(arm.joints, 1):
        if not isinstance(joint.sensor, Encoder) or j in unsensed:
            continue
        spread = poses.sd_rad[:, j - 1]
        order = np.argsort(-spread, kind="stable")
        least = max(SIGMAS * joint.sensor.sigma_rad, LEAST_RAD)
        there = tuple(int(k) for k in order if spread[k] > least)
        if there:
            size = SCATTER(float(spread[there[0]])).with_unit
            found.append(
                NamedCause(
                    code=f"UNSTEADY_{j}",
                    probability=1.0,
                    text=f"the readings of joint {j} spread by up to {size} within {poses_named(there, labels)}, more "
                    "than its encoder's noise: it moved or shook while it was read",
                    remedy="wait until the arm has settled, look for vibration, and take these poses again",
                    refuses=False,
                )
            )
    return tuple(found)
