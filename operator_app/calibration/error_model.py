"""Stated error model of a pose set: noise, tolerances, priors and loads from the files of arm and fixture."""

from collections.abc import Collection, Iterable, Mapping
from dataclasses import replace
from datetime import datetime
from itertools import pairwise
from types import MappingProxyType

import numpy as np

from fixtures.ball import Ball, KnownDistance
from fixtures.base import EndpointConstraint
from fixtures.measured import Measured
from operator_app.calibration.experiment import Experiment
from operator_app.config.measured_endpoints import mean_endpoint
from solver.arrays import BoolArray, FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind, is_entry, nominal_vector
from solver.chain.poses import PoseSet, back_to_caller, canonical_order
from solver.chain.statics import unstated_masses
from solver.estimators.error_model import (
    ErrorModel,
    MeasuredDistance,
    stated_errors,
    variance_of_means,
)
from solver.estimators.implicit import NoiseModel
from solver.estimators.load_effects import LoadBasis, load_basis
from solver.loops.closure import ClosureModel, unsensed_at_readings
from solver.loops.endpoints import GROUND

MOVED_RAD, MOVED_SIGMAS = np.deg2rad(0.05), 4.0
"""A joint has moved between two poses if its readings differ by more than MOVED_RAD and by more than MOVED_SIGMAS
standard deviations of a reading."""
MOVED_M = 1e-3
"""The arm has moved if two positions measured by an instrument differ by more than this, whatever the joints read."""


def error_model(
    experiment: Experiment,
    kept: BoolArray | IntArray | slice = slice(None),
    *,
    tolerance: Mapping[str, float] = MappingProxyType({}),
    prior: Mapping[str, float] = MappingProxyType({}),
) -> ErrorModel:
    """Return the stated errors of the `kept` poses; `tolerance`, `prior`: see these attributes of `ErrorModel`."""
    arm, fixture, poses = experiment.arm, experiment.fixture, experiment.poses
    errors = stated_errors(
        arm,
        samples=poses.sample_counts[kept],
        sd_rad=None if poses.sd_rad is None else poses.sd_rad[kept],
        unsensed_joints=experiment.unsensed,
    )
    passive = fixture.kind != "measured"
    indices = np.arange(len(poses))[kept]
    return replace(
        errors,
        endpoint_variance=_instrument_variance(fixture),
        give_rad=fixture.compliance.orientation_rad if passive else None,
        give_m=fixture.compliance.position_m if passive else None,
        tolerance=tolerance,
        prior=prior,
        distances=tuple(map(_between_sockets, stated_distances(experiment))),
        discrepancy=True,
        loads=_loads(experiment, indices),
        approach=approach_of(arm, poses, indices),
    )


def stated_distances(experiment: Experiment) -> tuple[KnownDistance, ...]:
    """Return the distances that a ball's fixture file states between two sockets, if both sockets have poses."""
    fixture, placements = experiment.fixture, set(experiment.poses.placements)
    known = fixture.distances if isinstance(fixture, Ball) else ()
    return tuple(d for d in known if set(d.between) <= placements)


def _between_sockets(known: KnownDistance) -> MeasuredDistance:
    first, second = (tuple(f"{name}[{k}]" for name in GROUND) for k in known.between)
    return MeasuredDistance(
        first=first, second=second, value_m=known.value_m, sigma_m=known.sigma_m
    )


def _loads(experiment: Experiment, kept: IntArray) -> LoadBasis | None:
    """Return effects of gravity at the kept poses: on the arm and, if the arm file states masses, on the fixture.

    They are computed at the nominal values, with the poses sorted by their readings. They therefore depend neither on
    the start values of a fit nor on the order of the poses in the file, not even in the last digit.
    """
    arm, fixture = experiment.arm, experiment.fixture
    if not len(kept):
        return None
    order = canonical_order(experiment.poses.q_rad[kept])
    masses = arm.masses or unstated_masses(arm.joint_count, arm.down)
    pulled = arm.masses is not None and fixture.kind != "measured"
    used = experiment.at_poses(kept[order])
    model, q = used.loop(), used.poses.q_rad
    x, compliance = nominal_vector(model.parameters), fixture.compliance
    return load_basis(
        model,
        x,
        q,
        unsensed_at_readings(model, x, q),
        masses,
        stated_deflection=(compliance.orientation_rad, compliance.position_m)
        if pulled
        else (0.0, 0.0),
    ).at_poses(back_to_caller(order))


def approach_of(arm: ArmModel, poses: PoseSet, kept: IntArray) -> FloatArray | None:
    """Return the direction (m, n), 1 or -1, in which each joint moved last before each kept pose.

    The direction is 0 until the joint has first moved in the placement. The order of the poses follows from their
    times, not from the file; the result is None if the times do not determine the order.
    """
    if poses.utc is None or not all(poses.utc):
        return None
    try:
        times = [datetime.fromisoformat(utc) for utc in poses.utc]
        order = sorted(range(len(poses)), key=lambda k: (times[k], tuple(poses.q_rad[k])))
    except (ValueError, TypeError):
        # Invalid times, or times with and without a zone, cannot be ordered.
        return None
    if any(
        times[a] == times[b] and not np.array_equal(poses.q_rad[a], poses.q_rad[b])
        for a, b in pairwise(order)
    ):
        # The clock is too coarse to tell which of two poses came first.
        return None
    moves = _moves_rad(arm)
    directions = np.zeros(poses.q_rad.shape)
    side, last, placement = np.zeros(poses.joint_count), poses.q_rad[order[0]].copy(), None
    for k in order:
        q = poses.q_rad[k]
        if poses.placement[k] != placement:
            side, last, placement = np.zeros_like(side), q.copy(), poses.placement[k]
        has_moved = np.abs(q - last) > moves
        side = np.where(has_moved, np.sign(q - last), side)
        last = np.where(has_moved, q, last)
        directions[k] = side
    return directions[kept]


def noise_model(experiment: Experiment) -> NoiseModel:
    """Return the noise of each pose's mean readings and of an instrument, from the specifications of the sensors."""
    return NoiseModel(
        joint_variance=variance_of_means(experiment.arm, experiment.poses.sample_counts),
        fixture_variance=_instrument_variance(experiment.fixture),
    )


def _instrument_variance(fixture: EndpointConstraint) -> FloatArray:
    """Variance (6,), rad^2 then m^2, of an instrument's measurement by component; 0 without an instrument."""
    return fixture.endpoint_variance() if isinstance(fixture, Measured) else np.zeros(6)


def averaged_at_rest(arm: ArmModel, poses: PoseSet) -> PoseSet:
    """Average successive rows between which no joint moved; the number of rows stays the same.

    Such rows of one placement, e.g. in a log at a fixed rate, have the same pose, deflection and play; only their noise
    is independent. Each row gets the group's mean reading, mean endpoint and total number of samples, so that
    `distinct_poses` counts the group once. If the rows of every group are equal already, `poses` is returned.
    """
    q, rows = poses.q_rad, [poses.q_rad, poses.placement[:, None]]
    limits = [_moves_rad(arm), np.zeros(1)]
    if poses.endpoint is not None:
        rows.append(poses.endpoint[:, :3])
        limits.append(np.full(3, MOVED_M))
    table, limit = np.column_stack(rows), np.concatenate(limits)
    steps = np.abs(np.diff(table, axis=0))
    near = np.all(steps <= limit, axis=1)
    if not np.any(near & np.any(steps, axis=1)):
        return poses
    first = np.zeros(len(q), dtype=np.int64)
    for k in range(1, len(q)):
        f = first[k - 1]
        # Each row is compared with the group's first row too, so that slow motion does not count as rest.
        first[k] = f if near[k - 1] and np.all(np.abs(table[k] - table[f]) <= limit) else k
    starts, which = np.unique(first, return_inverse=True)
    count = np.bincount(which)

    def mean(values: FloatArray) -> FloatArray:
        return np.asarray(np.add.reduceat(values, starts) / count[:, None])

    endpoint = None
    if poses.endpoint is not None:
        endpoint = np.array([mean_endpoint(e) for e in np.split(poses.endpoint, starts[1:])])
    return replace(
        poses,
        q_rad=mean(q)[which],
        sd_rad=None if poses.sd_rad is None else np.sqrt(mean(poses.sd_rad**2))[which],
        samples=np.add.reduceat(poses.sample_counts, starts)[which],
        endpoint=None if endpoint is None else endpoint[which],
    )


def _moves_rad(arm: ArmModel) -> FloatArray:
    """Return the difference of two readings (n,), rad, above which a joint counts as moved."""
    return np.maximum(MOVED_RAD, MOVED_SIGMAS * arm.sigma_rad())


def distinct_poses(poses: PoseSet, kept: BoolArray) -> tuple[IntArray, IntArray]:
    """Return indices of the distinct poses among the `kept` ones, and each kept pose's position in these indices.

    Poses of one placement with exactly equal readings and endpoints count as one: repeated rows add no information.
    """
    indices = np.flatnonzero(kept)
    columns = [poses.placement[indices, None].astype(float), poses.q_rad[indices]]
    if poses.endpoint is not None:
        columns.append(poses.endpoint[indices])
    _, first, which = np.unique(
        np.column_stack(columns), axis=0, return_index=True, return_inverse=True
    )
    order = np.argsort(first)
    return indices[first[order]], np.argsort(order)[which.reshape(-1)]


def free_within_tolerance(
    model: ClosureModel, arm: ArmModel, *, fixed: Collection[str] = ()
) -> tuple[ClosureModel, dict[str, float]]:
    """Free the arm's lengths and twists within their tolerances, since the maker's table is not exact.

    Offsets that `model` fixes are freed too, if the arm's file states their uncertainty. Entries that locate the
    fixture and the entries `fixed` are not freed. Returns the loop, and the standard deviation (m, rad) of each newly
    freed entry by name.
    """
    part = model.parts()[0][0]
    n = arm.joint_count
    tolerances: dict[DhEntry, float] = {}
    for kind in (DhKind.A, DhKind.S, DhKind.ALPHA, DhKind.BETA):
        sizes = arm.twist_tolerance_rad if kind.is_angle else arm.length_tolerance_m
        entries = (DhEntry(kind, row) for row in range(1, n + 1))
        tolerances |= {e: float(sizes[e.row - 1]) for e in entries if e in arm.maker_entries(e.row)}
    if (known := arm.offset_tolerance_rad) is not None:
        blind = model.unsensed_joints
        tolerances |= {
            e: known for e in arm.free if e.kind is DhKind.THETA_OFF and e.row not in blind
        }
    free = {p.name for p in part.parameters} | set(fixed)
    if part.dh_table(nominal_vector(part.parameters)) is not None:
        # s_1 and the last link depend on the place of the hinge, not on the arm's table.
        free |= {"s_1", f"a_{n}", f"s_{n}", f"alpha_{n}"}
    chosen = {e: sd for e, sd in tolerances.items() if sd > 0.0 and e.name not in free}
    return model.freed(tuple(chosen)), {e.name: sd for e, sd in chosen.items()}


def stated_priors(
    model: ClosureModel, arm: ArmModel, fixture: EndpointConstraint
) -> dict[str, float]:
    """Return the standard deviations (rad, m) that files state for the unknowns of a loop, by name.

    Included are the arm's offsets (only if its file states `offset_tolerance_deg`), the arm's lengths and twists, and
    the fixture's placement; of several placements only the first, because the fixture's file describes only one.
    """
    tolerance, offset = fixture.tolerance, arm.offset_tolerance_rad
    sides = {*model.ground_side, *model.hand_side}
    first = {p.name for p in np.array(model.parameters, dtype=object)[model.parts()[0][1]]}
    priors: dict[str, float] = {}
    for p in model.parameters:
        is_placed, plain = p.name in sides, p.name.partition("[")[0]
        if is_placed and p.name not in first:
            continue
        entry = DhEntry.parse(plain) if is_entry(plain) else None
        of_fixture = is_placed * (tolerance.orientation_rad if p.is_angle else tolerance.position_m)
        if entry is not None and entry.kind is DhKind.THETA_OFF:
            size = 0.0 if offset is None else float(np.hypot(offset, of_fixture))
        elif is_placed or entry is None:
            size = of_fixture
        else:
            row = entry.row - 1
            size = float((arm.twist_tolerance_rad if p.is_angle else arm.length_tolerance_m)[row])
        if size > 0.0:
            priors[p.name] = size
    return priors


def freed(model: ClosureModel, names: Iterable[str]) -> ClosureModel:
    """Return `model` with the D-H entries among `names` added to its parameters; all other names are ignored."""
    known = {p.name for p in model.parameters}
    return model.freed(
        [DhEntry.parse(name) for name in names if name not in known and is_entry(name)]
    )
