"""What is asked of an arm's readings before its drives are enabled; whatever comes of it is in the journal.

Of several that ask: a counter near zero out of its range, the poses so far, and where these tell nothing, the
files with what earlier placements tell. Moves nothing; knows no bus and no screen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

import numpy as np

from hardware.arm import Reading
from operator_app.calibration.closure_gate import ClosureFit, LoopAtReading, loop_at_reading
from operator_app.calibration.prior import KnownArm, known_arm
from operator_app.config.procedure import Procedure
from operator_app.errors import ConnectAgainError, StandingRefusedError
from operator_app.session.safety.counter_reset import (
    SAGGED_RAD,
    check_counters,
    from_zero,
    where_near,
)
from operator_app.session.safety.resume_checks import PoseReport, check_standing
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import SessionState
from operator_app.units.figure import REACH, WHOLE_DEGREES
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel


def require_standing(
    session: Logbook, reading: Reading, endpoint: Callable[[], FloatArray | None]
) -> tuple[int, ...]:
    """Refuse readings that cannot be true where the arm stands; passed or refused, the journal keeps it and why.

    `endpoint` is asked where an instrument sees the hand, if there are poses to compare it with.

    Returns
    -------
    Joints that may have shifted since the poses so far, and would not show it where the arm stands.

    Raises
    ------
    StandingRefusedError
        Names the joint, where one joint explains it.
    """
    try:
        check_counters(session.model, reading.mean_rad)
        unseen: tuple[int, ...] = ()
        for found in _judged(session, reading, endpoint):
            unseen = unseen or found.unseen
            kept = {"told": found.told, "probability": found.probability, "refused": False}
            session.record("standing", kept)
    except StandingRefusedError as refused:
        why = {"told": refused.happened, "probability": refused.probability, "refused": True}
        session.record("standing", why)
        raise
    return unseen


def _judged(
    session: Logbook, reading: Reading, endpoint: Callable[[], FloatArray | None]
) -> Iterator[PoseReport]:
    procedure = session.procedure
    if session.state.poses_here:
        found = check_standing(session.state, procedure, reading, endpoint())
        yield found
        if found.probability is not None:
            return
    # Of one or two poses nothing is known yet but what the files say, and earlier placements.
    known = _known_by_earlier_placements(session.state, procedure)
    chance = check_first_standing(procedure, reading, known)
    if chance is not None:
        by = "" if known is None else "by the earlier placements and "
        yield PoseReport(
            told=f"The loop closes where the arm stands, {by}within what its files leave open.",
            probability=chance,
        )


def _known_by_earlier_placements(state: SessionState, procedure: Procedure) -> KnownArm | None:
    """What they tell of the arm; None of the first one."""
    earlier = tuple(p for p in state.used_poses if p.placement != state.placement)
    if not earlier or not procedure.fixture.fixture.holds_hand:
        return None
    return known_arm(
        procedure.arm,
        procedure.fixture.fixture,
        replace(state, poses=earlier).pose_set(),
        unsensed_joints=procedure.unsensed_joints,
    )


IMPROBABLE = 1e-12
"""Chance of refusing an arm that is as its files state, their tolerances being three standard deviations.

So small, as arms are about whose files are wrong in everything: offsets off by 25 deg, hinges by 40 mm and 15 deg.
"""

IMPROBABLE_OF_KNOWN = 1e-5
"""The same of an arm that earlier placements know: they tell its offsets, and how far its hinge may be off."""

IMPROBABLE_AT_ZERO = 1e-2
"""Chance of what believing a counter costs, below which one that stands at zero began anew.

By chance a joint stands there in one of 30,000 places: little else need speak against it. As near as ten times
that it stands ten times as often, and ten times as much has to.
"""

EXPECTED_AT_ZERO_RAD = float(np.deg2rad(5.0))
"""A joint whose home is as near to zero as this stands there often."""

IMPROBABLE_AT_HOME = 1e-6
"""The same of joints that are expected at zero."""

EXPLAINS = 1e-2
"""Chance of what is left, above which a joint alone explains why the loop does not close."""

AT_MOST_NAMED = 3


def check_first_standing(
    procedure: Procedure, reading: Reading, known: KnownArm | None = None
) -> float | None:
    """Refuse readings with which the loop cannot close where the arm stands.

    Parameters
    ----------
    known
        What poses in earlier placements of the fixture tell of the arm.

    Returns
    -------
    Chance of readings that fit worse; None where nothing holds the hand, and no loop is closed.

    Raises
    ------
    StandingRefusedError
        Names the joint that alone would close it, if there is one.
    """
    if not procedure.fixture.fixture.holds_hand:
        return None
    arm = procedure.arm
    loop = loop_at_reading(
        arm,
        procedure.fixture.fixture,
        reading.mean_rad,
        unsensed_joints=procedure.unsensed_joints,
        known=known,
    )
    found = loop.fit()
    chance = _chance(found)
    anew = _begun_anew(arm, loop, found)
    if anew:
        where = where_near(arm, reading.mean_rad, list(anew))
        remedy = _at_zero_remedy(list(anew), where)
        raise ConnectAgainError(_at_zero_words(anew, where), remedy, probability=chance)
    if chance >= (IMPROBABLE if known is None else IMPROBABLE_OF_KNOWN):
        return chance
    alone = _alone(loop)
    raise StandingRefusedError(_does_not_close(alone), _remedy(alone), probability=chance)


def _begun_anew(arm: ArmModel, loop: LoopAtReading, found: ClosureFit) -> dict[int, float]:
    """Joints whose counters began anew, and where they are instead (rad); empty where nothing says so.

    Of those near zero the nearest by themselves, then with the next one, and so on.
    """
    times = {j: t for j, t in from_zero(arm, loop.reading_rad).items() if j in loop.joints}
    for farthest in dict.fromkeys(times.values()):
        near = tuple(j for j, t in times.items() if t <= farthest)
        anew = _disbelieved(arm, loop, found, near, IMPROBABLE_AT_ZERO / farthest)
        if anew:
            return anew
    return {}


def _disbelieved(
    arm: ArmModel, loop: LoopAtReading, found: ClosureFit, zeros: tuple[int, ...], at_most: float
) -> dict[int, float]:
    """Those of `zeros` that began anew if believing them costs more than is likely by chance `at_most`.

    By how much chi2 falls when none of them is believed is what believing them costs: an arm whose files are
    wrong elsewhere has a large chi2 with and without them.
    """
    from scipy.special import chdtrc

    if all(abs(arm.home_rad[j - 1]) <= EXPECTED_AT_ZERO_RAD for j in zeros):
        at_most = min(at_most, IMPROBABLE_AT_HOME)
    without = loop.fit(*zeros)
    if not np.isfinite(without.chi2):
        return {}
    freed = found.dof - without.dof
    if chdtrc(freed, found.chi2 - without.chi2) >= at_most:
        return {}
    for joint, alone in sorted(_fits(loop, zeros).items(), key=lambda item: item[1].chi2):
        more = alone.dof - without.dof
        if more == 0 or chdtrc(more, max(alone.chi2 - without.chi2, 0.0)) >= EXPLAINS:
            return {joint: float(alone.q_rad[joint - 1])}
    return {j: float(without.q_rad[j - 1]) for j in zeros}


def _at_zero_words(anew: dict[int, float], where: str) -> str:
    if len(anew) == 1:
        ((joint, near),) = anew.items()
        return (
            f"the counter of joint {joint} stands {where}, and with it the loop does not close where the arm "
            f"stands: it would with that joint near {REACH(near).with_unit}. Its counter began anew, as "
            "after a loss of power"
        )
    instead = " and ".join(f"joint {j} near {REACH(near).with_unit}" for j, near in anew.items())
    return (
        f"the counters of joints {' and '.join(map(str, anew))} stand {where}, and with them the loop does not "
        f"close where the arm stands: it would with {instead}. They began anew, as after a loss of power"
    )


def _at_zero_remedy(joints: list[int], where: str) -> str:
    named = f"joint {' and '.join(map(str, joints))}"
    return (
        f"home {named}, then connect again; moved by this reading it would go elsewhere. If it really stands "
        f"{where}, bring it {WHOLE_DEGREES(2.0 * SAGGED_RAD).with_unit} away by hand while its drives are off"
    )


def _does_not_close(alone: dict[int, ClosureFit]) -> str:
    said = "the loop cannot close where the arm stands, with these readings and all that the files leave open"
    if not alone:
        return f"{said}, whichever joint's reading is left out"
    joints = list(alone)[:AT_MOST_NAMED]
    would = " or ".join(f"joint {j} near {_near(alone[j], j)}" for j in joints)
    return f"{said}; it would with {would}"


def _remedy(alone: dict[int, ClosureFit]) -> str:
    likeliest = next(iter(alone), None)
    what = (
        "the zeros, directions and order of the joints"
        if likeliest is None
        else f"the zero of joint {likeliest} (a counter that began anew) and its direction, first"
    )
    return (
        f"move nothing by these readings. Look at {what}; then at the profile, at whether this fixture's file "
        "is the right one, and at whether it holds the hand. Where offsets or placement are less well known "
        "than within 10 deg and the fixture's tolerance, state it: offset_tolerance_deg in the arm file, "
        "tolerance_mm and tolerance_deg in the fixture's"
    )


def _near(fit: ClosureFit, joint: int) -> str:
    return REACH(float(fit.q_rad[joint - 1])).with_unit


def _alone(loop: LoopAtReading) -> dict[int, ClosureFit]:
    """Joints that alone explain it, the likeliest first."""
    explain = {j: f for j, f in _fits(loop, loop.joints).items() if _chance(f) >= EXPLAINS}
    return dict(sorted(explain.items(), key=lambda item: item[1].chi2))


def _fits(loop: LoopAtReading, joints: tuple[int, ...]) -> dict[int, ClosureFit]:
    """Close it without each of these joints' readings in turn."""
    return {j: loop.fit(j) for j in joints}


def _chance(found: ClosureFit) -> float:
    from scipy.special import chdtrc

    return float(chdtrc(found.dof, found.chi2)) if np.isfinite(found.chi2) else 0.0
