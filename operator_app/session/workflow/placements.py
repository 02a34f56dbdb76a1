"""Several mountings of one fixture: which is due, and what the journal keeps of each. Knows no arm and no screen.

A journal says `remounting` when the arm was let go so that the fixture can be taken off, and `remounted` when
somebody has said that it is mounted again. In between nothing connects: whoever stands there has a hand in it.
"""

from __future__ import annotations

from pathlib import Path

from operator_app.config.procedure import MOST_PLACEMENTS, Procedure
from operator_app.errors import GuardError, SessionError
from operator_app.session.store.journal import Journal
from operator_app.session.store.state import SessionState


def next_due(state: SessionState, procedure: Procedure) -> bool:
    """Whether the present placement has all its poses, its first one read again, and another is wanted."""
    return (
        state.placement < procedure.placements
        and len(state.poses_here) >= procedure.capture.poses
        and any(r.again.after == state.captured for r in state.returns)
    )


def require_mounted(state: SessionState) -> None:
    """Connect to no arm at whose fixture somebody may be at work."""
    if not state.mounted:
        raise GuardError(
            f"the fixture was taken off, and nobody said that it is mounted for placement {state.placement}",
            "mount it, stand clear, then go on with the session: sarcal run --resume, or the app",
        )


def keep_remounting(folder: Path, placement: int) -> None:
    """Keep in a session's journal that its fixture comes off, to be mounted for the n-th time."""
    _keep(folder, "remounting", placement)


def keep_remounted(folder: Path, placement: int) -> None:
    """Keep that somebody said it is mounted for the n-th time; no arm is connected."""
    _keep(folder, "remounted", placement)


def _keep(folder: Path, name: str, placement: int) -> None:
    journal = Journal.resume(folder)
    try:
        journal.append(name, {"placement": placement})
    finally:
        journal.close()


def require_mountable(procedure: Procedure, wanted: int) -> int:
    """Refuse what cannot be mounted so often."""
    if not 1 <= wanted <= MOST_PLACEMENTS:
        raise SessionError(
            f"{wanted} placements were asked for", f"ask for 1 to {MOST_PLACEMENTS} of them"
        )
    if wanted > 1 and not procedure.fixture.fixture.holds_hand:
        raise SessionError(
            f"{procedure.fixture.name} holds no hand: there is nothing to take off and mount anew",
            "leave --placements out",
        )
    if wanted > 1 and procedure.capture.strategy == "planned":
        raise SessionError(
            "a plan is made for one placement of the fixture",
            "capture explored poses (--plan explore) with --placements",
        )
    return wanted


def remounting_steps(procedure: Procedure) -> tuple[str, ...]:
    """Return what an operator does between two placements of a fixture, in order."""
    kept = procedure.fixture.fixture.stays_on_hand
    part = "; its part on the hand stays" if kept else " and off the hand"
    return (
        "1. Secure the arm against falling, by hand or by a strap. Somebody has a hand on the hardware stop.",
        f"2. Take the {procedure.fixture.name} off the table{part}.",
        "3. Mount it anew, turned and shifted within the tolerance that its file states.",
        "4. Bring the arm to its home, by hand or as its controller can; close the loop; go through the check list.",
    )
