"""When nothing fits at all: which simple mistake makes everything fit? Each is tried by solving anew.

Only for misfits that no linear explanation can reach. Knows arms, fixtures and pose sets; no screen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import dataclass, replace
from itertools import combinations
from time import thread_time
from typing import TypeVar

import numpy as np

from fixtures.ball import Ball
from fixtures.base import Fixture
from operator_app.calibration.causes import (
    NamedCause,
    Words,
    frozen_in_words,
    shift_in_words,
    wrong_reading,
)
from operator_app.calibration.loop import in_order, loop_of_poses, pick
from operator_app.calibration.noise import error_model, noise_model, soften
from operator_app.calibration.other_basins import far_from_nominal
from operator_app.calibration.other_fixtures import hinge_instead, instead
from operator_app.calibration.shifted import shift_of
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.errors import SolverError
from solver.estimators.implicit import ImplicitFit, fit_implicit
from solver.estimators.least_squares import solve_damped
from solver.estimators.mixed_fit import fit_mixed
from solver.estimators.paper import ClosureProblem
from solver.judging.candidates import still_runs
from solver.judging.evidence import LEAST_SCALE, probabilities
from solver.judging.ranges import makes_sense, mistakes

_T = TypeVar("_T")

FITS = 3.0
"""chi2/dof at stated variances up to which a rival is an explanation."""

BETTER = 10.0
"""And by so much it has to be smaller than without it."""

PROMISING = 0.3
"""A rival is solved to the end when it leaves less than this share of the squared closure error."""

PER_FREEDOM = 4.6
"""What an equation that a rival does without counts against it: log of 100."""

CLOSED_M, MANY = 2e-3, 20
"""Loops of so many poses that close to this (rms) close as those of the fixture they are thought to be."""

TILTS = 30.0
"""And so many times less is left of the closure (rms, m and rad alike) than in the fixture of the file."""

LEAST_M = 2e-3
"""Lengths that differ by less are exchanged within what a tolerance may be."""

LEAST_RAD = np.deg2rad(0.05)
"""Offsets below this are none in either unit."""

TRIED = 3
"""How many of the most promising are solved to the end."""

ITERATIONS = 15
"""A rival that is right is near its solution by then."""

SECONDS = 4.0
"""Of CPU time of this thread: nobody waits longer for an explanation, and what runs beside takes none."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Rival:
    """A mistake that may have been made: what the poses, the fixture and the sensors would then be."""

    words: Words
    poses: PoseSet
    fixture: Fixture
    unsensed: tuple[int, ...] = ()
    arm: ArmModel | None = None
    """Another than the file's, where that is the mistake."""


def named_rivals(
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    *,
    unsensed: tuple[int, ...],
    scale: float,
    dof: int,
    near: bool = False,
    of_files: bool = False,
) -> tuple[NamedCause, ...]:
    """Name the mistakes that explain a gross misfit, the most probable first.

    Parameters
    ----------
    scale, dof
        chi2/dof at stated variances without any, infinite where nothing could be solved, and its dof.
    near
        Only simple mistakes of the file that bring the solution near the nominal values, however well
        it fits without.
    of_files
        Only simple mistakes of the files.
    """
    deadline = thread_time() + SECONDS
    as_it_is = np.inf
    if not near and not unsensed:
        plain = Rival(words=Words("", "", ""), poses=poses, fixture=fixture)
        as_it_is = _cost(arm, plain)
    found: list[tuple[Rival, float]] = []
    families = (
        (_same_loop(fixture, poses, arm, unsensed),)
        if near or of_files
        else (
            _frozen(arm, fixture, poses, unsensed),
            _same_loop(fixture, poses, arm, unsensed),
            _blind(arm, fixture, poses, unsensed),
        )
    )
    for family in families:
        for rival in _screened(arm, family, deadline, below=PROMISING * as_it_is):
            if near and not _is_near(arm, rival):
                continue
            if thread_time() > deadline:
                break
            ratio, left = _solved(arm, rival)
            if rival.fixture is not fixture and _closes(arm, rival, far=as_it_is):
                # So few equations close by chance nowhere, however good the statements are.
                ratio = min(ratio, 0.99 * FITS)
            if ratio < FITS and (near or BETTER * ratio < scale):
                found.append((rival, _weight(ratio, left, dof)))
        if found:
            break
    for rival, _ in tuple(found):
        found += [
            (shift, _weight(ratio, left, dof))
            for shift, ratio, left in _shifted(arm, rival, unsensed)
            if ratio < FITS
        ]
    return _named(found)


def named_hinge(
    arm: ArmModel, fixture: Fixture, poses: PoseSet, *, unsensed: tuple[int, ...]
) -> tuple[NamedCause, ...]:
    """Name a hinge in which everything closes, where poses in a ball tell too little: it is one.

    A ball closes wherever a hinge does, with a centre that may be anywhere along its axis.
    """
    if not isinstance(fixture, Ball) or len(poses) < MANY:
        return ()
    other = hinge_instead(arm, fixture, poses)
    rival = Rival(words=other.words, poses=poses, fixture=other.fixture, unsensed=unsensed)
    ratio, left = _solved(arm, rival)
    return _named([(rival, _weight(ratio, left, left))]) if ratio < FITS else ()


def named_shift(
    arm: ArmModel,
    fixture: Fixture,
    poses: PoseSet,
    *,
    unsensed: tuple[int, ...],
    joint: int,
    scale: float,
) -> tuple[NamedCause, ...]:
    """Name the shift that explains why a joint's reading seems wrong, if one does; `scale` as above."""
    blind = Rival(
        words=wrong_reading(joint, arm), poses=poses, fixture=fixture, unsensed=(*unsensed, joint)
    )
    found = _shifted(arm, blind, unsensed)
    return _named([(s, 0.0) for s, ratio, _ in found if ratio < FITS and BETTER * ratio < scale])


def _weight(ratio: float, left: int, dof: int) -> float:
    """Log-weight of a rival that leaves chi2/dof `ratio` of `left` degrees of freedom."""
    fits = -0.5 * dof * np.log(max(ratio, LEAST_SCALE))
    return float(fits - PER_FREEDOM * max(0, dof - left))


def _named(found: list[tuple[Rival, float]]) -> tuple[NamedCause, ...]:
    if not found:
        return ()
    chance = probabilities(np.array([weight for _, weight in found]))
    order = np.argsort(-chance)
    return tuple(
        NamedCause(
            code=found[k][0].words.code,
            probability=float(chance[k]),
            text=found[k][0].words.text,
            remedy=found[k][0].words.remedy,
            refuses=True,
        )
        for k in order
        if chance[k] > 0.02
    )


def _same_loop(
    fixture: Fixture, poses: PoseSet, arm: ArmModel, unsensed: tuple[int, ...]
) -> Iterator[Rival]:
    """Mistakes of the file: a unit, a sign, two columns exchanged."""
    if unsensed:
        return
    for mistake in mistakes(arm, poses.q_rad):
        if makes_sense(arm, mistake.q_rad):
            words = Words(mistake.code, mistake.text + ": the loops close", mistake.remedy)
            changed = replace(poses, q_rad=mistake.q_rad)
            yield Rival(words=words, poses=changed, fixture=fixture)
    offsets = arm.table.theta_off_rad
    if LEAST_RAD < float(np.abs(offsets).max()) < np.deg2rad(2.0 * np.pi):
        words = Words(
            "RADIANS_OFFSETS",
            "with theta_off_deg of the arm file taken as radians the loops close",
            "an arm file has degrees (multiply its theta_off_deg by 57.29578)",
        )
        meant = replace(arm, table=replace(arm.table, theta_off_rad=offsets / np.deg2rad(1.0)))
        yield Rival(words=words, poses=poses, fixture=fixture, arm=meant)
    for kind in ("s", "a"):
        lengths = getattr(arm.table, f"{kind}_m")
        for i, j in combinations(np.flatnonzero(np.abs(lengths) > LEAST_M), 2):
            if abs(lengths[i] - lengths[j]) > LEAST_M:
                order = np.arange(len(lengths))
                order[[i, j]] = j, i
                one, two = f"{kind}_{i + 1}", f"{kind}_{j + 1}"
                words = Words(
                    f"EXCHANGED_{one}_{two}",
                    f"with {one} and {two} of the arm file exchanged the loops close",
                    f"measure both and correct the arm file's {kind}_m of links {i + 1} and {j + 1}",
                )
                table = replace(arm.table, **{f"{kind}_m": lengths[order]})
                yield Rival(
                    words=words, poses=poses, fixture=fixture, arm=replace(arm, table=table)
                )


def _frozen(
    arm: ArmModel, fixture: Fixture, poses: PoseSet, unsensed: tuple[int, ...]
) -> Iterator[Rival]:
    """A sensor that reads the same in a run of poses: the loops close without that run."""
    sigma = arm.sigma_rad()
    for j in range(1, poses.joint_count + 1):
        for first, last in still_runs(poses.q_rad, j, 3.0 * float(sigma[j - 1])):
            rest = np.setdiff1d(np.arange(len(poses)), np.arange(first + 1, last))
            if len(rest) >= 4 and j not in unsensed:
                yield Rival(
                    words=frozen_in_words(j, tuple(range(first, last)), poses.label),
                    poses=pick(poses, rest),
                    fixture=fixture,
                    unsensed=unsensed,
                )


def _blind(
    arm: ArmModel, fixture: Fixture, poses: PoseSet, unsensed: tuple[int, ...]
) -> Iterator[Rival]:
    """A fixture that is another one; a sensor that says nothing in any pose."""
    for other in instead(arm, fixture, poses):
        yield Rival(words=other.words, poses=poses, fixture=other.fixture)
    for j in range(1, poses.joint_count + 1):
        if j not in unsensed:
            yield Rival(
                words=wrong_reading(j, arm), poses=poses, fixture=fixture, unsensed=(*unsensed, j)
            )


def _shifted(
    arm: ArmModel, blind: Rival, unsensed: tuple[int, ...]
) -> list[tuple[Rival, float, int]]:
    """A joint that `blind` does without, read again with a shift taken out: that rival, solved."""
    more = [j for j in blind.unsensed if j not in unsensed]
    if len(more) != 1:
        return []
    (joint,) = more
    q = blind.poses.q_rad

    def angle() -> FloatArray | None:
        fit = _without_readings(arm, blind)
        first = fit.unsensed.shape[-1] - len(blind.unsensed)
        return fit.unsensed[:, first + sorted(blind.unsensed).index(joint)]

    measured = _tried(angle, None)
    shift = None if measured is None else shift_of(q[:, joint - 1], measured)
    if shift is None:
        return []
    back = q.copy()
    back[shift.first :, joint - 1] -= shift.size_rad
    rival = Rival(
        words=shift_in_words(joint, shift.size_rad, shift.first, arm, blind.poses.label),
        poses=replace(blind.poses, q_rad=back),
        fixture=blind.fixture,
        unsensed=unsensed,
    )
    return [(rival, *_solved(arm, rival))]


def _screened(
    arm: ArmModel, rivals: Iterator[Rival], deadline: float, *, below: float
) -> list[Rival]:
    """The most promising rivals by the closure that is left when every equation counts the same."""
    costs: list[tuple[float, int, Rival]] = []
    for number, rival in enumerate(rivals):
        if thread_time() > deadline:
            break
        costs.append((_cost(arm, rival), number, rival))
    costs.sort(key=lambda cost: cost[:2])
    return [rival for cost, _, rival in costs[:TRIED] if np.isfinite(cost) and cost <= below]


def _start(arm: ArmModel, rival: Rival) -> tuple[FloatArray, float]:
    """Parameters of a rival's loop and the mean square of what is left of the closure."""
    arm, q = rival.arm or arm, rival.poses.q_rad
    if not rival.unsensed:
        model = loop_of_poses(arm, rival.fixture, rival.poses)
        problem = ClosureProblem.of(model, q)
        found = solve_damped(problem, nominal_vector(model.parameters), max_iterations=ITERATIONS)
        return found.x, 2.0 * found.cost / len(q)
    fit = _without_readings(arm, rival)
    return fit.x, float((fit.corrections**2).mean())


def _without_readings(arm: ArmModel, rival: Rival) -> ImplicitFit:
    """Loops of a rival that does without some readings, closed."""
    q, unsensed = rival.poses.q_rad, tuple(sorted(rival.unsensed))
    model = loop_of_poses(arm, rival.fixture, rival.poses, unsensed_joints=unsensed)
    noise = noise_model(arm, rival.fixture, rival.poses, np.ones(len(q), dtype=np.bool_))
    floor = np.maximum(noise.joint_variance, 1e-8)
    return fit_implicit(
        model,
        q,
        replace(noise, joint_variance=floor),
        nominal_vector(model.parameters),
        max_iterations=ITERATIONS,
    )


def _is_near(arm: ArmModel, rival: Rival) -> bool:
    """Whether a rival's loop closes near its nominal values."""

    def near() -> bool:
        model = loop_of_poses(rival.arm or arm, rival.fixture, rival.poses)
        return not far_from_nominal(model.parameters, _start(arm, rival)[0])

    return _tried(near, otherwise=False)


def _closes(arm: ArmModel, rival: Rival, *, far: float) -> bool:
    """Whether a loop closes in another fixture, by far more than noise of the readings explains.

    `far` is the mean square of what is left of it in the fixture of the file: noise leaves a few times
    more where rotations count as well, a hand that tilts a hundred times more.
    """
    cost = _cost(arm, rival)
    return len(rival.poses) >= MANY and cost < CLOSED_M**2 and cost * TILTS**2 < far


def _cost(arm: ArmModel, rival: Rival) -> float:
    return _tried(lambda: _start(arm, rival)[1], np.inf)


def _solved(arm: ArmModel, rival: Rival) -> tuple[float, int]:
    """chi2/dof of a rival at stated variances, and its degrees of freedom."""
    arm = rival.arm or arm

    def solve() -> tuple[float, int]:
        x, _ = _start(arm, rival)
        kept = np.ones(len(rival.poses), dtype=np.bool_)
        unsensed = tuple(sorted(rival.unsensed))
        hard = loop_of_poses(arm, rival.fixture, rival.poses, unsensed_joints=unsensed)
        model, tolerance = soften(hard, arm)
        errors = error_model(
            arm, rival.fixture, rival.poses, kept, unsensed_joints=unsensed, tolerance=tolerance
        )
        fit = fit_mixed(
            model,
            rival.poses.q_rad,
            errors,
            in_order(model, hard, x),
            group=rival.poses.placement,
            estimate=False,
        ).fit
        return fit.chi2 / max(fit.dof, 1), fit.dof

    return _tried(solve, (np.inf, 0))


def _tried(work: Callable[[], _T], otherwise: _T) -> _T:
    """Return what `work` gives; a rival that cannot be solved is none."""
    try:
        with np.errstate(all="ignore"):
            return work()
    except (SolverError, np.linalg.LinAlgError, ValueError, FloatingPointError):
        return otherwise
