"""`sarcal run` without the words: the steps of a session in order, and what each of them told.

Knows a session and a listener; prints nothing, so that tests and other front ends can drive it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fixtures.base import SetupCheck
from hardware.arm import ArmIdentity
from operator_app.calibration import Solution
from operator_app.session.errors import GuardError
from operator_app.session.export import Exported
from operator_app.session.state import SessionState
from operator_app.session.workflow import Session


class Listener(Protocol):
    """Hears how a run goes on; called from the thread that runs it."""

    def connected(self, identity: ArmIdentity) -> None:
        """Called when the arm has been found and checked."""
        ...

    def fixture_checked(self, checks: tuple[SetupCheck, ...]) -> None:
        """Called when the placement has been judged."""
        ...

    def modes_set(self, position_joints: tuple[int, ...]) -> None:
        """Called when every drive confirmed its mode."""
        ...

    def pose_captured(self, state: SessionState, wanted: int) -> None:
        """Called after each pose."""
        ...

    def solved(self, solution: Solution) -> None:
        """Called when the calibration is done."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """What a run came to. `exported` is None when the calibration was not accepted."""

    solution: Solution
    exported: Exported | None


def run(session: Session, listener: Listener) -> RunResult:
    """Go from Connect to Export; every refusal is raised with its reason.

    A resumed session goes through Connect, Fixture and Modes again: the arm may have been moved.
    """
    position_joints = session.procedure.position_joints
    if position_joints is None:
        raise GuardError(
            "modes: auto needs a choice of drive joints", "name them: modes: {position: [1, 5]}"
        )
    session.check_modes(position_joints)
    listener.connected(session.connect())
    listener.fixture_checked(session.require_fixture())
    session.set_modes(position_joints)
    listener.modes_set(position_joints)
    wanted = session.procedure.capture.poses
    session.run_plan(lambda state: listener.pose_captured(state, wanted))
    session.arm.hold()
    solution = session.calibrate()
    listener.solved(solution)
    exported = session.export(solution) if solution.accepted else None
    return RunResult(solution=solution, exported=exported)
