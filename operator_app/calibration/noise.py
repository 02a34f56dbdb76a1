"""What is random about a pose set: sensors by their specification, and which variances to estimate.

Knows arms, fixtures and pose sets; estimates nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Mapping
from dataclasses import replace

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.loop import instrument_variance
from solver.arrays import BoolArray, FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, nominal_vector
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor
from solver.errors import SolverError
from solver.estimators.component_model import ComponentPlan, plan_of
from solver.estimators.implicit import NoiseModel
from solver.estimators.variance_components import VarianceComponents
from solver.loops.closure import ClosureModel

DOF_FOR_COMPONENTS = 10
"""With fewer degrees of freedom no variance can be estimated beside the parameters: the sensors'
specifications are believed."""


def noise_model(arm: ArmModel, fixture: Fixture, poses: PoseSet, kept: BoolArray) -> NoiseModel:
    """Return what the sensors' specifications say of the mean readings of the kept poses."""
    samples = np.ones(len(poses), dtype=np.int64) if poses.samples is None else poses.samples
    variance = np.array(
        [
            [
                0.0 if isinstance(j.sensor, NoSensor) else j.sensor.variance_of_mean_rad2(int(n))
                for j in arm.joints
            ]
            for n in samples[kept]
        ]
    )
    return NoiseModel(joint_variance=variance, fixture_variance=instrument_variance(fixture))


def component_plan(
    arm: ArmModel,
    unsensed_joints: tuple[int, ...],
    fixture: Fixture,
    *,
    dof: int,
    tolerance: Mapping[str, float] | None = None,
) -> ComponentPlan:
    """Return which variances to estimate: noise and curve of each used RVDT, give of the fixture.

    Parameters
    ----------
    dof
        Degrees of freedom there are.
    tolerance
        How well parameters are known beforehand (m, rad) by name, see `soften`.
    """
    soft = {} if tolerance is None else tolerance
    if dof < DOF_FOR_COMPONENTS:
        return ComponentPlan(flexure=False, tolerance=soft)
    plan = plan_of(arm, unsensed_joints=unsensed_joints)
    return replace(plan, flexure=fixture.kind != "measured", tolerance=soft)


class ToleranceError(SolverError):
    """Link lengths of this loop cannot be given a tolerance."""


def soften(model: ClosureModel, tolerance_m: float) -> tuple[ClosureModel, dict[str, float]]:
    """Free the arm's link lengths within a tolerance: the maker's table is not exact (section 4).

    Returns
    -------
    The loop with lengths of links 1..n-1 free as well, and the tolerance of each by name. Lengths
    that are free already keep no tolerance. ToleranceError if the loop is no D-H loop.
    """
    if model.dh_table(nominal_vector(model.parameters)) is None:
        raise ToleranceError(
            "a length tolerance needs a hinge or a rigid fixture and one placement"
        )
    lengths = [
        DhEntry(kind, row)
        for kind in (DhKind.A, DhKind.S)
        for row in range(1, model.joint_count)
        if DhEntry(kind, row) not in model.entries
    ]
    return model.freed(lengths), {entry.name: tolerance_m for entry in lengths}


def without_known_errors(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    *,
    tolerated: Collection[str],
    components: VarianceComponents,
) -> tuple[ClosureModel, FloatArray, FloatArray]:
    """Take out what was found of the curves and the lengths, so that only noise is left to judge.

    Returns
    -------
    The loop with its lengths as found and no longer free, its parameters, and readings (m, n) less
    the predicted curves.
    """
    straight = q.copy()
    for joint, curve in components.curves_rad.items():
        straight[:, joint - 1] -= curve
    table = model.dh_table(x)
    if not tolerated or table is None:
        return model, x, straight
    kept = [k for k, p in enumerate(model.parameters) if p.name not in tolerated]
    return model.with_table(table).without(tolerated), x[kept], straight
