"""Is this still the arm, and still the fixture, that the journal's poses were taken on? Moves nothing.

A session that goes on after a break asks before its drives are enabled: who the nodes are, whether a
counter begins anew at zero, whether the loop closes where the arm stands. `return_check` is asked once it may move.
Knows no bus and no screen; refuses in words.
"""

from __future__ import annotations

from dataclasses import dataclass, replace

import numpy as np

from fixtures.base import Fixture, FixtureError
from hardware.arm import ArmIdentity, Reading
from operator_app.calibration.closed_loops import loop_of_poses
from operator_app.calibration.innovation import Innovation, innovation
from operator_app.calibration.instrument_registration import (
    with_calibrated_places,
    with_registered_instrument,
)
from operator_app.calibration.verification import (
    Fixed,
    fixed_calibration,
    stated_noise,
    verify_poses,
)
from operator_app.config.procedure import Procedure
from operator_app.errors import GuardError, StandingRefusedError
from operator_app.session.safety.counter_reset import from_zero, where_near
from operator_app.session.store.state import CheckReading, SessionState, pose_set_of
from operator_app.session.store.stored_calibration import StoredCalibration, recorded
from operator_app.units.figure import POSITION, SLIP_SIGMA
from solver.arrays import FloatArray
from solver.errors import SolverError
from solver.estimators.implicit import estimate_implicit

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

START_ANEW = "find out what was changed; poses before and after it do not belong together: start a new session"


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
    arm, fixture = procedure.arm, placed(state, procedure)
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
    fixed = fixed_by_poses(state, procedure)
    if fixed is None and not unexpected:
        return PoseReport(
            told="The poses so far are too few to tell whether the loop closes where the arm stands.",
            probability=None,
            unseen=unseen,
        )
    closes, probability = True, 1.0
    if fixed is not None:
        poses = pose_set_of([*state.used_poses, here])
        found = verify_poses(arm, fixture, poses, fixed).verification
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
            f"home the joint; {START_ANEW}",
            probability=probability,
        )
    off = "" if not closes else f" (chance {probability:.0e})"
    if not fixture.holds_hand:
        raise StandingRefusedError(
            f"the target is not seen where this session's {len(state.used_poses)} poses have it{off}: a "
            "joint's zero, the target or the tracker is not what it was",
            START_ANEW,
            probability=probability,
        )
    raise StandingRefusedError(
        f"the loop does not close where the arm stands, by this session's {len(state.used_poses)} "
        f"poses{off}: {_what_shifted(near)}",
        START_ANEW,
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


def placed(state: SessionState, procedure: Procedure) -> Fixture:
    """The fixture from whose nominal places `fixed_by_poses` counts."""
    known = recorded(state)
    fixture = procedure.fixture.fixture
    if isinstance(known, StoredCalibration):
        return with_calibrated_places(fixture, known.solution.model)
    return with_registered_instrument(procedure.arm, fixture, state.pose_set())


def fixed_by_poses(state: SessionState, procedure: Procedure) -> Fixed | None:
    """Return the parameters that the poses so far give; None where they do not give any yet.

    A calibration of these poses where there is one, else a quick fit by what the files state: what it
    is for is a change of degrees and millimetres.
    """
    known = recorded(state)
    if isinstance(known, StoredCalibration):
        return fixed_calibration(known.solution)
    arm, fixture = procedure.arm, placed(state, procedure)
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
