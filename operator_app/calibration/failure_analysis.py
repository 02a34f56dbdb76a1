"""Failure analysis: why there is no calibration (unidentifiable parameters, saturated readings, open loops)."""

from __future__ import annotations

import numpy as np

from fixtures.base import EndpointConstraint
from operator_app.calibration.alternatives import find_alternatives, hinge_alternative
from operator_app.calibration.closed_loops import loop_of_poses
from operator_app.calibration.findings import range_finding
from operator_app.calibration.stuck_joint import explained
from operator_app.messages.finding import Finding
from operator_app.units import SIGMA_ORI, SIGMA_POS
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.poses import PoseSet
from solver.diagnostics.identifiability import identifiability
from solver.diagnostics.limits import NO_CLOSURE_M, NO_CLOSURE_RAD
from solver.diagnostics.range_checks import RangeFinding, ReadingFault
from solver.errors import PosesDoNotFitError, SolverError, UnidentifiableError
from solver.estimators.estimate import Estimate


def explain_unidentifiable(
    error: UnidentifiableError,
    arm: ArmModel,
    fixture: EndpointConstraint,
    used: PoseSet,
    unsensed: tuple[int, ...],
    paper: Estimate | None,
    saturated: PosesDoNotFitError | None,
) -> SolverError:
    """Return the error with a stuck sensor named, or what else would make nothing close."""
    stuck = explained(error, arm, fixture, used)
    if stuck is not error:
        return stuck
    if saturated is not None:
        return saturated
    if hinge := hinge_alternative(arm, fixture, used, unsensed=unsensed):
        return poses_do_not_fit(hinge)
    if paper is None or error.note or any(d.immobile_joints for d in error.directions):
        # Poses so few, or a joint that stands still: no parameter has to be believed for that.
        return error
    if _closes(paper):
        back = _led_away(arm, fixture, used, unsensed, paper)
        return poses_do_not_fit(back) if back else error
    # Where nothing closes the solution is nowhere, and what it cannot see there says nothing.
    alternatives = find_alternatives(
        arm, fixture, used, unsensed=unsensed, scale=np.inf, dof=paper.dof
    )
    return (
        poses_do_not_fit(alternatives)
        if alternatives
        else PosesDoNotFitError((_open_words(paper),))
    )


def _led_away(
    arm: ArmModel,
    fixture: EndpointConstraint,
    used: PoseSet,
    unsensed: tuple[int, ...],
    paper: Estimate,
) -> tuple[Finding, ...]:
    """What led a solution to where these poses see less than at the files' own values, which would see everything."""
    model, q = loop_of_poses(arm, fixture, used, unsensed_joints=unsensed), used.q_rad
    nominal = nominal_vector(model.parameters)
    if identifiability(model, nominal, q, sigma_rad=arm.sigma_rad()).directions:
        return ()
    return find_alternatives(
        arm,
        fixture,
        used,
        unsensed=unsensed,
        scale=np.inf,
        dof=paper.dof,
        near=True,
        sensors=True,
    )


def saturated_readings(
    found: tuple[RangeFinding, ...], poses: PoseSet
) -> PosesDoNotFitError | None:
    """Readings at the end of full scale, as the reason why poses do not fit; None if there are none."""
    known = tuple(range_finding(f, poses) for f in found if f.fault is ReadingFault.SATURATED)
    return poses_do_not_fit(known) if known else None


def _closes(estimate: Estimate) -> bool:
    after, turned = estimate.sigmas, estimate.sigmas.orientation_rad
    return after.position_m.rms < NO_CLOSURE_M and (turned is None or turned.rms < NO_CLOSURE_RAD)


def _open_words(paper: Estimate) -> str:
    """What is left of loops that no parameters close, and where to look."""
    left, turned = paper.sigmas.position_m.rms, paper.sigmas.orientation_rad
    also = "" if turned is None else f" and {SIGMA_ORI(turned.rms).with_unit}"
    return (
        f"the loops stay open by {SIGMA_POS(left).with_unit}{also} (rms) whatever the parameters: look for readings "
        "far noisier than the arm file states, an arm that moved while it was read, or poses of another arm"
    )


def poses_do_not_fit(findings: tuple[Finding, ...]) -> PosesDoNotFitError:
    """Return the error that names what would make these poses fit."""
    return PosesDoNotFitError(
        tuple(f.sentence for f in findings), codes=tuple(f.code for f in findings)
    )
