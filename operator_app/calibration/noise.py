"""What is random about a pose set: everything the arm's and the fixture's files state, as one error model.

Knows arms, fixtures and pose sets; estimates nothing.
"""

from __future__ import annotations

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.loop import instrument_variance
from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, nominal_vector
from solver.chain.poses import PoseSet
from solver.chain.sensors import NoSensor
from solver.estimators.error_model import ErrorModel, stated_errors
from solver.estimators.implicit import NoiseModel
from solver.estimators.variance_components import VarianceComponents
from solver.loops.closure import ClosureModel


def error_model(
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    kept: BoolArray | IntArray,
    *,
    unsensed_joints: tuple[int, ...] = (),
    tolerance: Mapping[str, float] | None = None,
) -> ErrorModel:
    """Return what the files state of the kept poses; `tolerance` is that of `soften`."""
    errors = stated_errors(
        arm,
        samples=samples_of(poses)[kept],
        sd_rad=None if poses.sd_rad is None else poses.sd_rad[kept],
        unsensed_joints=unsensed_joints,
    )
    endpoint = instrument_variance(fixture)
    held = fixture.kind != "measured"
    return replace(
        errors,
        endpoint_variance=np.zeros(6) if endpoint is None else endpoint,
        give_rad=fixture.give.orientation_rad if held else None,
        give_m=fixture.give.position_m if held else None,
        tolerance={} if tolerance is None else tolerance,
        discrepancy=True,
    )


def noise_model(
    arm: ArmModel, fixture: Fixture, poses: PoseSet, kept: BoolArray | IntArray
) -> NoiseModel:
    """Return what the sensors' specifications say of the mean readings of the kept poses."""
    variance = np.array(
        [
            [
                0.0 if isinstance(j.sensor, NoSensor) else j.sensor.variance_of_mean_rad2(int(n))
                for j in arm.joints
            ]
            for n in samples_of(poses)[kept]
        ]
    )
    return NoiseModel(joint_variance=variance, fixture_variance=instrument_variance(fixture))


def samples_of(poses: PoseSet) -> IntArray:
    """Readings in the mean of each pose (m,); one where the file does not say."""
    return np.ones(len(poses), dtype=np.int64) if poses.samples is None else poses.samples


def first_of_each(poses: PoseSet, kept: BoolArray) -> tuple[IntArray, IntArray]:
    """Indices of kept poses that differ, and for every kept pose which of those it is.

    The very same readings to the last digit are the same reading written twice, and know nothing
    that one of them does not.
    """
    here = np.flatnonzero(kept)
    columns = [poses.placement[here, None].astype(float), poses.q_rad[here]]
    if poses.endpoint is not None:
        columns.append(poses.endpoint[here])
    _, first, which = np.unique(
        np.column_stack(columns), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    rank = np.empty_like(order)
    rank[order] = np.arange(len(order))
    return here[first[order]], rank[which.reshape(-1)]


def soften(
    model: ClosureModel,
    arm: ArmModel,
    *,
    length_tolerance_m: float | None = None,
    held: Collection[str] = (),
) -> tuple[ClosureModel, dict[str, float]]:
    """Free the arm's lengths and twists within their tolerances: the maker's table is not exact.

    Parameters
    ----------
    length_tolerance_m
        Standard deviation of all lengths, instead of what the arm's file states.
    held
        Entries that are to keep their nominal values.

    Returns
    -------
    The loop with these entries free as well, and the standard deviation (m, rad) of each by name.
    Entries that are free already, and those that the fixture determines, get none.
    """
    part = model.parts()[0][0]
    n = arm.joint_count
    length = (
        arm.length_tolerance_m if length_tolerance_m is None else np.full(n, length_tolerance_m)
    )
    found: dict[DhEntry, float] = {}
    for kind in (DhKind.A, DhKind.S, DhKind.ALPHA):
        sizes = arm.twist_tolerance_rad if kind is DhKind.ALPHA else length
        found |= {DhEntry(kind, row): float(sizes[row - 1]) for row in range(1, n + 1)}
    free = {p.name for p in part.parameters} | set(held)
    if part.dh_table(nominal_vector(part.parameters)) is not None:
        # Where the hinge is decides s_1 and the last link; the arm's table cannot know.
        free |= {"s_1", f"a_{n}", f"s_{n}", f"alpha_{n}"}
    chosen = {e: sd for e, sd in found.items() if sd > 0.0 and e.name not in free}
    return model.freed(tuple(chosen)), {e.name: sd for e, sd in chosen.items()}


def freed(model: ClosureModel, names: Iterable[str]) -> ClosureModel:
    """Return the loop with these entries of the arm's table free too; other names are passed over."""
    known = {p.name for p in model.parameters}
    return model.freed(
        [DhEntry.parse(name) for name in names if name not in known and is_entry(name)]
    )


def without_known_errors(
    model: ClosureModel,
    x: FloatArray,
    q: FloatArray,
    *,
    tolerated: Collection[str],
    components: VarianceComponents,
) -> tuple[ClosureModel, FloatArray, FloatArray]:
    """Take out what was found of the sensors' errors and the lengths, so that only noise is left to judge.

    Returns
    -------
    The loop with its lengths as found and no longer free, its parameters, and readings (m, n) less
    the predicted errors.
    """
    straight = q.copy()
    for joint, curve in components.curves_rad.items():
        straight[:, joint - 1] -= curve
    table = model.dh_table(x)
    if not tolerated or table is None:
        return model, x, straight
    kept = [k for k, p in enumerate(model.parameters) if p.name not in tolerated]
    return model.with_table(table).without(tolerated), x[kept], straight
