"""Progress callbacks of a session; a user interface overrides the callbacks that it shows."""

from operator_app.session.store.state import SessionState
from solver.design.actions import GoTo


class Listener:
    """Base class of listeners; the methods are called in the thread of the session and do nothing by default."""

    def going(self, move: GoTo | None) -> None:
        """The arm is about to move; `move` is the move of a planned capture, None for any other motion."""

    def planning(self, *, active: bool) -> None:
        """Planning of the next poses begins if `active`, else it has ended. The arm stands still during planning."""

    def arrived(self, waypoint: int) -> None:
        """The arm is at a waypoint."""

    def pose_captured(self, state: SessionState, total: int) -> None:
        """A pose was captured; `total` is the number of required poses."""

    def report(self, text: str) -> None:
        """Show a message to the operator."""
