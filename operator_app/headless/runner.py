"""`sarcal run` without output: the steps of a session in order."""

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
    """Result of a run.

    `exported` is None if the calibration was not accepted; `capture` is the end of a planned capture, `advice` a
    hinge placement that would make its weak parameters more precise.
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
    """Run from Connect to Export; raises every refusal.

    Returns None if the present placement is complete and the fixture has to be remounted for the next one.

    `forced`: reason for exporting a calibration that is not accepted ("": do not). `homing`: the operator agrees
    that an arm outside its box goes home. `solver`: another process on a real bus, so that SYNC is not delayed.
    """
    if session.procedure.position_joints is not None:
        session.check_modes(session.procedure.position_joints)
    connect(session, listener)
    listener.fixture_checked(session.require_fixture())
    end = take_poses(session, listener, drives_of(session, listener), homing=homing)
    if end is not None:
        listener.report(f"Capture {'complete' if end.complete else 'ended'}: {end.text}.")
    session.arm.hold()
    if session.state.placement < session.procedure.placements:
        return None
    known = session.recorded_calibration()
    solution = session.calibrate(solver=solver) if known is None else known.solution
    listener.solved(solution)
    checks = None if known is None else known.checks
    if checks is None:
        checks = session.check(solution, solver)
    session.record_stop_cause()
    exported = export(session, solution, forced=forced) if solution.accepted or forced else None
    return RunResult(
        solution=solution,
        checks=checks,
        exported=exported,
        capture=end,
        advice=_advice(session, solution, end),
    )


def _advice(session: Session, solution: Solution, end: CampaignEnd | None) -> str:
    """Return which hinge placement would make the weak parameters more precise; "" without weak ones."""
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
