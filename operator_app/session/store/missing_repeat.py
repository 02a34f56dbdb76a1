"""Poses after which the arm never went back to its first: what that leaves untested. Knows no arm and no screen."""

from __future__ import annotations

from typing import TYPE_CHECKING

from operator_app.calibration.notices import Notice

if TYPE_CHECKING:
    from operator_app.session.store.state import SessionState

NO_WAY_BACK = "no way back to it is planned from here"
"""Why a planned capture does not read its first pose once more: it would say so again at every resume."""


def unreturned_notices(state: SessionState) -> tuple[Notice, ...]:
    """Say for each placement whether its first pose was read once more after its last; nothing where it was."""
    if state.imported:
        # Nobody knows what was read again.
        return ()
    numbers = dict.fromkeys(p.placement for p in state.used_poses)
    return tuple(
        notice for k in numbers if (notice := _of_placement(state, k, several=len(numbers) > 1))
    )


def _of_placement(state: SessionState, placement: int, *, several: bool) -> Notice | None:
    here = [p.number for p in state.used_poses if p.placement == placement]
    again = [r for r in state.returns if r.first.placement == placement]
    if any(r.again.after >= here[-1] for r in again):
        return None
    why = "the capture ended before that"
    if placement == state.placement and state.return_missed:
        why = state.return_missed
    where = f" of placement {placement}" if several else ""
    before = max((r.again.after for r in again), default=0)
    since = f"pose {before}" if before else f"pose {here[0]}"
    remedy = "verify the calibration by new poses (sarcal verify with this session)"
    if placement == state.placement and why != NO_WAY_BACK:
        remedy = (
            "let the capture run to its end, which reads it (sarcal run --resume with this session), and "
            "calibrate again"
        )
    return Notice(
        code="NO_RETURN",
        text=f"pose {here[0]}{where} was not read once more after pose {here[-1]} ({why}): whether a joint or "
        f"the fixture slipped since {since} is told by the poses alone, which show a slip in the last ones "
        f"badly; {remedy}",
    )
