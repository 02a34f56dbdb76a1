"""Causes of a failed calibration: unidentifiable parameters, bad sensors, open loops."""

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from operator_app.calibration.alternative_model import tried, without_reading, without_readings
from operator_app.calibration.alternatives import (
    find_alternatives,
    hinge_alternative,
    poses_in_radians,
)
from operator_app.calibration.experiment import Experiment
from operator_app.messages.finding import Finding
from operator_app.units import SIGMA_ORI, SIGMA_POS, WHOLE_DEGREES
from solver.arrays import FloatArray
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops, measure_with_fixed
from solver.diagnostics import limits
from solver.diagnostics.identifiability import identifiability
from solver.errors import PosesDoNotFitError, SolverError, UnidentifiableError
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import MAX_ITERATIONS
from solver.loops.closure import ClosureModel


def explain_unidentifiable(
    error: UnidentifiableError,
    stated: Experiment,
    paper: Estimate | None,
    saturated: tuple[Finding, ...],
) -> SolverError:
    """Return an error that names the cause (stuck or saturated sensor, mistake, open loops); without one, `error`.

    `saturated`: findings of saturated readings.
    """
    stuck = explained(error, stated)
    if stuck is not error:
        return stuck
    named = saturated or poses_in_radians(stated, limits.CHI2_PER_DOF_GROSS)
    if named := named or hinge_alternative(stated):
        return poses_do_not_fit(named)
    if paper is None or error.note or any(d.immobile_joints for d in error.directions):
        # Too few poses and an immobile joint follow from the readings alone.
        return error
    if text := _open_loops_text(paper):
        # Where no loop closes the solution is arbitrary, and so is its identifiability.
        alternatives = find_alternatives(stated, scale=np.inf, dof=paper.dof)
        return poses_do_not_fit(alternatives) if alternatives else PosesDoNotFitError((text,))
    model, q = stated.loop(), stated.poses.q_rad
    nominal = nominal_vector(model.parameters)
    if identifiability(model, nominal, q, sigma_rad=stated.arm.sigma_rad()).directions:
        return error
    # A mistake makes the poses determine fewer parameters at the solution than at the nominal values.
    back = find_alternatives(stated, scale=np.inf, dof=paper.dof, near=True, sensors=True)
    return poses_do_not_fit(back) if back else error


def _open_loops_text(paper: Estimate) -> str:
    """Return the text on loops that do not close at the paper's estimate; empty if they close."""
    open_m, turned = paper.sigmas.position_m.rms, paper.sigmas.orientation_rad
    if open_m < limits.NO_CLOSURE_M and (turned is None or turned.rms < limits.NO_CLOSURE_RAD):
        return ""
    also = "" if turned is None else f" and {SIGMA_ORI(turned.rms).with_unit}"
    return (
        f"no parameters close the loops better than {SIGMA_POS(open_m).with_unit}{also} (rms): look for readings "
        "far noisier than the arm file states, an arm that moved while it was read, or poses of another arm"
    )


def poses_do_not_fit(findings: tuple[Finding, ...]) -> PosesDoNotFitError:
    """Return the error that gives `findings` as the reasons why the poses do not fit."""
    return PosesDoNotFitError(
        tuple(f.sentence for f in findings), codes=tuple(f.code for f in findings)
    )


UNKNOWN_ANGLE_SIGMA = 100.0
"""Standard deviation of a joint of unknown angle, relative to that of any other joint."""


def turned_unread(
    model: ClosureModel,
    x: FloatArray,
    before_rad: FloatArray,
    after_rad: FloatArray,
    still: Sequence[int],
) -> tuple[int, float] | None:
    """Return the joint that turned although its reading did not change, and its turn (rad); None if none did.

    The loop is closed at `before_rad`. Adding this correction of the readings to `after_rad` makes errors of the
    placement cancel. From there, the loop is closed with all `still` joints fixed, and once with each of them free. A
    joint has turned if the corrections of the other joints are much smaller while it is free.

    `x`: approximate parameters (P,). `before_rad`, `after_rad`: readings (n,). `still`: joints (1-based) whose readings
    did not change.
    """
    first = close_loops(model, x, before_rad[None])
    if not first.closed[0]:
        return None
    start = after_rad + first.q[0] - before_rad
    sigma = measure_with_fixed(still, len(start))
    standing = _correction(model, x, start, sigma)
    standing_size = np.inf if standing is None else float(np.linalg.norm(standing))
    best: tuple[float, int, float] | None = None
    for joint in still:
        loose = sigma.copy()
        loose[joint - 1] = UNKNOWN_ANGLE_SIGMA
        if (correction := _correction(model, x, start, loose)) is not None:
            turn = float(correction[joint - 1])
            correction[joint - 1] = 0.0
            best = min(filter(None, (best, (float(np.linalg.norm(correction)), joint, turn))))
    least = limits.STUCK_JOINT_MOTION_SHARE * float(np.linalg.norm(after_rad - before_rad))
    if best is None or standing_size < max(limits.STUCK_JOINT_CORRECTION_RATIO * best[0], least):
        return None
    return best[1:]


def _correction(
    model: ClosureModel, x: FloatArray, start_rad: FloatArray, sigma: FloatArray
) -> FloatArray | None:
    """Return the correction (n,), rad, that closes the loop and is smallest in units of `sigma` (n,), or None."""
    closed = close_loops(model, x, start_rad[None], sigma_rad=sigma)
    return closed.q[0] - start_rad if closed.closed[0] else None


def explained(error: UnidentifiableError, stated: Experiment) -> UnidentifiableError:
    """Return an error that names a joint that moved although its reading is constant; `error` if no joint did."""
    still = sorted({j for d in error.directions for j in d.immobile_joints})
    for joint in still:
        turned_rad = _turned_range(stated, joint)
        if turned_rad > limits.STUCK_JOINT_TURN_RAD:
            return UnidentifiableError(
                error.directions,
                code=f"FROZEN_JOINT_{joint}",
                stuck_joint=joint,
                note=f"yet the loop shows that joint {joint} turned through {WHOLE_DEGREES(turned_rad).with_unit}: "
                f"its sensor is stuck; check it, or calibrate with --unsensed {joint}",
            )
    return error


def _turned_range(stated: Experiment, joint: int) -> float:
    """Return how far (rad) a joint turned over all poses, computed without its readings; 0 if unknown."""
    blind = without_reading(replace(stated, unsensed=stated.arm.unsensed_joints), joint)
    fit = tried(lambda: without_readings(blind, max_iterations=MAX_ITERATIONS), None)
    if (
        fit is None
        or not fit.converged
        or float(np.sqrt(np.mean(fit.corrections**2))) > limits.STUCK_JOINT_CORRECTION_RAD
    ):
        return 0.0
    return float(np.ptp(blind.loop().angle_of(fit.unsensed, joint)))
