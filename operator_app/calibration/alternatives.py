"""Alternative models for a gross misfit: each is solved, and the best are reported with their probability.

Only for misfits that no linear explanation reaches.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from itertools import combinations
from time import thread_time

import numpy as np

from fixtures.ball import Ball
from fixtures.base import EndpointConstraint
from operator_app.calibration.alternative_model import (
    AlternativeModel,
    closes,
    cost_of,
    hinge_instead,
    instead,
    is_near,
    shift_of,
    solved,
    tried,
    without_readings,
)
from operator_app.calibration.closed_loops import pick
from operator_app.calibration.findings import reading_step, unrelated_reading
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.fault_models import constant_reading_runs
from solver.diagnostics.limits import (
    ALTERNATIVE_CHI2_RATIO,
    ALTERNATIVE_FIXTURE_POSES,
    CHI2_PER_DOF_ALTERNATIVE,
    SMALLEST_NOISE_SCALE,
)
from solver.diagnostics.model_selection import probabilities
from solver.diagnostics.range_checks import makes_sense, mistakes

NOTHING = Finding(kind=FindingKind.REPORTED)
"""Prior log-weight of the fit without any mistake."""

PROMISING = 0.3
"""An alternative is solved completely if it leaves less than this share of the squared closure error."""

PER_FREEDOM = 4.6
"""Penalty for each equation that an alternative does not use: log of 100."""

LEAST_M = 2e-3
"""Lengths that differ by less are within a tolerance of each other."""

LEAST_CHANGE_RAD = np.deg2rad(0.05)
"""Offsets below this count as zero in either unit."""

TRIED = 3
"""Number of the most promising alternatives that are solved completely."""

LONGEST_S = 4.0
"""Limit of this thread's CPU time for an explanation, independent of other programs."""


def find_alternatives(
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    *,
    unsensed: tuple[int, ...],
    scale: float,
    dof: int,
    near: bool = False,
    of_files: bool = False,
    sensors: bool = False,
) -> tuple[Finding, ...]:
    """Return the mistakes that explain a gross misfit, the most probable first.

    Parameters
    ----------
    scale, dof
        chi2/dof at stated variances without a mistake, infinite where nothing could be solved, and its dof.
    near
        Only simple mistakes of the file that bring the solution near the nominal values, even if the fit is good
        without them.
    of_files
        Only simple mistakes of the files.
    sensors
        With `near` also a sensor whose readings are useless in all poses.
    """
    deadline = thread_time() + LONGEST_S
    as_it_is = np.inf
    if not near and not unsensed:
        plain = AlternativeModel(finding=NOTHING, poses=poses, fixture=fixture)
        as_it_is = cost_of(arm, plain)
    found: list[tuple[AlternativeModel, float]] = []
    families = (
        (
            _same_loop(fixture, poses, arm, unsensed),
            *((_unread(arm, fixture, poses, unsensed),) if sensors else ()),
        )
        if near or of_files
        else (
            _frozen(arm, fixture, poses, unsensed),
            _same_loop(fixture, poses, arm, unsensed),
            _blind(arm, fixture, poses, unsensed),
        )
    )
    for family in families:
        for alternative in _screened(arm, family, deadline, below=PROMISING * as_it_is):
            if near and not is_near(arm, alternative):
                continue
            if thread_time() > deadline:
                break
            ratio, left = solved(arm, alternative)
            if alternative.fixture is not fixture and closes(arm, alternative, far=as_it_is):
                # So few equations never close by chance, even with accurate files.
                ratio = min(ratio, 0.99 * CHI2_PER_DOF_ALTERNATIVE)
            if ratio < CHI2_PER_DOF_ALTERNATIVE and (
                near or ALTERNATIVE_CHI2_RATIO * ratio < scale
            ):
                found.append((alternative, _weight(ratio, left, dof)))
        if found:
            break
    for alternative, _ in tuple(found):
        found += [
            (shift, _weight(ratio, left, dof))
            for shift, ratio, left in _shifted(arm, alternative, unsensed)
            if ratio < CHI2_PER_DOF_ALTERNATIVE
        ]
    return _named(found)


def hinge_alternative(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, *, unsensed: tuple[int, ...]
) -> tuple[Finding, ...]:
    """Return the finding that the fixture is a hinge, where the poses do not suffice for a ball but close in a hinge.

    A ball closes wherever a hinge does, with its centre anywhere along the axis.
    """
    if not isinstance(fixture, Ball) or len(poses) < ALTERNATIVE_FIXTURE_POSES:
        return ()
    other = hinge_instead(arm, fixture, poses)
    alternative = AlternativeModel(
        finding=other.finding, poses=poses, fixture=other.fixture, unsensed=unsensed
    )
    ratio, left = solved(arm, alternative)
    return (
        _named([(alternative, _weight(ratio, left, left))])
        if ratio < CHI2_PER_DOF_ALTERNATIVE
        else ()
    )


def step_alternative(
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    *,
    unsensed: tuple[int, ...],
    joint: int,
    scale: float,
) -> tuple[Finding, ...]:
    """Return the step that explains a wrong reading of a joint, if one does; `scale` as above."""
    blind = AlternativeModel(
        finding=unrelated_reading(joint, arm),
        poses=poses,
        fixture=fixture,
        unsensed=(*unsensed, joint),
    )
    found = _shifted(arm, blind, unsensed)
    return _named(
        [
            (s, 0.0)
            for s, ratio, _ in found
            if ratio < CHI2_PER_DOF_ALTERNATIVE and ALTERNATIVE_CHI2_RATIO * ratio < scale
        ]
    )


def _weight(ratio: float, left: int, dof: int) -> float:
    """Log-weight of an alternative with chi2/dof `ratio` for `left` degrees of freedom."""
    fits = -0.5 * dof * np.log(max(ratio, SMALLEST_NOISE_SCALE))
    return float(fits - PER_FREEDOM * max(0, dof - left))


def _named(found: list[tuple[AlternativeModel, float]]) -> tuple[Finding, ...]:
    if not found:
        return ()
    chance = probabilities(np.array([weight for _, weight in found]))
    order = np.argsort(-chance)
    return tuple(
        replace(found[k][0].finding, probability=float(chance[k]), blocking=True)
        for k in order
        if chance[k] > 0.02
    )


def _same_loop(
    fixture: EndpointConstraint, poses: PoseSet, arm: ArmModel, unsensed: tuple[int, ...]
) -> Iterator[AlternativeModel]:
    """Mistakes of the file: a unit, a sign, two columns exchanged."""
    if unsensed:
        return
    for mistake in mistakes(arm, poses.q_rad):
        if makes_sense(arm, mistake.q_rad):
            finding = Finding(
                kind=FindingKind.READING_MISTAKE,
                names=(mistake.code,),
                reported=(mistake.text, mistake.remedy),
            )
            changed = replace(poses, q_rad=mistake.q_rad)
            yield AlternativeModel(finding=finding, poses=changed, fixture=fixture)
    offsets = arm.table.theta_off_rad
    if LEAST_CHANGE_RAD < float(np.abs(offsets).max()) < np.deg2rad(2.0 * np.pi):
        finding = Finding(kind=FindingKind.OFFSETS_IN_RADIANS)
        meant = replace(arm, table=replace(arm.table, theta_off_rad=offsets / np.deg2rad(1.0)))
        yield AlternativeModel(finding=finding, poses=poses, fixture=fixture, arm=meant)
    for kind in ("s", "a"):
        lengths = getattr(arm.table, f"{kind}_m")
        for i, j in combinations(np.flatnonzero(np.abs(lengths) > LEAST_M), 2):
            if abs(lengths[i] - lengths[j]) > LEAST_M:
                order = np.arange(len(lengths))
                order[[i, j]] = j, i
                entries = (f"{kind}_{i + 1}", f"{kind}_{j + 1}")
                finding = Finding(kind=FindingKind.ENTRIES_EXCHANGED, names=entries)
                table = replace(arm.table, **{f"{kind}_m": lengths[order]})
                yield AlternativeModel(
                    finding=finding, poses=poses, fixture=fixture, arm=replace(arm, table=table)
                )


def _frozen(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, unsensed: tuple[int, ...]
) -> Iterator[AlternativeModel]:
    """A sensor that is stuck in a run of poses: the loops close without that run."""
    sigma = arm.sigma_rad()
    for j in range(1, poses.joint_count + 1):
        for first, last in constant_reading_runs(poses.q_rad, j, 3.0 * float(sigma[j - 1])):
            rest = np.setdiff1d(np.arange(len(poses)), np.arange(first + 1, last))
            if len(rest) >= 4 and j not in unsensed:
                yield AlternativeModel(
                    finding=Finding(
                        kind=FindingKind.READING_FROZEN,
                        joint=j,
                        poses=poses.label[first:last],
                    ),
                    poses=pick(poses, rest),
                    fixture=fixture,
                    unsensed=unsensed,
                )


def _blind(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, unsensed: tuple[int, ...]
) -> Iterator[AlternativeModel]:
    """Another fixture, or a sensor whose readings are useless in all poses."""
    for other in instead(arm, fixture, poses):
        yield AlternativeModel(finding=other.finding, poses=poses, fixture=other.fixture)
    yield from _unread(arm, fixture, poses, unsensed)


def _unread(
    arm: ArmModel, fixture: EndpointConstraint, poses: PoseSet, unsensed: tuple[int, ...]
) -> Iterator[AlternativeModel]:
    """A sensor that says nothing in any pose."""
    for j in range(1, poses.joint_count + 1):
        if j not in unsensed:
            yield AlternativeModel(
                finding=unrelated_reading(j, arm),
                poses=poses,
                fixture=fixture,
                unsensed=(*unsensed, j),
            )


def _shifted(
    arm: ArmModel, blind: AlternativeModel, unsensed: tuple[int, ...]
) -> list[tuple[AlternativeModel, float, int]]:
    """The joint that `blind` does not use, with a step removed from its readings: that alternative, solved."""
    more = [j for j in blind.unsensed if j not in unsensed]
    if len(more) != 1:
        return []
    (joint,) = more
    q = blind.poses.q_rad

    def angle() -> FloatArray | None:
        fit = without_readings(arm, blind)
        first = fit.unsensed.shape[-1] - len(blind.unsensed)
        return fit.unsensed[:, first + sorted(blind.unsensed).index(joint)]

    measured = tried(angle, None)
    shift = None if measured is None else shift_of(q[:, joint - 1], measured)
    if shift is None:
        return []
    back = q.copy()
    back[shift.first :, joint - 1] -= shift.size_rad
    alternative = AlternativeModel(
        finding=reading_step(joint, shift.size_rad, shift.first, arm, blind.poses.label),
        poses=replace(blind.poses, q_rad=back),
        fixture=blind.fixture,
        unsensed=unsensed,
    )
    return [(alternative, *solved(arm, alternative))]


def _screened(
    arm: ArmModel, alternatives: Iterator[AlternativeModel], deadline: float, *, below: float
) -> list[AlternativeModel]:
    """The most promising alternatives by their closure error with equal weights."""
    costs: list[tuple[float, int, AlternativeModel]] = []
    for number, alternative in enumerate(alternatives):
        if thread_time() > deadline:
            break
        costs.append((cost_of(arm, alternative), number, alternative))
    costs.sort(key=lambda cost: cost[:2])
    return [
        alternative for cost, _, alternative in costs[:TRIED] if np.isfinite(cost) and cost <= below
    ]
