"""Is this still the arm, and still the fixture, that the journal's poses were taken on? Moves nothing.

A session that goes on after a break asks before its drives are enabled: who the nodes are, whether a
counter begins anew at zero, whether the loop closes where the arm stands; and once it may move, it reads
an old pose again. Knows no bus and no screen; refuses in words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import Fixture
from fixtures.errors import FixtureError
from fixtures.measured import Measured
from hardware.arm import ArmIdentity, Reading
from operator_app.calibration.closed_loops import loop_of_poses
from operator_app.calibration.innovation import Innovation, innovation
from operator_app.calibration.instrument_registration import as_calibrated, as_seen
from operator_app.calibration.repeat_measurement import Repeat, compare_readings
from operator_app.calibration.verification import Fixed, fixed_by, judge_poses, stated_noise
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError, StandingRefusedError
from operator_app.session.safety.counter_reset import from_zero, where_near
from operator_app.session.store.state import CheckReading, SessionState, pose_set_of
from operator_app.session.store.stored_calibration import StoredCalibration, recorded
from operator_app.units.figure import POSITION, SHIFTED, SLIP_SIGMA, TURNED
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.rotations import rotation_matrix
from solver.chain.sensors import NoSensor
from solver.errors import SolverError
from solver.estimators.implicit import estimate_implicit

REMOUNTED_M, REMOUNTED_RAD = 4e-3, float(np.deg2rad(1.0))
"""More than a slender fixture bends (paper, section 4); less may be that, and the verdict tells."""

IMPROBABLE = 1e-4
"""Chance of refusing an arm and a fixture that are the same."""

UNEXPECTED = 1e-6
"""The same by the poses near it, curves of sensors known: of arms three times worse than stated none in 105."""

WORSE = 4.0
"""Times the worst chi2 of the session's own poses: where the model is wrong, theirs is large as well."""

SHIFT_RAD = float(np.deg2rad(2.0))
"""A joint's shift that is to be seen before the arm moves farther than it takes to see it."""

CLEARLY = 2.0
"""Times the chi2 that is refused, which a shift brings on average where it is said to be seen."""

NEAR_ENOUGH = 100.0
"""Times as far from zero as a counter that has just begun anew: where something is wrong, it is that one.

A joint stands there in one of 300 places.
"""

NOT_EXPLAINED = 1e-3
"""Chance of what a joint's shift leaves, below which it is not named."""

SURE = 100.0
"""Times likelier than the fixture, a joint is named where nobody is asked to do anything about it first."""

_START_ANEW = "find out what was changed; poses before and after it do not belong together: start a new session"


@dataclass(frozen=True, slots=True, kw_only=True)
class PoseReport:
    """What the journal's poses say of where the arm stands.

    `told` is what was found, in a sentence; `probability` the chance of a pose that fits worse, None
    where there are too few poses to say. Of `unseen` joints a shift of `SHIFT_RAD` might not show there.
    """

    told: str
    probability: float | None
    unseen: tuple[int, ...] = ()


def check_identity(state: SessionState, identity: ArmIdentity) -> None:
    """Refuse an arm that does not say who it is, or is another than the session's.

    Raises
    ------
    GuardError
    """
    if not identity.nodes:
        raise GuardError(
            f"arm {identity.serial_number} has no nodes: nothing there can be moved or read",
            "look at the bus and at the arm file, then connect again",
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
            f"{_together(changed)}: the zero of a joint goes with its drive and sensor",
            "put the drive back that the poses were taken with, or start a new session",
        )


def check_standing(
    state: SessionState,
    procedure: Procedure,
    reading: Reading,
    endpoint: FloatArray | None = None,
) -> PoseReport:
    """Close the loop where the arm stands, by the poses of the journal; `endpoint` as measured there.

    Raises
    ------
    StandingRefusedError
        It does not close there: something is another than it was.
    """
    from scipy.special import chdtrc, chdtri

    state = state.here
    here = CheckReading(
        kind="standing",
        number=0,
        mean_rad=reading.mean_rad,
        sd_rad=reading.sd_rad,
        samples=reading.samples,
        utc="",
        endpoint=() if endpoint is None else tuple(endpoint.tolist()),
    )
    arm, fixture = procedure.arm, _placed(state, procedure)
    near, unseen, unexpected = None, tuple(range(1, arm.joint_count + 1)), False
    if fixture.holds_hand:
        near = innovation(
            arm,
            fixture,
            state.pose_set(),
            pose_set_of([here]),
            unsensed_joints=procedure.unsensed_joints,
        )
    if near is not None:
        limit = max(float(chdtri(near.dof, UNEXPECTED)), WORSE * near.usual)
        unseen, unexpected = near.unseen(SHIFT_RAD, CLEARLY * limit), near.chi2 > limit
    fixed = _fixed(state, procedure)
    if fixed is None and not unexpected:
        return PoseReport(
            told="The poses so far are too few to tell whether the loop closes where the arm stands.",
            probability=None,
            unseen=unseen,
        )
    closes, probability = True, 1.0
    if fixed is not None:
        poses = pose_set_of([*state.used_poses, here])
        found = judge_poses(arm, fixture, poses, fixed).verification
        probability, closes = float(found.pose_probability[-1]), bool(found.closed[-1])
        worst = float(found.pose_chi2[:-1].max())
        as_usual = probability >= IMPROBABLE or found.pose_chi2[-1] <= WORSE * worst
        if closes and as_usual and not unexpected:
            return PoseReport(
                told="The loop closes where the arm stands, by the poses so far.",
                probability=probability,
                unseen=unseen,
            )
    if near is not None:
        probability = min(probability, float(chdtrc(near.dof, near.chi2)))
    times = from_zero(arm, reading.mean_rad)
    zeros = sorted(j for j, t in times.items() if t <= NEAR_ENOUGH)
    if zeros:
        raise StandingRefusedError(
            f"the counter of joint {' and '.join(map(str, zeros))} stands {where_near(arm, reading.mean_rad, zeros)}, "
            "and with it the loop does not close where the arm stands: it began anew, as after a loss of power",
            f"home the joint; {_START_ANEW}",
            probability=probability,
        )
    off = "" if not closes else f" (chance {probability:.0e})"
    if not fixture.holds_hand:
        raise StandingRefusedError(
            f"the target is not seen where this session's {len(state.used_poses)} poses have it{off}: a "
            "joint's zero, the target or the tracker is not what it was",
            _START_ANEW,
            probability=probability,
        )
    raise StandingRefusedError(
        f"the loop does not close where the arm stands, by this session's {len(state.used_poses)} "
        f"poses{off}: {_what_shifted(near)}",
        _START_ANEW,
        probability=probability,
    )


def _what_shifted(near: Innovation | None) -> str:
    """Name the joint whose shift alone explains what is left of a reading."""
    from scipy.special import chdtrc

    if near is not None and near.dof > 1:
        joint, shift = max(near.shifts.items(), key=lambda item: item[1].explains)
        others = max((s.explains for j, s in near.shifts.items() if j != joint), default=0.0)
        alone = float(chdtrc(near.dof - 1, near.chi2 - shift.explains)) >= NOT_EXPLAINED
        if alone and shift.explains - others > 2.0 * np.log(SURE):
            return (
                f"joint {joint} reads as if it had shifted by {POSITION(shift.size_rad).with_unit} (sigma "
                f"{SLIP_SIGMA(shift.sigma_rad).with_unit})"
            )
    return "a joint's zero or the fixture is not what it was"


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
            f"look at the coupling and the counter of joint {found.joint}; {_START_ANEW}",
        )
    if found.shifted_m > REMOUNTED_M or found.turned_rad > REMOUNTED_RAD:
        raise GuardError(
            f"pose {pose} does not read as it did: the fixture has moved by about "
            f"{SHIFTED(found.shifted_m).with_unit} and {TURNED(found.turned_rad).with_unit}",
            _START_ANEW,
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
    fixed = _fixed(state, procedure)
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
        give=fixture.give,
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
    fixture, pair = _placed(state, procedure), (last.first, last.again)
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
    joints = sum(joint_variance(arm, p.samples) for p in pair)
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
        _START_ANEW,
    )


def joint_variance(arm: ArmModel, samples: int) -> FloatArray:
    """Variance (n,) of the mean of so many readings, play included, rad^2."""
    return np.array(
        [
            0.0
            if isinstance(joint.sensor, NoSensor)
            else joint.sensor.variance_of_mean_rad2(samples) + joint.backlash_rad**2
            for joint in arm.joints
        ]
    )


def _placed(state: SessionState, procedure: Procedure) -> Fixture:
    """The fixture from whose nominal places `_fixed` counts."""
    known = recorded(state)
    fixture = procedure.fixture.fixture
    if isinstance(known, StoredCalibration):
        return as_calibrated(fixture, known.solution.model)
    return as_seen(procedure.arm, fixture, state.pose_set())


def _fixed(state: SessionState, procedure: Procedure) -> Fixed | None:
    """Return the parameters that the poses so far give; None where they do not give any yet.

    A calibration of these poses where there is one, else a quick fit by what the files state: what it
    is for is a change of degrees and millimetres.
    """
    known = recorded(state)
    if isinstance(known, StoredCalibration):
        return fixed_by(known.solution)
    arm, fixture = procedure.arm, _placed(state, procedure)
    poses, unsensed = state.pose_set(), procedure.unsensed_joints
    try:
        model = loop_of_poses(arm, fixture, poses, unsensed_joints=unsensed)
        nothing = Fixed(
            values={},
            covariance=np.zeros((0, 0)),
            rvdt_sd_rad={},
            fixture_variance=None,
            unsensed_joints=unsensed,
        )
        found = estimate_implicit(model, poses.q_rad, stated_noise(arm, fixture, poses, nothing))
    except (SolverError, FixtureError, np.linalg.LinAlgError):
        return None
    if not found.converged or not np.isfinite(found.covariance).all():
        return None
    values = {p.name: float(v) for p, v in zip(found.parameters, found.x, strict=True)}
    return replace(nothing, values=values, covariance=found.covariance)


def _together(facts: list[str]) -> str:
    return "; ".join(facts)
