"""Who wants to know how a session goes on. Hears nothing by default; faces override what they show."""

from __future__ import annotations

from fixtures.base import SetupCheck
from hardware.arm import ArmIdentity
from operator_app.calibration.result import Solution
from operator_app.planning.drives import DriveChoice
from operator_app.session.store.state import SessionState
from solver.design.actions import GoTo


class Listener:
    """Called from the thread that works on the session."""

    def connected(self, identity: ArmIdentity) -> None:
        """The arm has been found and checked."""

    def fixture_checked(self, checks: tuple[SetupCheck, ...]) -> None:
        """The placement has been judged."""

    def drives_chosen(self, choice: DriveChoice) -> None:
        """The program has chosen the drive joints."""

    def modes_set(self, position_joints: tuple[int, ...]) -> None:
        """Every drive has confirmed its mode."""

    def going(self, move: GoTo | None) -> None:
        """The arm is about to move; `move` says where a plan takes it."""

    def arrived(self, waypoint: int) -> None:
        """The arm is at a waypoint."""

    def pose_captured(self, state: SessionState, wanted: int) -> None:
        """There is one more pose, of so many."""

    def told(self, text: str) -> None:
        """Something was decided, in a sentence."""

    def solved(self, solution: Solution) -> None:
        """The calibration is done."""
