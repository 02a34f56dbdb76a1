"""`sarcal run` without the words: the steps of a session in order, and what each of them told.

Knows a session and a listener; prints nothing, so that tests and other front ends can drive it.
"""

from __future__ import annotations

from dataclasses import dataclass

from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.errors import SessionError
from operator_app.planning.advice import QUICK_TRIES, advise, hint
from operator_app.session.store.solver_process import Solver, solve_here
from operator_app.session.workflow.capture import connect, take_poses
from operator_app.session.workflow.drive_selection import drives_of
from operator_app.session.workflow.export import Exported, export
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.planned_capture import CampaignEnd
from operator_app.session.workflow.session import Session


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """What a run came to.

    `exported` is None when the calibration was not accepted; `capture` says how a planned capture
    ended, and `advice` which other hinge placement would help when it fell short.
    """

    solution: Solution
    checks: Checks
    exported: Exported | None
    capture: CampaignEnd | None = None
    advice: str = ""


def run(
    session: Session,
    listener: Listener,
    *,
    forced: str = "",
    homing: bool = False,
    solver: Solver = solve_here,
) -> RunResult | None:
    """Go from Connect to Export; every refusal is raised with its reason.

    None: the present placement of the fixture has its poses, and it has to be mounted anew for the next.

    `forced` says why a calibration is exported even if it is not accepted; empty: it is not.
    `homing`: the operator agrees that an arm outside its box goes home by itself. `solver` calibrates
    elsewhere, where SYNC must not wait for it.

    A resumed session goes through Connect, Fixture and Modes again: the arm may have been moved.
    """
    if session.procedure.position_joints is not None:
        session.check_modes(session.procedure.position_joints)
    connect(session, listener)
    listener.fixture_checked(session.require_fixture())
    end = take_poses(session, listener, drives_of(session, listener), homing=homing)
    if end is not None:
        listener.told(f"Capture {'complete' if end.complete else 'ended'}: {end.text}.")
    session.arm.hold()
    if session.state.placement < session.procedure.placements:
        return None
    known = session.calibrated()
    solution = session.calibrate(solver=solver) if known is None else known.solution
    listener.solved(solution)
    checks = None if known is None else known.checks
    if checks is None:
        checks = session.check(solution, solver)
    session.heed()
    exported = export(session, solution, forced=forced) if solution.accepted or forced else None
    return RunResult(
        solution=solution,
        checks=checks,
        exported=exported,
        capture=end,
        advice=_advice(session, solution, end),
    )


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
