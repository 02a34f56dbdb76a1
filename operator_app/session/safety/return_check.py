"""Compares a repeated pose with its first reading, and reports what has shifted and by how much."""

import numpy as np

from fixtures.measured import Measured
from operator_app.calibration.repeat_measurement import Repeat, compare_readings
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError
from operator_app.session.safety import resume_checks
from operator_app.session.store.state import SessionState
from operator_app.units import CHI2, POSITION, SHIFTED, SLIP_SIGMA, TURNED
from solver.chain.parameters import nominal_vector
from solver.chain.rotations import rotation_matrix
from solver.estimators.error_model import variance_of_means

FIXTURE_MOVED_M, FIXTURE_TURNED_RAD = 4e-3, float(np.deg2rad(1.0))
"""A repeated pose is refused if the fixture has moved or turned by more than this: even a slender fixture deflects less
(paper, section 4). The diagnosis of the calibration detects smaller displacements."""


def check_repeat(state: SessionState, procedure: Procedure, *, refuse: bool) -> str:
    """Compare the last repeated pose with its first reading; return a message, or "" if they agree.

    Raises GuardError if `refuse` is true and a joint, the fixture, the target or the tracker has shifted between the
    two readings. At the end of an uninterrupted capture, `refuse` is false: a shift is then only reported, and the
    diagnosis of the calibration uses both readings.
    """
    state = state.here
    if not procedure.fixture.fixture.holds_hand:
        try:
            return _check_target_again(state, procedure)
        except GuardError as error:
            if refuse:
                raise
            return f"{error.happened[0].upper()}{error.happened[1:]}. The diagnosis of the calibration uses this."
    repeat = _repeat(state, procedure)
    if repeat is None or repeat.chi2 <= _chi2_limit(repeat):
        # Noise, backlash and fixture compliance explain the difference.
        return ""
    pose, joint = state.repeats[-1].first.number, repeat.joint
    joint_shifted = (
        f"differs from its first reading: joint {joint} has shifted by "
        f"{POSITION(repeat.size_rad).with_unit} (sigma {SLIP_SIGMA(repeat.sigma_rad).with_unit})"
    )
    by = f"{SHIFTED(repeat.shifted_m).with_unit} and {TURNED(repeat.turned_rad).with_unit}"
    if refuse and repeat.joint_odds > 1.0:
        raise GuardError(
            f"pose {pose} {joint_shifted}",
            f"check the coupling and the counter of joint {joint}; {resume_checks.NEW_SESSION_REMEDY}",
        )
    if refuse and (repeat.shifted_m > FIXTURE_MOVED_M or repeat.turned_rad > FIXTURE_TURNED_RAD):
        raise GuardError(
            f"pose {pose} differs from its first reading: the fixture has moved by about {by}",
            resume_checks.NEW_SESSION_REMEDY,
        )
    if not refuse and repeat.joint_odds >= resume_checks.JOINT_ODDS:
        return (
            f"Pose {pose} {joint_shifted} in between, and poses before and after the shift do not fit "
            f"together. Check the coupling and the counter of joint {joint}, and start a new session."
        )
    return (
        f"Pose {pose} differs from its first reading, as if the fixture had moved by about {by}: it was remounted, or "
        "is more compliant than its file states. The diagnosis of the calibration uses this."
    )


def agreement(state: SessionState, procedure: Procedure) -> str:
    """Return the message that the last repeated pose agrees with its first reading, with chi2 if it can be computed."""
    state = state.here
    last = state.repeats[-1]
    agrees = f"Pose {last.first.number} measured again agrees with its first reading"
    repeat = _repeat(state, procedure) if procedure.fixture.fixture.holds_hand else None
    if repeat is None:
        return f"{agrees}."
    joint = int(np.argmax(np.abs(repeat.difference_rad))) + 1
    largest = POSITION(float(repeat.difference_rad[joint - 1])).with_unit
    figures = f"chi2 {CHI2(repeat.chi2).shown}, limit {CHI2(_chi2_limit(repeat)).shown}"
    return f"{agrees} ({figures}; largest difference: J{joint} {largest})."


def _chi2_limit(repeat: Repeat) -> float:
    from scipy.special import chdtri

    return float(chdtri(repeat.dof, resume_checks.FALSE_REFUSAL_PROBABILITY))


def _repeat(state: SessionState, procedure: Procedure) -> Repeat | None:
    """Return the last repeated pose compared with its first reading; None if loop motion could explain any change."""
    arm, fixture = procedure.arm, procedure.fixture.fixture
    model = fixture.model(arm, unsensed_joints=procedure.unsensed_joints)
    fixed = resume_checks.parameters_from_poses(state, procedure)
    values = {} if fixed is None else fixed.estimate.values_by_name
    x = nominal_vector(model.parameters, values)
    return compare_readings(arm, model, x, state.rereads[-1], fixture.compliance)


def _check_target_again(state: SessionState, procedure: Procedure) -> str:
    """Raise GuardError if target or tracker moved between the two readings of the last repeated pose; else return "".

    Compares the measured displacement of the target with the displacement computed from the joint readings. Errors of
    the arm's parameters cancel in the computed displacement.
    """
    from scipy.special import chdtri

    last, arm = state.repeats[-1], procedure.arm
    fixture, pair = resume_checks.fixture_in_place(state, procedure), (last.first, last.again)
    if not isinstance(fixture, Measured) or not all(p.endpoint for p in pair):
        return ""
    full = fixture.full_pose
    measured, q = np.array([p.endpoint for p in pair]), np.array([p.mean_rad for p in pair])
    model = fixture.model(arm).with_endpoints(
        measured[:, :3], rotation_matrix(measured[:, 3:]) if full else None
    )
    error = model.loop(nominal_vector(model.parameters), q, np.zeros((2, 0)))
    change = error.residual[0] - error.residual[1]
    # All joints of an open arm have sensors.
    sensor_rad2 = variance_of_means(arm, np.array([p.samples for p in pair]))
    variance_rad2 = (sensor_rad2 + arm.backlash_rad**2).sum(axis=0)
    J = error.jac_q[0]
    covariance = (J * variance_rad2) @ J.T + 2.0 * np.diag(
        fixture.endpoint_variance()[-len(change) :]
    )
    chi2 = float(change @ np.linalg.solve(covariance, change))
    if chi2 <= float(chdtri(len(change), resume_checks.FALSE_REFUSAL_PROBABILITY)):
        return ""
    shifted = SHIFTED(float(np.linalg.norm(change[-3:]))).with_unit
    turned = TURNED(float(np.linalg.norm(change[:-3]))).with_unit if full else ""
    raise GuardError(
        f"at pose {last.first.number} the target, or the tracker, has moved by "
        f"about {' and '.join(filter(None, (shifted, turned)))}",
        resume_checks.NEW_SESSION_REMEDY,
    )
