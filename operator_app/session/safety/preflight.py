"""What is asked of an arm's readings before its drives are enabled; whatever comes of it is in the journal.

Of several that ask: a counter near zero out of its range, the poses so far, and where these tell nothing, the
files with what earlier placements tell. Moves nothing; knows no bus and no screen.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator
from dataclasses import replace

from hardware.arm import Reading
from operator_app.calibration.prior import KnownArm, known_arm
from operator_app.config.procedure import Procedure
from operator_app.errors import StandingRefusedError
from operator_app.session.safety.closure_check import check_first_standing
from operator_app.session.safety.counter_reset import check_counters
from operator_app.session.safety.resume_checks import PoseReport, check_standing
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import SessionState
from solver.arrays import FloatArray


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
