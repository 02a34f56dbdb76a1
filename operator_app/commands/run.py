"""`sarcal run`: carries out a procedure from Connect to Export without questions."""

from __future__ import annotations

import argparse
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace

from operator_app.commands.choices import choices_from, recording, require_instrument
from operator_app.composition import unattended
from operator_app.errors import DrivesNotOffError
from operator_app.exit_codes import ExitCode
from operator_app.headless.console import ConsoleListener
from operator_app.headless.procedure_run import RunResult, next_placement, require_mounted, run
from operator_app.report.facts import facts_of
from operator_app.report.results.session import (
    capture_json,
    capture_text,
    session_json,
    session_text,
    unidentifiable_json,
)
from operator_app.report.text import facts_text, unidentifiable_text
from operator_app.safe_output import as_json, say
from operator_app.session.store.solver_process import Solver, SolvingProcess, solve_here
from operator_app.session.workflow.opening import begin, resume
from operator_app.session.workflow.remounting import next_due
from operator_app.session.workflow.session import Session
from solver.errors import UnidentifiableError


def execute(args: argparse.Namespace) -> int:
    """Run a procedure and print the result; at the end the arm holds position."""
    choices = choices_from(args)
    opening = (
        resume(args.resume, choices, root=args.sessions)
        if args.resume is not None
        else begin(args.procedure, choices, root=args.sessions)
    )
    require_instrument(args, opening.procedure)
    listener = ConsoleListener()
    result, drives_off = None, False
    try:
        require_mounted(opening, listener)
        while result is None:
            if drives_off or next_due(opening.state, opening.procedure):
                opening = next_placement(
                    opening, listener, root=args.sessions, drives_off=drives_off
                )
            with (
                unattended(
                    opening, record_to=recording(args, opening), cut_short=listener.cut_short
                ) as session,
                _solver_for(session) as solver,
            ):
                if opening.resumed:
                    listener.resumed(session)
                result = run(
                    session,
                    listener,
                    forced=(args.force or "").strip(),
                    homing=args.go_home,
                    solver=solver,
                )
            if result is None:
                session.require_drives_off()
                drives_off = True
                folder = session.journal.path.parent  # another program may have taken the name
                opening = replace(opening, folder=folder)
    except UnidentifiableError as error:
        if args.json:
            folder, state = session.journal.path.parent, session.state
            say(as_json(unidentifiable_json(error, session.procedure, folder, state)))
        else:
            say(unidentifiable_text(error))
        return ExitCode.NOT_IDENTIFIABLE
    except DrivesNotOffError:
        if result is not None:
            _report(args, session, result)
        raise
    _report(args, session, result)
    return ExitCode.ACCEPTED if result.solution.accepted else ExitCode.NOT_ACCEPTED


def _solver_for(session: Session) -> AbstractContextManager[Solver]:
    """Return the solver: a separate process if the arm runs in real time, so that SYNC is not delayed."""
    if session.state.settings["interface"] == "virtual":
        return nullcontext(solve_here)
    return SolvingProcess()


def _report(args: argparse.Namespace, session: Session, result: RunResult) -> None:
    folder, state, solution = session.journal.path.parent, session.state, result.solution
    facts = facts_of(
        solution,
        checks=result.checks,
        limits=session.procedure.acceptance,
        captured=len(state.poses),
    )
    parameters = solution.model.parameters
    if args.json:
        data = session_json(facts, solution.paper, folder, state)
        data["capture"] = capture_json(result.capture, result.advice, parameters, state.used_poses)
        say(as_json(data))
        return
    say(facts_text(facts))
    if result.capture is not None:
        say(f"\n{capture_text(result.capture, result.advice, parameters)}")
    say(f"\n{session_text(folder, state, accepted=solution.accepted)}")
