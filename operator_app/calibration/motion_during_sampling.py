"""Motion during sampling: readings within one pose that spread by more than sensor noise."""

from __future__ import annotations

import numpy as np

from operator_app.calibration.findings import sensor_name
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Encoder, Rvdt
from solver.diagnostics.limits import MOTION_SPREAD_RAD, MOTION_SPREAD_SIGMAS


def motion_causes(
    arm: ArmModel, poses: PoseSet, unsensed: tuple[int, ...], labels: tuple[str, ...]
) -> tuple[Finding, ...]:
    """Name the joints whose readings spread within poses by more than their sensor's noise, in the poses' own words.

    An RVDT that spreads in most poses is noisy: of that it has a verdict of its own. What moves while it is sampled
    joint by joint closes no loop, and its mean is no pose; the fit itself may not show it.
    """
    if poses.sd_rad is None:
        return ()
    found = []
    for j, joint in enumerate(arm.joints, 1):
        if not isinstance(joint.sensor, Encoder | Rvdt) or j in unsensed:
            continue
        spread = poses.sd_rad[:, j - 1]
        moved = moved_while_read(joint.sensor, spread)
        there = tuple(int(k) for k in np.argsort(-spread, kind="stable") if moved[k])
        if there:
            found.append(
                Finding(
                    kind=FindingKind.MOTION_DURING_SAMPLING,
                    joint=j,
                    sensor=sensor_name(j, arm),
                    poses=tuple(labels[k] for k in there),
                    size=float(spread[there[0]]),
                    unit="rad",
                )
            )
    return tuple(found)


def moved_while_read(sensor: Encoder | Rvdt, spread_rad: FloatArray) -> BoolArray:
    """Poses (m,) whose readings spread (m,), rad, as no noise of this sensor does.

    Noise is what is stated; of an RVDT, whose noise may be worse, what most of the poses show.
    """
    noise = sensor.sigma_rad
    if isinstance(sensor, Rvdt):
        noise = max(noise, float(np.median(spread_rad)))
    return np.asarray(spread_rad > max(MOTION_SPREAD_SIGMAS * noise, MOTION_SPREAD_RAD))
