"""Checks of arm and readings before the drives are enabled: same nodes, no counter reset, closure as predicted.

These checks move nothing. Once the arm may move, `return_check` compares a repeated pose. A counter reset sets the
count to zero at the current position. If the arm then sags before it is connected, the count is not exactly zero.
"""

from collections.abc import Sequence

import numpy as np

from fixtures.base import EndpointConstraint
from fixtures.errors import FixtureError
from hardware.arm import ArmIdentity, Reading
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.instrument_registration import (
    with_calibrated_places,
    with_registered_instrument,
)
from operator_app.calibration.prior import Innovation, innovation
from operator_app.calibration.verification import Fixed, predict, stated_noise
from operator_app.config.procedure import Procedure
from operator_app.errors import ClosureRefusedError, ConnectAgainError, GuardError
from operator_app.session.store.state import MeasuredPose, SessionState, pose_set_of
from operator_app.session.store.stored_calibration import StoredCalibration, journal_calibration
from operator_app.units import POSITION, SLIP_SIGMA, SPAN, joints_named
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder
from solver.errors import SolverError
from solver.estimators.implicit import estimate_implicit

AT_ZERO_COUNTS = 2.5
"""Largest reading, in counts, of a counter that was just reset: the noise of its last bit."""

MAX_SAG_RAD = float(np.deg2rad(5.0))
"""Largest sag between a reset and the next connection; a joint is rarely this close to zero by chance."""


def counters_near_zero(arm: ArmModel, reading_rad: FloatArray) -> dict[int, float]:
    """Return, by joint (1-based), the distance from zero of each counter that reads near zero, the nearest first.

    Near zero means within `MAX_SAG_RAD`. Distances are in units of `AT_ZERO_COUNTS` counts, and at least 1. The
    probability that a joint is within such a distance of zero by chance is proportional to the distance.
    """
    times = {
        j: max(1.0, abs(float(q)) / (AT_ZERO_COUNTS * joint.sensor.resolution_rad))
        for j, (joint, q) in enumerate(zip(arm.joints, reading_rad, strict=True), 1)
        if isinstance(joint.sensor, Encoder) and abs(q) <= MAX_SAG_RAD
    }
    return dict(sorted(times.items(), key=lambda item: item[1]))


def zero_position(arm: ArmModel, reading_rad: FloatArray, joints: Sequence[int]) -> str:
    """Return ``at zero`` if all of `joints` are within `AT_ZERO_COUNTS` counts of zero, else ``near zero``."""
    times = counters_near_zero(arm, reading_rad)
    return "at zero" if all(times.get(j, np.inf) <= 1.0 for j in joints) else "near zero"


def reset_text(joints: Sequence[int], where: str, closes_with: str = "") -> str:
    """Return the error text for joints whose counters were reset.

    `where`: "at zero" or "near zero". `closes_with`: text after "does not close", e.g. "; it closes with ...".
    """
    counters, are, were = (
        ("counter", "is", "was") if len(joints) == 1 else ("counters", "are", "were")
    )
    return (
        f"the {counters} of {joints_named(joints)} {are} {where}, and with that the loop does not close{closes_with}. "
        f"The {counters} {were} reset, as after a loss of power"
    )


def check_counters(arm: ArmModel, reading_rad: FloatArray) -> None:
    """Raise ConnectAgainError if a counter was reset: a joint reads near zero, and closer to zero than to its range."""
    fresh = []
    for number, times in sorted(counters_near_zero(arm, reading_rad).items()):
        joint, q = arm.joints[number - 1], float(reading_rad[number - 1])
        beyond = max(joint.lower_rad - q, q - joint.upper_rad)
        if beyond > abs(q):
            reads = POSITION(q).with_unit if times > 1.0 else "0.000 deg"
            fresh.append(
                f"joint {number} reads {reads}, outside its range "
                f"{SPAN(joint.lower_rad).shown} .. {SPAN(joint.upper_rad).with_unit}"
            )
    if fresh:
        raise ConnectAgainError(
            f"{'; '.join(fresh)}: the counter was reset, as after a loss of power",
            "home the joint, then connect again",
        )


FALSE_REFUSAL_PROBABILITY = 1e-4
"""Probability of refusing an unchanged arm and fixture."""

LEAST_STATED_PROBABILITY = 1e-12
"""Messages state a smaller probability as "below" this, since its value depends on unknown tails of the noise."""

INNOVATION_PROBABILITY = 1e-6
"""Probability that the innovation check refuses an unchanged arm and fixture. Of 105 simulated arms with errors three
times as large as specified, none is refused."""

CHI2_RATIO_TO_WORST_POSE = 4.0
"""Limit of a reading's chi2, relative to the largest chi2 of the session's poses; a wrong model raises both chi2."""

SHIFT_RAD = float(np.deg2rad(2.0))
"""Shift of a joint that has to be detectable before the arm moves far."""

CHI2_RATIO_TO_LIMIT = 2.0
"""A shift is detectable if its expected chi2 is this many times the limit."""

NEAR_ZERO_RATIO = 100.0
"""Distance from zero, in units of `AT_ZERO_COUNTS`, within which a reading makes a reset counter the likely cause of a
closure error. By chance, a joint is this close to zero in one of 300 positions."""

REMAINDER_PROBABILITY = 1e-3
"""A joint is named only if the chi2 that remains after its shift is exceeded with at least this probability."""

JOINT_ODDS = 100.0
"""A joint is named if its shift is this many times as likely as a shift of another joint or of the fixture."""

NEW_SESSION_REMEDY = (
    "find out what has changed, then start a new session: poses before and after it do not match"
)


def check_identity(state: SessionState, identity: ArmIdentity) -> None:
    """Raise GuardError if the arm has no nodes, or if the serial number of arm or node differs from the session's."""
    if not identity.nodes:
        raise GuardError(
            f"arm {identity.serial_number} has no nodes: it cannot be moved or read",
            "check the bus and the arm file, then connect again",
        )
    known = state.serial_number
    if known and known != identity.serial_number:
        raise GuardError(
            f"this session belongs to arm {known}, and the arm on the bus is "
            f"{identity.serial_number}",
            "connect the right arm or start a new session",
        )
    if not state.poses:
        return
    changed = [
        f"node {node.node} ({node.role}) has serial number {node.serial_number}, "
        f"it had {state.node_serials[node.node]}"
        for node in identity.nodes
        if state.node_serials.get(node.node, node.serial_number) != node.serial_number
    ]
    if changed:
        raise GuardError(
            f"{'; '.join(changed)}: a replaced drive or sensor has another zero",
            "install the drive that the poses were captured with, or start a new session",
        )


def check_closure_by_poses(
    state: SessionState, procedure: Procedure, reading: Reading, endpoint: FloatArray | None
) -> tuple[float | None, tuple[int, ...]]:
    """Check whether the loop closes at the current pose as the captured poses predict.

    `endpoint`: measurement of the instrument at this pose, if any. Returns the probability of a larger chi2 (None with
    too few poses), and the joints (1-based) whose shift by `SHIFT_RAD` could not be detected at this pose. Raises
    ClosureRefusedError if the loop does not close: the arm or the fixture has changed.
    """
    from scipy.special import chdtri

    state = state.here
    here = MeasuredPose(
        number=0,
        mean_rad=reading.mean_rad,
        sd_rad=reading.sd_rad,
        samples=reading.samples,
        utc="",
        endpoint=() if endpoint is None else tuple(endpoint.tolist()),
    )
    arm, fixture = procedure.arm, fixture_in_place(state, procedure)
    near, as_predicted = None, True
    unresolved = tuple(range(1, arm.joint_count + 1))
    if fixture.holds_hand:
        pose_set, unsensed = state.pose_set(), procedure.unsensed_joints
        before = Experiment(arm=arm, fixture=fixture, poses=pose_set, unsensed=unsensed)
        near = innovation(before, pose_set_of([here]))
    if near is not None:
        limit = max(
            float(chdtri(near.dof, INNOVATION_PROBABILITY)), CHI2_RATIO_TO_WORST_POSE * near.usual
        )
        unresolved = near.unseen(SHIFT_RAD, CHI2_RATIO_TO_LIMIT * limit)
        as_predicted = near.chi2 <= limit
    fixed = parameters_from_poses(state, procedure)
    probability, closes = None, True
    if fixed is not None:
        poses, unsensed = pose_set_of([*state.used_poses, here]), fixed.unsensed_joints
        both = Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=unsensed)
        predicted = predict(both, fixed)
        probability, closes = float(predicted.pose_probability[-1]), bool(predicted.closed[-1])
        as_usual = (
            probability >= FALSE_REFUSAL_PROBABILITY
            or predicted.pose_chi2[-1] <= CHI2_RATIO_TO_WORST_POSE * predicted.pose_chi2[:-1].max()
        )
        as_predicted = bool(as_predicted and closes and as_usual)
    if not as_predicted:
        raise _refusal(near, state, procedure, reading, probability=probability, closes=closes)
    return probability, unresolved


def _refusal(
    near: Innovation | None,
    state: SessionState,
    procedure: Procedure,
    reading: Reading,
    *,
    probability: float | None,
    closes: bool,
) -> ClosureRefusedError:
    """Return the error, with its likely cause, for a reading that contradicts the captured poses.

    `near`: innovation of the reading; None for an open arm, or if the poses cannot be fitted.
    `probability`: probability of a larger chi2 with the parameters from the poses; None if there are no parameters.
    `closes`: whether the loop can close with these parameters.
    """
    from scipy.special import chdtrc

    arm, poses = procedure.arm, len(state.used_poses)
    probability = 1.0 if probability is None else probability
    if near is not None:
        probability = min(probability, float(chdtrc(near.dof, near.chi2)))
    times = counters_near_zero(arm, reading.mean_rad)
    zeros = sorted(j for j, t in times.items() if t <= NEAR_ZERO_RATIO)
    if zeros:
        return ClosureRefusedError(
            reset_text(zeros, zero_position(arm, reading.mean_rad, zeros)),
            f"home {joints_named(zeros)}; {NEW_SESSION_REMEDY}",
            probability=probability,
        )
    size = f"{probability:.0e}" if probability > LEAST_STATED_PROBABILITY else "below 1e-12"
    probability_text = "" if not closes else f" (probability {size})"
    happened = (
        f"the loop does not close at the present pose, according to this session's {poses} "
        f"poses{probability_text}: {_cause_text(near)}"
    )
    if not procedure.fixture.fixture.holds_hand:
        happened = (
            f"the tracker does not measure the target where this session's {poses} poses "
            f"predict it{probability_text}: a joint's zero, the target or the tracker has changed"
        )
    return ClosureRefusedError(happened, NEW_SESSION_REMEDY, probability=probability)


def _cause_text(near: Innovation | None) -> str:
    from scipy.special import chdtrc

    if near is not None and near.dof > 1:
        joint, shift = max(near.shifts.items(), key=lambda item: item[1].explains)
        others = max((s.explains for j, s in near.shifts.items() if j != joint), default=0.0)
        alone = float(chdtrc(near.dof - 1, near.chi2 - shift.explains)) >= REMAINDER_PROBABILITY
        if alone and shift.explains - others > 2.0 * np.log(JOINT_ODDS):
            return (
                f"joint {joint} seems to have shifted by {POSITION(shift.size_rad).with_unit} (sigma "
                f"{SLIP_SIGMA(shift.sigma_rad).with_unit})"
            )
    return "a joint's zero or the fixture has changed"


def fixture_in_place(state: SessionState, procedure: Procedure) -> EndpointConstraint:
    """Return the fixture of the session. A fixture that is an instrument is given its place in the arm's base frame.

    The place is the calibrated one. Without a calibration, it is that of the file, or else is fitted to the poses.
    """
    known = journal_calibration(state)
    fixture = procedure.fixture.fixture
    if isinstance(known, StoredCalibration):
        return with_calibrated_places(fixture, known.solution.model)
    return with_registered_instrument(procedure.arm, fixture, state.pose_set())


def parameters_from_poses(state: SessionState, procedure: Procedure) -> Fixed | None:
    """Return the parameters of the recorded calibration or, if there is none, of a quick fit; None if the fit fails.

    The quick fit is precise enough to detect shifts of degrees or millimetres.
    """
    known = journal_calibration(state)
    if isinstance(known, StoredCalibration):
        solution = known.solution
        return Fixed(solution.estimate, solution.model.unsensed_joints, solution.components)
    experiment = Experiment(
        arm=procedure.arm,
        fixture=fixture_in_place(state, procedure),
        poses=state.pose_set(),
        unsensed=procedure.unsensed_joints,
    )
    try:
        estimate = estimate_implicit(
            experiment.loop(), experiment.poses.q_rad, stated_noise(experiment)
        )
    except (SolverError, FixtureError, np.linalg.LinAlgError):
        return None
    if not estimate.converged or not np.isfinite(estimate.covariance).all():
        return None
    return Fixed(estimate, experiment.unsensed)
