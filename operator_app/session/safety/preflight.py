"""Checks the joint readings before the drives are enabled, and records the result. Moves nothing.

The checks, in order:

1. No joint reads near zero if its range excludes zero. Such a reading would mean that its counter was reset.
2. The loop closes as the captured poses predict.
3. If there are too few poses for check 2, the loop closes within the tolerances of arm file and fixture file.

With readings that do not close the loop (counter reset, wrong direction, wrong joint order), the drives would move the
arm to unintended positions.
"""

from collections.abc import Callable

import numpy as np

from hardware.arm import Reading
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.prior import KnownArm, known_arm
from operator_app.config.procedure import Procedure
from operator_app.errors import ClosureRefusedError, ConnectAgainError
from operator_app.session.safety.closure_gate import ClosureFit, LoopAtReading
from operator_app.session.safety.resume_checks import (
    MAX_SAG_RAD,
    check_closure_by_poses,
    check_counters,
    counters_near_zero,
    reset_text,
    zero_position,
)
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import SessionState, pose_set_of
from operator_app.units import REACH, WHOLE_DEGREES, joints_named, names
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel


def require_plausible_readings(
    session: Logbook, reading: Reading, endpoint: Callable[[], FloatArray | None]
) -> tuple[int, ...]:
    """Refuse joint readings that cannot be correct, and record the result in the journal.

    `endpoint`: function that measures the tool with the instrument; called only if the current placement has poses.
    Returns the joints (1-based) whose shift could not be detected at the current pose. If the readings are refused,
    raises ClosureRefusedError, whose message names joints that may be the cause.
    """

    def record(text: str, probability: float | None, *, refused: bool = False) -> None:
        data = {"told": text, "probability": probability, "refused": refused}
        session.record("standing", data)

    procedure, probability = session.procedure, None
    unresolved: tuple[int, ...] = ()
    try:
        check_counters(session.model, reading.mean_rad)
        if session.state.poses_here:
            probability, unresolved = check_closure_by_poses(
                session.state, procedure, reading, endpoint()
            )
            text = "The loop closes at the present pose, as the earlier poses predict."
            if probability is None:
                text = "There are too few poses to check the closure at the present pose."
            record(text, probability)
        if probability is None:
            known = _arm_from_earlier_placements(session.state, procedure)
            probability = check_closure_without_poses(procedure, reading, known)
            by = "" if known is None else "with the offsets of the earlier placements and "
            text = f"The loop closes at the present pose, {by}within the tolerances of the files."
            if probability is not None:
                record(text, probability)
    except ClosureRefusedError as refused:
        record(refused.happened, refused.probability, refused=True)
        raise
    return unresolved


def _arm_from_earlier_placements(state: SessionState, procedure: Procedure) -> KnownArm | None:
    earlier = tuple(p for p in state.used_poses if p.placement != state.placement)
    if not earlier or not procedure.fixture.fixture.holds_hand:
        return None
    poses, fixture = pose_set_of(earlier), procedure.fixture.fixture
    unsensed = procedure.unsensed_joints
    return known_arm(Experiment(arm=procedure.arm, fixture=fixture, poses=poses, unsensed=unsensed))


LOOP_FALSE_REFUSAL_PROBABILITY = 1e-12
"""Probability of refusing an arm within the tolerances of its files; a tolerance is taken as three standard deviations.
The probability is this small because files can be inaccurate: offsets by 25 deg, hinges by 40 mm and 15 deg."""

FALSE_REFUSAL_PROBABILITY_KNOWN_ARM = 1e-5
"""Probability of refusing a correct reading if offsets and placement error are known from earlier placements."""

RESET_PROBABILITY = 1e-2
"""A counter within `AT_ZERO_COUNTS` counts of zero counts as reset if its reading increases chi2 by an amount that is
less probable than this. By chance, a joint is so near to zero in one of 30,000 positions, and within k times this
distance in k of 30,000. So for a reading at k times this distance, the probability has to be k times smaller."""

HOME_AT_ZERO_RAD = float(np.deg2rad(5.0))
"""A joint whose home is within this distance of zero is often at zero."""

RESET_PROBABILITY_HOME_AT_ZERO = 1e-6
"""Largest limit instead of `RESET_PROBABILITY` if the homes of all tested joints are within `HOME_AT_ZERO_RAD` of 0."""

EXPLAINED_PROBABILITY = 1e-2
"""A joint alone explains the closure error if, without its reading, chi2 is exceeded with at least this probability."""

MAX_NAMED_JOINTS = 3


def check_closure_without_poses(
    procedure: Procedure, reading: Reading, known: KnownArm | None = None
) -> float | None:
    """Refuse readings with which the loop cannot close within the tolerances of arm file and fixture file.

    `known`: information on the arm from earlier placements of the fixture. Returns the probability of a larger chi2;
    None for an open arm. Raises ClosureRefusedError if the loop cannot close or a counter was reset. The message names
    joints; a wrong reading of any one of them would explain the closure error.
    """
    if not procedure.fixture.fixture.holds_hand:
        return None
    arm, loop = procedure.arm, LoopAtReading(procedure, reading.mean_rad, known)
    closure = loop.fit()
    probability = _probability(closure)
    reset = _reset_counters(arm, loop, closure)
    if reset:
        where = zero_position(arm, reading.mean_rad, list(reset))
        remedy = (
            f"home {joints_named(list(reset))}, then connect again. If a joint really is {where}, move it by "
            f"hand by {WHOLE_DEGREES(2.0 * MAX_SAG_RAD).with_unit} while its drives are off"
        )
        closed_at = names(f"joint {j} near {REACH(q).with_unit}" for j, q in reset.items())
        text = reset_text(list(reset), where, f"; it closes with {closed_at}")
        raise ConnectAgainError(text, remedy, probability=probability)
    least = LOOP_FALSE_REFUSAL_PROBABILITY if known is None else FALSE_REFUSAL_PROBABILITY_KNOWN_ARM
    if probability >= least:
        return probability
    # Joints each of which alone explains the closure error, the most likely first.
    fits = _fits_without(loop, loop.joints)
    explaining = {j: f for j, f in fits.items() if _probability(f) >= EXPLAINED_PROBABILITY}
    raise ClosureRefusedError(
        _not_closing_text(explaining), _not_closing_remedy(explaining), probability=probability
    )


def _reset_counters(arm: ArmModel, loop: LoopAtReading, closure: ClosureFit) -> dict[int, float]:
    """Return, by joint, the estimated angle (rad) of each joint whose counter was reset; empty for none.

    First tests the joint nearest to zero alone, then the two nearest joints together, and so on.
    """
    times = {j: t for j, t in counters_near_zero(arm, loop.reading_rad).items() if j in loop.joints}
    for farthest in dict.fromkeys(times.values()):
        near = tuple(j for j, t in times.items() if t <= farthest)
        if reset := _reset_among(arm, loop, closure, near, RESET_PROBABILITY / farthest):
            return reset
    return {}


def _reset_among(
    arm: ArmModel, loop: LoopAtReading, closure: ClosureFit, near: tuple[int, ...], at_most: float
) -> dict[int, float]:
    """Return, by joint, the estimated angle (rad) of each joint whose counter was reset; empty for none.

    Joints `near` zero count as reset if ignoring their readings lowers chi2 so much that a larger decrease has a
    probability below `at_most`. The total chi2 is not tested, because errors in the files alone can raise it.
    """
    from scipy.special import chdtrc

    if all(abs(arm.home_rad[j - 1]) <= HOME_AT_ZERO_RAD for j in near):
        at_most = min(at_most, RESET_PROBABILITY_HOME_AT_ZERO)
    without = loop.fit(*near)
    if not np.isfinite(without.chi2):
        return {}
    freed = closure.dof - without.dof
    if chdtrc(freed, max(closure.chi2 - without.chi2, 0.0)) >= at_most:
        return {}
    for joint, explaining in _fits_without(loop, near).items():
        more = explaining.dof - without.dof
        if (
            more == 0
            or chdtrc(more, max(explaining.chi2 - without.chi2, 0.0)) >= EXPLAINED_PROBABILITY
        ):
            return {joint: float(explaining.q_rad[joint - 1])}
    return {j: float(without.q_rad[j - 1]) for j in near}


def _not_closing_text(explaining: dict[int, ClosureFit]) -> str:
    text = (
        "the loop cannot close with the present joint readings, within the tolerances of the files"
    )
    if not explaining:
        return f"{text}; ignoring any one joint's reading does not help"
    joints = list(explaining)[:MAX_NAMED_JOINTS]
    near = {j: REACH(float(explaining[j].q_rad[j - 1])).with_unit for j in joints}
    would = " or ".join(f"joint {j} near {angle}" for j, angle in near.items())
    return f"{text}; it closes with {would}"


def _not_closing_remedy(explaining: dict[int, ClosureFit]) -> str:
    what = "the zeros, directions and order of the joints"
    if explaining:
        what = f"the zero of joint {next(iter(explaining))} (counter reset) and its direction"
    return (
        f"do not move the arm with these readings. First check {what}; then the bus profile, the fixture file, and "
        "whether the loop is closed. If offsets are known to less than 10 deg or the placement to less than "
        "the fixture's tolerance, state it: offset_tolerance_deg in the arm file, tolerance_mm and "
        "tolerance_deg in the fixture file"
    )


def _fits_without(loop: LoopAtReading, joints: tuple[int, ...]) -> dict[int, ClosureFit]:
    """Return, by joint, the closure fitted without the reading of that joint, in order of increasing chi2."""
    fits = {j: loop.fit(j) for j in joints}
    return dict(sorted(fits.items(), key=lambda item: item[1].chi2))


def _probability(closure: ClosureFit) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(closure.dof, closure.chi2)) if np.isfinite(closure.chi2) else 0.0
