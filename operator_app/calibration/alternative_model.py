"""One alternative model (another fixture, sensor or arm file): its closed loops and its chi2/dof.

An alternative that cannot be solved has infinite cost. Alternative fixtures are a hinge or a ball, located from the
poses; their findings contain the command that writes the fixture's file.
"""

from collections.abc import Callable, Iterator
from dataclasses import replace
from typing import TypeVar

import numpy as np

from fixtures.ball import Ball
from fixtures.base import Compliance
from fixtures.hinge import Hinge
from fixtures.rigid import Rigid
from operator_app.calibration.error_model import (
    error_model,
    free_within_tolerance,
    noise_model,
    stated_priors,
)
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.instrument_registration import triple
from operator_app.calibration.multistart import far_from_nominal
from operator_app.messages.finding import Finding, FindingKind
from operator_app.units import WHOLE_MM
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import Frames
from solver.chain.parameters import nominal_vector, wrap_angle
from solver.diagnostics import limits
from solver.diagnostics.change_points import steps
from solver.diagnostics.fault_models import Candidate, Cause
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from solver.errors import SolverError
from solver.estimators.effects import LinearModel
from solver.estimators.implicit import ImplicitFit, fit_implicit
from solver.estimators.least_squares import solve_damped
from solver.estimators.mixed_fit import MixedFit, fit_mixed
from solver.estimators.paper import closure_problem
from solver.loops.closure import in_order
from solver.loops.endpoint_geometry import Line

_T = TypeVar("_T")

LEAST_NOISE_RAD = 1e-4
"""Smallest standard deviation assumed for the other readings in a fit that ignores the readings of some joints."""

MODEL_ITERATIONS = 15
"""Iterations after which a correct alternative is near its solution."""

Alternative = tuple[Finding, Experiment]
"""A possible mistake, and the experiment with this mistake corrected."""


def without_reading(stated: Experiment, joint: int) -> Experiment:
    """Return `stated` with the readings of `joint` ignored, in addition to those that it already ignores."""
    return replace(stated, unsensed=tuple(sorted((*stated.unsensed, joint))))


def start(alternative: Experiment) -> tuple[FloatArray, float]:
    """Fit the loops of an alternative; return its parameters (P,), as start values, and the mean square error.

    The error is the closure error (1 m as 1 rad) or, with unsensed joints, the correction of the readings (rad).
    """
    if alternative.unsensed:
        fit = without_readings(alternative)
        return fit.x, float((fit.corrections**2).mean())
    model, q = alternative.loop(), alternative.poses.q_rad
    nominal = nominal_vector(model.parameters)
    fitted = solve_damped(closure_problem(model, q), nominal, max_iterations=MODEL_ITERATIONS)
    return fitted.x, 2.0 * fitted.cost / len(q)


def without_readings(
    alternative: Experiment, *, max_iterations: int = MODEL_ITERATIONS
) -> ImplicitFit:
    """Fit the closed loops of an alternative in which the readings of some joints are not used."""
    model, noise = alternative.loop(), noise_model(alternative)
    floor = np.maximum(noise.joint_variance, LEAST_NOISE_RAD**2)
    return fit_implicit(
        model,
        alternative.poses.q_rad,
        replace(noise, joint_variance=floor),
        nominal_vector(model.parameters),
        max_iterations=max_iterations,
    )


def is_near(alternative: Experiment) -> bool:
    """Whether the parameters that close an alternative's loops are near their nominal values."""
    return tried(
        lambda: not far_from_nominal(alternative.loop().parameters, start(alternative)[0]),
        otherwise=False,
    )


def closes(alternative: Experiment, *, far: float) -> bool:
    """Whether the loops close much better in the fixture of `alternative` than in the fixture that the file states.

    `far`: mean square closure error in the file's fixture, rotations included. The ratio of `far` to the error of
    `alternative` is a few if the file is right, and about 100 if the tool tilts in a fixture stated as rigid.
    """
    cost = cost_of(alternative)
    return (
        len(alternative.poses) >= limits.ALTERNATIVE_FIXTURE_POSES
        and cost < limits.ALTERNATIVE_CLOSURE_M**2
        and cost * limits.ALTERNATIVE_CLOSURE_RATIO**2 < far
    )


def cost_of(alternative: Experiment) -> float:
    """Return the mean square error of an alternative after a short fit; infinite if its loops cannot be solved."""
    return tried(lambda: start(alternative)[1], np.inf)


def solved(alternative: Experiment, *, anywhere: bool = False) -> tuple[float, int]:
    """Return chi2/dof of an alternative at stated variances, and its dof; (inf, 0) if it cannot be solved.

    `anywhere`: whether to ignore the stated tolerance of the fixture's placement.
    """
    found = tried(lambda: fitted(alternative, anywhere=anywhere), None)
    if found is None:
        return np.inf, 0
    return found.fit.chi2 / max(found.fit.dof, 1), found.fit.dof


def fitted(alternative: Experiment, *, anywhere: bool = False) -> MixedFit:
    """Return the fit of an alternative at stated variances; raises an error if it cannot be solved.

    `anywhere`: whether to ignore the stated tolerance of the fixture's placement. If it is not ignored, the distance of
    the fixture from its stated placement increases chi2.
    """
    arm, poses = alternative.arm, alternative.poses
    x, _ = start(alternative)
    free = alternative.loop()
    model, tolerance = free_within_tolerance(free, arm)
    placed = {*free.ground_side, *free.hand_side} if anywhere else set()
    priors = stated_priors(free, arm, alternative.fixture)
    prior = {name: sd for name, sd in priors.items() if name not in placed}
    errors = error_model(alternative, tolerance=tolerance, prior=prior)
    design = LinearModel(model, poses.q_rad, errors, group=poses.placement)
    v = design.stated_variances()
    return fit_mixed(design, in_order(model, free, x), variances=v)


def tried(work: Callable[[], _T], otherwise: _T) -> _T:
    """Return the result of `work`, which solves an alternative model, or `otherwise` if the model cannot be solved."""
    try:
        with np.errstate(all="ignore"):
            return work()
    except (SolverError, np.linalg.LinAlgError, ValueError, FloatingPointError):
        return otherwise


BENDS = 3
"""Degree of the polynomial that models the smooth part of a sensor's deviation; the rest may be a step."""


def shift_of(reading_rad: FloatArray, angle_rad: FloatArray) -> tuple[int, float] | None:
    """Find a step in the deviation of a joint's readings (m,) from its known angles (m,), both in the order of time.

    Returns the index of the first pose after the step, and the step, rad; None if there is no step. A step has to
    explain most of the deviation that is left after a smooth function of the angle is subtracted.
    """
    m = len(reading_rad)
    if m < 2 * (limits.STEP_EDGE_POSES + BENDS):
        return None
    deviation = wrap_angle(reading_rad - angle_rad)
    deviation = wrap_angle(deviation - deviation[0])
    x = angle_rad - angle_rad.mean()
    curve = np.linalg.qr(np.polynomial.polynomial.polyvander(x / np.abs(x).max(), BENDS))[0]
    white = deviation - curve @ (curve.T @ deviation)
    residuals = WhitenedResiduals(
        whitener=np.ones((m, 1, 1)),
        U=curve[:, None, :],
        white=white[:, None],
        chi2=float(white @ white),
        to_x=np.zeros((0, BENDS + 1)),
        dof=m - BENDS - 1,
    )
    reading = Candidate(
        cause=Cause.LOST_COUNTS, subject="", columns=np.ones((m, 1, 1)), expected_size=np.ones(1)
    )
    for step in steps(residuals, (reading,)):
        if residuals.chi2 - step.chi2 <= limits.STEP_RESIDUAL_SHARE * residuals.chi2:
            return step.pose, float(step.size[0])
    return None


TURNS_RAD = 0.5e-3
"""Angular compliance of an ordinary hinge, for a fixture whose file states none."""


def other_fixtures(stated: Experiment) -> Iterator[Alternative]:
    """Yield alternatives whose fixture has fewer constraints than the stated one, so that loops close more easily."""
    if isinstance(stated.fixture, Rigid):
        yield hinge_instead(stated)
    if isinstance(stated.fixture, Hinge | Rigid):
        yield _ball_instead(stated)


def hinge_instead(stated: Experiment) -> Alternative:
    """Return the alternative with a hinge, whose axis is the line of the tool that moves least in the base frame."""
    arm, fixture = stated.arm, stated.fixture
    frames = arm.table.frames(stated.poses.q_rad)
    # R_k a = b: the right singular vector of the least singular value contains both directions.
    both = np.linalg.svd(_rows(frames))[2][-1]
    along = [d / np.linalg.norm(d) for d in (both[:3], both[3:])]
    tip, ground = _common_point(frames)
    hinge = Hinge.between(
        arm,
        Line(point_m=ground, direction=along[1]),
        Line(point_m=tip, direction=along[0]),
        compliance=Compliance(
            position_m=fixture.compliance.position_m,
            orientation_rad=fixture.compliance.orientation_rad or TURNS_RAD,
        ),
    )
    hand, base = (",".join(f"{x:.3f}" for x in np.round(d, 3) + 0.0) for d in along)
    lines = f"{_points(tip, ground)} --hand-direction={hand} --base-direction={base}"
    names = (fixture.kind, _new("hinge", arm, lines))
    return Finding(FindingKind.WRONG_FIXTURE_HINGE, names=names), replace(stated, fixture=hinge)


def _ball_instead(stated: Experiment) -> Alternative:
    """Return the alternative with a ball: on the stated hinge's axis or, without one, where the tool moves least."""
    fixture = stated.fixture
    frames = stated.arm.table.frames(stated.poses.q_rad)
    if isinstance(fixture, Hinge):
        tip = np.array([fixture.a_n_m, 0.0, fixture.s_n_m])
        ground = np.median(frames.p_end + frames.R_end @ tip, axis=0)
    else:
        tip, ground = _common_point(frames)
    names = (fixture.kind, _new("ball", stated.arm, _points(tip, ground)))
    ball = Ball(tip_m=triple(tip), ground_m=triple(ground), compliance=fixture.compliance)
    return Finding(FindingKind.WRONG_FIXTURE_BALL, names=names), replace(stated, fixture=ball)


def _rows(frames: Frames) -> FloatArray:
    """Return the matrix (3 m, 6) that maps a tool vector and a base vector to their difference at m poses."""
    R = frames.R_end
    return np.concatenate((R, -np.broadcast_to(np.eye(3), R.shape)), axis=-1).reshape(-1, 6)


def _common_point(frames: Frames) -> tuple[FloatArray, FloatArray]:
    """Return a point of the tool (3,) and a point of the base (3,), m, that coincide best in all poses.

    If the tool only turns about a line, both points are on that line, as near to their frames' origins as possible.
    """
    points = np.linalg.lstsq(_rows(frames), -frames.p_end.reshape(-1), rcond=0.02)[0]
    return np.asarray(points[:3]), np.asarray(points[3:])


def _new(kind: str, arm: ArmModel, where: str) -> str:
    return f"sarcal new fixture --kind {kind} --arm {arm.name} --name found {where}"


def _points(tip_m: FloatArray, ground_m: FloatArray) -> str:
    hand, base = (
        ",".join(WHOLE_MM(x).shown for x in (np.round(v, 3) + 0.0).tolist())
        for v in (tip_m, ground_m)
    )
    return f"--hand-point={hand} --base-point={base}"
