"""One alternative model (another fixture, sensor or arm file): its closed loops and its chi2/dof.

An alternative that cannot be solved has infinite cost.
"""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace
from typing import NamedTuple, TypeVar

import numpy as np

from fixtures.base import Fixture
from operator_app.calibration.closed_loops import in_order, loop_of_poses
from operator_app.calibration.error_model import (
    error_model,
    free_within_tolerance,
    noise_model,
    stated_priors,
)
from operator_app.calibration.local_minima import far_from_nominal
from operator_app.messages.finding import Finding
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector, wrap_angle
from solver.chain.poses import PoseSet
from solver.diagnostics.change_points import Suspect, steps
from solver.diagnostics.limits import (
    ALTERNATIVE_CLOSURE_M,
    ALTERNATIVE_CLOSURE_RATIO,
    ALTERNATIVE_FIXTURE_POSES,
    STEP_EDGE_POSES,
    STEP_RESIDUAL_SHARE,
)
from solver.diagnostics.whitened_residuals import fit_residuals
from solver.errors import SolverError
from solver.estimators.implicit import ImplicitFit, fit_implicit
from solver.estimators.layout import Layout
from solver.estimators.least_squares import solve_damped
from solver.estimators.mixed_fit import fit_mixed
from solver.estimators.paper import ClosureProblem

_T = TypeVar("_T")


ITERATIONS = 15
"""A rival that is right is near its solution by then."""


@dataclass(frozen=True, slots=True, kw_only=True)
class AlternativeModel:
    """A mistake that may have been made: what the poses, the fixture and the sensors would then be."""

    finding: Finding
    poses: PoseSet
    fixture: Fixture
    unsensed: tuple[int, ...] = ()
    arm: ArmModel | None = None
    """Another than the file's, where that is the mistake."""


def start(arm: ArmModel, alternative: AlternativeModel) -> tuple[FloatArray, float]:
    """Parameters of a rival's loop and the mean square of what is left of the closure."""
    arm, q = alternative.arm or arm, alternative.poses.q_rad
    if not alternative.unsensed:
        model = loop_of_poses(arm, alternative.fixture, alternative.poses)
        problem = ClosureProblem.of(model, q)
        found = solve_damped(problem, nominal_vector(model.parameters), max_iterations=ITERATIONS)
        return found.x, 2.0 * found.cost / len(q)
    fit = without_readings(arm, alternative)
    return fit.x, float((fit.corrections**2).mean())


def without_readings(arm: ArmModel, alternative: AlternativeModel) -> ImplicitFit:
    """Loops of a rival that does without some readings, closed."""
    q, unsensed = alternative.poses.q_rad, tuple(sorted(alternative.unsensed))
    model = loop_of_poses(arm, alternative.fixture, alternative.poses, unsensed_joints=unsensed)
    noise = noise_model(
        arm, alternative.fixture, alternative.poses, np.ones(len(q), dtype=np.bool_)
    )
    floor = np.maximum(noise.joint_variance, 1e-8)
    return fit_implicit(
        model,
        q,
        replace(noise, joint_variance=floor),
        nominal_vector(model.parameters),
        max_iterations=ITERATIONS,
    )


def is_near(arm: ArmModel, alternative: AlternativeModel) -> bool:
    """Whether a rival's loop closes near its nominal values."""

    def near() -> bool:
        unsensed = tuple(sorted(alternative.unsensed))
        model = loop_of_poses(
            alternative.arm or arm, alternative.fixture, alternative.poses, unsensed_joints=unsensed
        )
        return not far_from_nominal(model.parameters, start(arm, alternative)[0])

    return tried(near, otherwise=False)


def closes(arm: ArmModel, alternative: AlternativeModel, *, far: float) -> bool:
    """Whether a loop closes in another fixture, by far more than noise of the readings explains.

    `far` is the mean square of what is left of it in the fixture of the file: noise leaves a few times
    more where rotations count as well, a hand that tilts a hundred times more.
    """
    cost = cost_of(arm, alternative)
    return (
        len(alternative.poses) >= ALTERNATIVE_FIXTURE_POSES
        and cost < ALTERNATIVE_CLOSURE_M**2
        and cost * ALTERNATIVE_CLOSURE_RATIO**2 < far
    )


def cost_of(arm: ArmModel, alternative: AlternativeModel) -> float:
    """Mean square of what is left of a rival's closure; infinite where it cannot be solved."""
    return tried(lambda: start(arm, alternative)[1], np.inf)


def solved(arm: ArmModel, alternative: AlternativeModel) -> tuple[float, int]:
    """chi2/dof of a rival at stated variances, and its degrees of freedom."""
    arm = alternative.arm or arm

    def solve() -> tuple[float, int]:
        x, _ = start(arm, alternative)
        kept = np.ones(len(alternative.poses), dtype=np.bool_)
        unsensed = tuple(sorted(alternative.unsensed))
        hard = loop_of_poses(arm, alternative.fixture, alternative.poses, unsensed_joints=unsensed)
        model, tolerance = free_within_tolerance(hard, arm)
        errors = error_model(
            arm, alternative.fixture, alternative.poses, kept, unsensed_joints=unsensed, tolerance=tolerance,
            prior=stated_priors(hard, arm, alternative.fixture),
        )  # fmt: skip
        fit = fit_mixed(
            model,
            alternative.poses.q_rad,
            errors,
            in_order(model, hard, x),
            group=alternative.poses.placement,
            variances=Layout.stated_variances,
        ).fit
        return fit.chi2 / max(fit.dof, 1), fit.dof

    return tried(solve, (np.inf, 0))


def tried(work: Callable[[], _T], otherwise: _T) -> _T:
    """Return what `work` gives; a rival that cannot be solved is none."""
    try:
        with np.errstate(all="ignore"):
            return work()
    except (SolverError, np.linalg.LinAlgError, ValueError, FloatingPointError):
        return otherwise


BENDS = 3
"""Degree of the curve that a sensor has besides."""


class ReadingStep(NamedTuple):
    """What was added to a reading (rad) from pose `first` on, index in time order."""

    first: int
    size_rad: float


def shift_of(reading_rad: FloatArray, angle_rad: FloatArray) -> ReadingStep | None:
    """Return how a joint's readings (m,) shifted against its angles (m,) as the loops have them, rad.

    Poses are in the order in which they were taken. None where a smooth curve explains it nearly as well.
    """
    m = len(reading_rad)
    if m < 2 * (STEP_EDGE_POSES + BENDS):
        return None
    off = wrap_angle(reading_rad - angle_rad)
    off = wrap_angle(off - off[0])
    x = angle_rad - angle_rad.mean()
    curve = np.linalg.qr(np.polynomial.polynomial.polyvander(x / np.abs(x).max(), BENDS))[0]
    left = fit_residuals(off[:, None], curve[:, None, :], np.ones((m, 1, 1)))
    for step in steps(left, (Suspect(name="reading", columns=np.ones((m, 1, 1))),)):
        if left.chi2 - step.chi2 <= STEP_RESIDUAL_SHARE * left.chi2:
            return ReadingStep(first=step.pose, size_rad=float(step.size[0]))
    return None
