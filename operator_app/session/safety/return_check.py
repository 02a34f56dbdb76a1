"""Does an old pose, read again, read as it did? What has shifted in between, named with its size. Moves nothing."""

from __future__ import annotations

import numpy as np

from fixtures.measured import Measured
from operator_app.calibration.repeat_measurement import Repeat, compare_readings
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError
from operator_app.session.safety.resume_checks import (
    IMPROBABLE,
    START_ANEW,
    SURE,
    fixed_by_poses,
    placed,
)
from operator_app.session.store.state import SessionState
from operator_app.units.figure import POSITION, SHIFTED, SLIP_SIGMA, TURNED
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.rotations import rotation_matrix
from solver.chain.sensors import NoSensor

REMOUNTED_M, REMOUNTED_RAD = 4e-3, float(np.deg2rad(1.0))
"""More than a slender fixture bends (paper, section 4); less may be that, and the verdict tells."""


def check_return(state: SessionState, procedure: Procedure) -> str:
    """Compare the last reading of an old pose with the first one; what there is to say of it.

    Raises
    ------
    GuardError
        Something slipped in between: named with its size.
    """
    state = state.here
    if not procedure.fixture.fixture.holds_hand:
        return _check_seen_again(state, procedure)
    found = _reread(state, procedure)
    if found is None:
        return ""
    pose = state.returns[-1].first.number
    if found.joint_odds > 1.0:
        raise GuardError(
            f"pose {pose} does not read as it did: joint {found.joint} has shifted by "
            f"{POSITION(found.size_rad).with_unit} (sigma {SLIP_SIGMA(found.sigma_rad).with_unit})",
            f"look at the coupling and the counter of joint {found.joint}; {START_ANEW}",
        )
    if found.shifted_m > REMOUNTED_M or found.turned_rad > REMOUNTED_RAD:
        raise GuardError(
            f"pose {pose} does not read as it did: the fixture has moved by about "
            f"{SHIFTED(found.shifted_m).with_unit} and {TURNED(found.turned_rad).with_unit}",
            START_ANEW,
        )
    return _bent(pose, found)


def return_words(state: SessionState, procedure: Procedure) -> str:
    """What the last reading of an old pose says, where nothing was interrupted; "" where it reads as it did.

    Nothing is refused for it: all poses are taken by then, and the verdict judges them by both readings.
    """
    state = state.here
    if not procedure.fixture.fixture.holds_hand:
        try:
            return _check_seen_again(state, procedure)
        except GuardError as error:
            return f"{error.happened[0].upper()}{error.happened[1:]}. The calibration will be judged by it."
    found = _reread(state, procedure)
    if found is None:
        return ""
    pose = state.returns[-1].first.number
    if found.joint_odds < SURE:
        return _bent(pose, found)
    return (
        f"Pose {pose} does not read as it did: joint {found.joint} has shifted by "
        f"{POSITION(found.size_rad).with_unit} (sigma {SLIP_SIGMA(found.sigma_rad).with_unit}) since, and poses "
        "before and after that do not belong together. The calibration will be judged by it: look at the coupling "
        f"and the counter of joint {found.joint}, and start a new session."
    )


def _bent(pose: int, found: Repeat) -> str:
    """Say that a fixture gives, or was moved by a little."""
    return (
        f"Pose {pose} does not read as it did, as if the fixture had moved by about "
        f"{SHIFTED(found.shifted_m).with_unit}: it was remounted, or gives more than its file states. The "
        "calibration will be judged by it."
    )


def _reread(state: SessionState, procedure: Procedure) -> Repeat | None:
    """What the last return says, where that is more than noise, play and the fixture's give."""
    from scipy.special import chdtri

    last = state.returns[-1]
    arm, fixture = procedure.arm, procedure.fixture.fixture
    model = fixture.model(arm, unsensed_joints=procedure.unsensed_joints)
    fixed = fixed_by_poses(state, procedure)
    values = {} if fixed is None else fixed.values
    x: FloatArray = np.array([values.get(p.name, p.nominal) for p in model.parameters])
    found = compare_readings(
        arm,
        model,
        x,
        last.first.mean_rad,
        last.again.mean_rad,
        samples=last.first.samples,
        samples_again=last.again.samples,
        compliance=fixture.compliance,
    )
    if found.chi2 <= float(chdtri(found.dof, IMPROBABLE)):
        return None
    return found


def _check_seen_again(state: SessionState, procedure: Procedure) -> str:
    """Compare where the target is seen with where the joints have it, then and now.

    What the arm's parameters are off by is the same both times.
    """
    from scipy.special import chdtri

    last, arm = state.returns[-1], procedure.arm
    fixture, pair = placed(state, procedure), (last.first, last.again)
    if not isinstance(fixture, Measured) or not all(p.endpoint for p in pair):
        return ""
    full = fixture.full_pose
    seen, q = np.array([p.endpoint for p in pair]), np.array([p.mean_rad for p in pair])
    model = fixture.model(arm).with_endpoints(
        seen[:, :3], rotation_matrix(seen[:, 3:]) if full else None
    )
    x: FloatArray = np.array([p.nominal for p in model.parameters])
    error = model.loop(x, q, np.zeros((2, 0)))
    change = error.residual[0] - error.residual[1]
    joints = sum(_joint_variance(arm, p.samples) for p in pair)
    J = error.jac_q[0]
    covariance = (J * joints) @ J.T + 2.0 * np.diag(fixture.endpoint_variance()[-len(change) :])
    chi2 = float(change @ np.linalg.solve(covariance, change))
    if chi2 <= float(chdtri(len(change), IMPROBABLE)):
        return ""
    shifted = SHIFTED(float(np.linalg.norm(change[-3:]))).with_unit
    turned = TURNED(float(np.linalg.norm(change[:-3]))).with_unit if full else ""
    raise GuardError(
        f"at pose {last.first.number} the target is not seen where it was: it, or the tracker, has moved by "
        f"about {' and '.join(filter(None, (shifted, turned)))}",
        START_ANEW,
    )


def _joint_variance(arm: ArmModel, samples: int) -> FloatArray:
    """Variance (n,) of the mean of so many readings, play included, rad^2."""
    return np.array(
        [
            0.0
            if isinstance(joint.sensor, NoSensor)
            else joint.sensor.variance_of_mean_rad2(samples) + joint.backlash_rad**2
            for joint in arm.joints
        ]
    )
