"""`sarcal run` without the words: the steps of a session in order, and what each of them told.

Knows a session and a listener; prints nothing, so that tests and other front ends can drive it.
"""

from __future__ import annotations

from dataclasses import dataclass
from typing import Protocol

from fixtures.base import SetupCheck
from hardware.arm import ArmIdentity
from operator_app.calibration.solve import Solution
from operator_app.errors import GuardError, SessionError
from operator_app.planning.advice import QUICK_TRIES, advise, hint
from operator_app.planning.drives import DriveChoice
from operator_app.session.drives import choose, drives_of
from operator_app.session.export import Exported
from operator_app.session.planned_capture import CampaignEnd, PlannedCapture
from operator_app.session.session import Session
from operator_app.session.state import SessionState


class Listener(Protocol):
    """Hears how a run goes on; called from the thread that runs it."""

    def connected(self, identity: ArmIdentity) -> None:
        """Called when the arm has been found and checked."""
        ...

    def fixture_checked(self, checks: tuple[SetupCheck, ...]) -> None:
        """Called when the placement has been judged."""
        ...

    def drives_chosen(self, choice: DriveChoice) -> None:
        """Called when the program has chosen the drive joints."""
        ...

    def modes_set(self, position_joints: tuple[int, ...]) -> None:
        """Called when every drive confirmed its mode."""
        ...

    def pose_captured(self, state: SessionState, wanted: int) -> None:
        """Called after each pose."""
        ...

    def told(self, text: str) -> None:
        """Called with a sentence when a planned capture decides something."""
        ...

    def solved(self, solution: Solution) -> None:
        """Called when the calibration is done."""
        ...


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """What a run came to.

    `exported` is None when the calibration was not accepted; `capture` says how a planned capture
    ended, and `advice` which other hinge placement would help when it fell short.
    """

    solution: Solution
    exported: Exported | None
    capture: CampaignEnd | None = None
    advice: str = ""


def run(session: Session, listener: Listener) -> RunResult:
    """Go from Connect to Export; every refusal is raised with its reason.

    A resumed session goes through Connect, Fixture and Modes again: the arm may have been moved.
    """
    procedure = session.procedure
    if procedure.position_joints is not None:
        session.check_modes(procedure.position_joints)
    listener.connected(session.connect())
    listener.fixture_checked(session.require_fixture())
    drives = _drives(session, listener)
    end = None
    if procedure.capture.strategy == "planned":
        end = _planned(session, listener, drives)
    else:
        session.set_modes(drives)
        listener.modes_set(drives)
        wanted = procedure.capture.poses
        session.run_plan(lambda state: listener.pose_captured(state, wanted))
    session.arm.hold()
    solution = session.calibrate()
    listener.solved(solution)
    exported = session.export(solution) if solution.accepted else None
    return RunResult(
        solution=solution, exported=exported, capture=end, advice=_advice(session, solution, end)
    )


def _drives(session: Session, listener: Listener) -> tuple[int, ...]:
    """Return the joints that drive, chosen by the program if the procedure leaves it to it."""
    if session.procedure.position_joints is None and not session.state.drives:
        choice = choose(session)
        listener.drives_chosen(choice)
        return choice.drives
    return drives_of(session)


def _planned(session: Session, listener: Listener, drives: tuple[int, ...]) -> CampaignEnd:
    """Explore, plan, visit."""
    capture = PlannedCapture(session, drives, say=listener.told)
    drives = capture.ready()
    session.set_modes(drives)
    listener.modes_set(drives)
    wanted = session.procedure.capture.poses

    def on_pose(state: SessionState) -> None:
        explored = sum(not p.planned for p in state.used_poses)
        listener.pose_captured(state, explored + wanted)

    end = capture.run(on_pose)
    if end is None:
        raise GuardError("the capture was ended", "resume the session to go on")
    listener.told(f"Capture {'complete' if end.complete else 'ended'}: {end.text}.")
    return end


def _advice(session: Session, solution: Solution, end: CampaignEnd | None) -> str:
    """Say which hinge placement would help parameters that stayed weak; empty when there are none."""
    if end is None or not end.weak or session.fixture.kind != "hinge":
        return ""
    estimate = solution.estimate
    values = {p.name: float(v) for p, v in zip(estimate.parameters, estimate.x, strict=True)}
    try:
        ranked = advise(
            session.model,
            session.fixture,
            values=values,
            parameters=tuple(w.name for w in end.weak),
            unsensed_joints=session.procedure.unsensed_joints,
            tries=QUICK_TRIES,
            best=1,
        )
    except SessionError as error:
        return error.happened
    return hint(ranked)
