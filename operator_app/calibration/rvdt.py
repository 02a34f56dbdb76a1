"""What poses of any fixture say of the arm's RVDTs: a verdict each, or why there can be none.

Knows arms, fixtures and pose sets; the judging itself is `solver.judging.rvdt`.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.loop import loop_of_poses
from operator_app.calibration.noise import error_model, samples_of, soften
from solver.arrays import BoolArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Rvdt
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import VarianceComponents
from solver.judging.identifiability import identifiability
from solver.judging.rvdt import RvdtVerdict, rvdt_verdicts, undecided
from solver.judging.rvdt_noise import SingleNoise, single_noise


def judge_rvdts(
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    kept: BoolArray,
    estimate: Estimate,
    components: VarianceComponents,
    *,
    held: tuple[str, ...] = (),
    length_tolerance_m: float | None = None,
) -> tuple[RvdtVerdict, ...]:
    """Judge every RVDT by its noise and by the loops of one placement."""
    sensors = {
        j: joint.sensor for j, joint in enumerate(arm.joints, 1) if isinstance(joint.sensor, Rvdt)
    }
    if not sensors:
        return ()
    noise = _noise_of_rvdts(sensors, poses, kept, components)

    def none_decided(reason: str) -> tuple[RvdtVerdict, ...]:
        return tuple(undecided(j, s, reason, noise.get(j)) for j, s in sensors.items())

    if len(poses.placements) > 1:
        return none_decided("it is measured on one placement only: solve one placement alone")
    blind = tuple(sorted({*sensors, *arm.unsensed_joints}))
    whole = loop_of_poses(arm, fixture, poses, unsensed_joints=blind)
    model = whole.at_poses(np.flatnonzero(kept)).without(held)
    q = poses.q_rad[kept]
    without = f"without the readings of {_joints_named(tuple(sensors))}"
    if len(q) * model.equations_per_pose <= len(model.parameters):
        return none_decided(f"{without} these poses are too few: take more")
    known = {p.name: float(v) for p, v in zip(estimate.parameters, estimate.x, strict=True)}
    hard = np.array([known.get(p.name, p.nominal) for p in model.parameters])
    unseen = identifiability(model, hard, q, sigma_rad=arm.sigma_rad()).directions
    if unseen:
        names = ", ".join(dict.fromkeys(d.parameters[0] for d in unseen))
        return none_decided(f"{without} these poses leave {names} open: judge it in the hinge")
    model, tolerance = soften(model, arm, length_tolerance_m=length_tolerance_m, held=held)
    x0 = np.array([known.get(p.name, p.nominal) for p in model.parameters])
    errors = error_model(arm, fixture, poses, kept, unsensed_joints=blind, tolerance=tolerance)
    samples = samples_of(poses)[kept]
    return rvdt_verdicts(model, arm, q, errors, noise=noise, samples=samples, x0=x0)


def _noise_of_rvdts(
    sensors: Mapping[int, Rvdt],
    poses: PoseSet,
    kept: BoolArray,
    components: VarianceComponents,
) -> dict[int, SingleNoise]:
    """Noise of single readings, by joint, where anything tells of it."""
    by_name = {c.name: c for c in components.components}
    samples = samples_of(poses)[kept]
    found = {
        j: single_noise(
            sensor,
            by_name.get(f"rvdt_{j}"),
            None if poses.sd_rad is None else poses.sd_rad[kept, j - 1],
            samples,
        )
        for j, sensor in sensors.items()
    }
    return {j: noise for j, noise in found.items() if noise is not None}


def _joints_named(joints: tuple[int, ...]) -> str:
    return f"joint{'s' if len(joints) > 1 else ''} {' and '.join(str(j) for j in joints)}"
