"""Several placements of one fixture: when the next is due, and the journal events of remounting.

Event `remounting`: the arm was released, and the fixture may be taken off. Event `remounted`: the operator has
confirmed that the fixture is mounted. In between, the session refuses to connect, since a person is working at the arm.
"""

from contextlib import closing
from pathlib import Path
from typing import Literal

from operator_app.config.procedure import MOST_PLACEMENTS, Procedure
from operator_app.errors import GuardError, SessionError
from operator_app.session.store.journal import Journal
from operator_app.session.store.state import SessionState
from operator_app.units import ANGLE_TOLERANCE, LENGTH_TOLERANCE


def next_due(state: SessionState, procedure: Procedure) -> bool:
    """Whether the next placement is due: the current one has all its poses and a final repeat, and is not the last."""
    return (
        state.placement < procedure.placements
        and len(state.poses_here) >= procedure.capture.poses
        and state.repeated_since_capture
    )


def require_mounted(state: SessionState) -> None:
    """Raise GuardError until the operator has confirmed that the fixture is mounted: a person may be working at it."""
    if not state.mounted:
        raise GuardError(
            f"the fixture was taken off, and its mounting for placement {state.placement} is not confirmed",
            "mount it, stand clear, then go on with the session: sarcal run --resume, or the app",
        )


def record_in(folder: Path, event: Literal["remounting", "remounted"], placement: int) -> None:
    """Record `event` for `placement` in the journal of a closed session."""
    with closing(Journal.resume(folder)) as journal:
        journal.append(event, {"placement": placement})


def mounting_problem(procedure: Procedure, count: int) -> SessionError | None:
    """Return the error if the procedure does not allow `count` placements; None if it does."""
    if not 1 <= count <= MOST_PLACEMENTS:
        happened = f"a session has 1 to {MOST_PLACEMENTS} placements of the fixture, not {count}"
        return SessionError(happened, f"request 1 to {MOST_PLACEMENTS}")
    if count > 1 and not procedure.fixture.fixture.holds_hand:
        return SessionError(
            f"{procedure.fixture.name} is an instrument: there is no fixture to remount",
            "leave --placements out",
        )
    if count > 1 and procedure.capture.strategy == "planned":
        return SessionError(
            "a planned capture has one placement of the fixture",
            "capture explored poses (--plan explore) with --placements",
        )
    return None


def remounting_steps(procedure: Procedure) -> tuple[str, ...]:
    """Return the instructions for remounting the fixture between two placements, one per step."""
    fixture, limits = procedure.fixture.fixture, procedure.fixture.fixture.tolerance
    length, angle = LENGTH_TOLERANCE(limits.position_m), ANGLE_TOLERANCE(limits.orientation_rad)
    part = "; its part on the tool stays" if fixture.stays_on_hand else " and off the tool"
    return (
        "1. Secure the arm against falling, by hand or by a strap, with a second person at the hardware stop.",
        f"2. Take the fixture off the table{part}.",
        f"3. Mount it again, shifted and turned within its tolerance (±{length.with_unit}, ±{angle.with_unit}).",
        "4. Move the arm to its home, by hand or with its controller; close the loop; go through the check list.",
    )
