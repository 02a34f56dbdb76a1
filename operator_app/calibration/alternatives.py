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
from operator_app.calibration.alternative_model import (
    AlternativeModel,
    closes,
    cost_of,
    hinge_instead,
    is_near,
    other_fixtures,
    shift_of,
    solved,
    tried,
    without_readings,
)
from operator_app.calibration.closed_loops import pick
from operator_app.calibration.findings import reading_step
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import FloatArray
from solver.diagnostics import limits
from solver.diagnostics.fault_models import constant_reading_runs
from solver.diagnostics.model_selection import probabilities
from solver.diagnostics.range_checks import makes_sense, mistakes

PROMISING_COST_SHARE = 0.3
"""An alternative is solved completely if it leaves less than this share of the squared closure error."""

PER_FREEDOM = 4.6
"""Penalty for each equation that an alternative does not use: log of 100."""

LEAST_M = 2e-3
"""Lengths that differ by less are within a tolerance of each other."""

LEAST_CHANGE_RAD = np.deg2rad(0.05)
"""Offsets below this count as zero in either unit."""

SOLVED_ALTERNATIVES = 3
"""Number of the most promising alternatives that are solved completely."""

LONGEST_S = 4.0
"""Limit of this thread's CPU time for an explanation, independent of other programs."""


def find_alternatives(
    stated: AlternativeModel,
    *,
    scale: float,
    dof: int,
    near: bool = False,
    of_files: bool = False,
    sensors: bool = False,
) -> tuple[Finding, ...]:
    """Return the mistakes that explain a gross misfit of the stated model, the most probable first.

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
    as_it_is = np.inf if near or stated.unsensed else cost_of(stated)
    found: list[tuple[AlternativeModel, float]] = []
    families = (
        (_same_loop(stated), *((_unread(stated),) if sensors else ()))
        if near or of_files
        else (_frozen(stated), _same_loop(stated), _blind(stated))
    )
    for family in families:
        for alternative in _screened(family, deadline, below=PROMISING_COST_SHARE * as_it_is):
            if near and not is_near(alternative):
                continue
            if thread_time() > deadline:
                break
            ratio, left = solved(alternative)
            if alternative.fixture is not stated.fixture and closes(alternative, far=as_it_is):
                # So few equations never close by chance, even with accurate files.
                ratio = min(ratio, 0.99 * limits.CHI2_PER_DOF_ALTERNATIVE)
            if ratio < limits.CHI2_PER_DOF_ALTERNATIVE and (
                near or limits.ALTERNATIVE_CHI2_RATIO * ratio < scale
            ):
                found.append((alternative, _weight(ratio, left, dof)))
        if found:
            break
    for alternative, _ in tuple(found):
        found += [
            (shift, _weight(ratio, left, dof))
            for shift, ratio, left in _shifted(alternative, stated.unsensed)
            if ratio < limits.CHI2_PER_DOF_ALTERNATIVE
        ]
    return _named(found)


def hinge_alternative(stated: AlternativeModel) -> tuple[Finding, ...]:
    """Return the finding that the fixture is a hinge, where the poses do not suffice for a ball but close in a hinge.

    A ball closes wherever a hinge does, with its centre anywhere along the axis.
    """
    if not isinstance(stated.fixture, Ball) or len(stated.poses) < limits.ALTERNATIVE_FIXTURE_POSES:
        return ()
    alternative = hinge_instead(stated)
    ratio, left = solved(alternative)
    return (
        _named([(alternative, _weight(ratio, left, left))])
        if ratio < limits.CHI2_PER_DOF_ALTERNATIVE
        else ()
    )


def step_alternative(stated: AlternativeModel, joint: int, scale: float) -> tuple[Finding, ...]:
    """Return the step that explains a wrong reading of a joint, if one does; `scale` as above."""
    found = _shifted(stated.without_reading(joint), stated.unsensed)
    return _named(
        [
            (s, 0.0)
            for s, ratio, _ in found
            if ratio < limits.CHI2_PER_DOF_ALTERNATIVE
            and limits.ALTERNATIVE_CHI2_RATIO * ratio < scale
        ]
    )


def _weight(ratio: float, left: int, dof: int) -> float:
    """Log-weight of an alternative with chi2/dof `ratio` for `left` degrees of freedom."""
    fits = -0.5 * dof * np.log(max(ratio, limits.SMALLEST_NOISE_SCALE))
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


def _same_loop(stated: AlternativeModel) -> Iterator[AlternativeModel]:
    """Alternatives without a mistake of the file: a unit, a sign, two exchanged columns."""
    if stated.unsensed:
        return
    arm, poses = stated.arm, stated.poses
    for mistake in mistakes(arm, poses.q_rad):
        if makes_sense(arm, mistake.q_rad):
            finding = Finding(
                kind=FindingKind.READING_MISTAKE,
                names=(mistake.code,),
                reported=(mistake.text, mistake.remedy),
            )
            yield replace(stated, finding=finding, poses=replace(poses, q_rad=mistake.q_rad))
    offsets = arm.table.theta_off_rad
    if LEAST_CHANGE_RAD < float(np.abs(offsets).max()) < np.deg2rad(2.0 * np.pi):
        meant = replace(arm, table=replace(arm.table, theta_off_rad=offsets / np.deg2rad(1.0)))
        yield replace(stated, finding=Finding(kind=FindingKind.OFFSETS_IN_RADIANS), arm=meant)
    for kind in ("s", "a"):
        lengths = getattr(arm.table, f"{kind}_m")
        for i, j in combinations(np.flatnonzero(np.abs(lengths) > LEAST_M), 2):
            if abs(lengths[i] - lengths[j]) > LEAST_M:
                order = np.arange(len(lengths))
                order[[i, j]] = j, i
                entries = (f"{kind}_{i + 1}", f"{kind}_{j + 1}")
                finding = Finding(kind=FindingKind.ENTRIES_EXCHANGED, names=entries)
                table = replace(arm.table, **{f"{kind}_m": lengths[order]})
                yield replace(stated, finding=finding, arm=replace(arm, table=table))


def _frozen(stated: AlternativeModel) -> Iterator[AlternativeModel]:
    """Alternatives in which a sensor is stuck in a run of poses: the loops close without that run."""
    poses, sigma = stated.poses, stated.arm.sigma_rad()
    for j in range(1, poses.joint_count + 1):
        for first, last in constant_reading_runs(poses.q_rad, j, 3.0 * float(sigma[j - 1])):
            rest = np.setdiff1d(np.arange(len(poses)), np.arange(first + 1, last))
            if len(rest) >= 4 and j not in stated.unsensed:
                finding = Finding(
                    kind=FindingKind.READING_FROZEN, joint=j, poses=poses.label[first:last]
                )
                yield replace(stated, finding=finding, poses=pick(poses, rest))


def _blind(stated: AlternativeModel) -> Iterator[AlternativeModel]:
    """Alternatives with another fixture, or without a sensor whose readings are useless in all poses."""
    yield from other_fixtures(replace(stated, unsensed=()))
    yield from _unread(stated)


def _unread(stated: AlternativeModel) -> Iterator[AlternativeModel]:
    """Alternatives in which one sensor's readings are useless in all poses."""
    for j in range(1, stated.poses.joint_count + 1):
        if j not in stated.unsensed:
            yield stated.without_reading(j)


def _shifted(
    blind: AlternativeModel, unsensed: tuple[int, ...]
) -> list[tuple[AlternativeModel, float, int]]:
    """Return the solved alternative in which the joint that `blind` ignores is used, less a step in its readings."""
    more = [j for j in blind.unsensed if j not in unsensed]
    if len(more) != 1:
        return []
    (joint,) = more
    q = blind.poses.q_rad

    def angle() -> FloatArray | None:
        fit = without_readings(blind)
        first = fit.unsensed.shape[-1] - len(blind.unsensed)
        return fit.unsensed[:, first + blind.unsensed.index(joint)]

    measured = tried(angle, None)
    shift = None if measured is None else shift_of(q[:, joint - 1], measured)
    if shift is None:
        return []
    back = q.copy()
    back[shift.first :, joint - 1] -= shift.size_rad
    alternative = replace(
        blind,
        finding=reading_step(joint, shift.size_rad, shift.first, blind.arm, blind.poses.label),
        poses=replace(blind.poses, q_rad=back),
        unsensed=unsensed,
    )
    return [(alternative, *solved(alternative))]


def _screened(
    alternatives: Iterator[AlternativeModel], deadline: float, *, below: float
) -> list[AlternativeModel]:
    """The most promising alternatives by their closure error with equal weights."""
    costs: list[tuple[float, int, AlternativeModel]] = []
    for number, alternative in enumerate(alternatives):
        if thread_time() > deadline:
            break
        costs.append((cost_of(alternative), number, alternative))
    costs.sort(key=lambda cost: cost[:2])
    return [
        alternative
        for cost, _, alternative in costs[:SOLVED_ALTERNATIVES]
        if np.isfinite(cost) and cost <= below
    ]
