"""`sarcal run`: carries out a procedure from Connect to Export; asks the operator only to confirm a remounted fixture.

This confirmation is written to the journal before the arm is connected, so that an interrupted session resumes in the
right placement.
"""

from __future__ import annotations

import argparse
import sys
from contextlib import AbstractContextManager, nullcontext
from dataclasses import dataclass, replace
from pathlib import Path

from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.commands.choices import choices_from, recording, require_instrument
from operator_app.composition import unattended
from operator_app.errors import DrivesNotOffError, SessionError
from operator_app.exit_codes import ExitCode
from operator_app.headless.console import ConsoleListener
from operator_app.planning.advice import QUICK_TRIES, advise, hint
from operator_app.report.facts import facts_of
from operator_app.report.results.session import capture_json, capture_text, result_text
from operator_app.safe_output import say
from operator_app.session.safety.sensor_faults import require_no_sensor_fault
from operator_app.session.store.solver_process import Solver, SolvingProcess, solve_here
from operator_app.session.workflow.capture import connect, take_poses
from operator_app.session.workflow.drive_selection import drives_of
from operator_app.session.workflow.export import Exported, export
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Opening, begin, resume
from operator_app.session.workflow.remounting import next_due, record_in, remounting_steps
from operator_app.session.workflow.session import Session
from solver.design.actions import Finished
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
        folder = session.journal.path.parent
        say(result_text(error, session.procedure, folder, session.state, in_json=args.json))
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
    capture = result.capture, result.advice, solution.model.parameters
    say(
        result_text(
            facts,
            session.procedure,
            folder,
            state,
            in_json=args.json,
            more={"capture": capture_json(*capture, state.used_poses)},
            capture=capture_text(*capture),
        )
    )


@dataclass(frozen=True, slots=True, kw_only=True)
class RunResult:
    """Result of a run.

    `exported`: the export; None if the calibration was not exported.
    `capture`: why the planned capture ended; None if the poses were not planned.
    `advice`: a hinge placement that would determine the imprecise parameters better, as text; else empty.
    """

    solution: Solution
    checks: Checks
    exported: Exported | None
    capture: Finished | None = None
    advice: str = ""


def run(
    session: Session,
    listener: Listener,
    *,
    forced: str = "",
    homing: bool = False,
    solver: Solver = solve_here,
) -> RunResult | None:
    """Run all steps from Connect to Export and return the result; catches no error.

    Returns None if the current placement is complete and the fixture has to be remounted for the next placement.

    `forced`: reason for exporting a calibration that is not accepted; without a reason, such a calibration is not
    exported. `homing`: whether an arm outside its exploration ranges may go home. `solver`: runs the calibration; on a
    real bus, in a separate process, so that SYNC is not delayed.
    """
    if session.procedure.position_joints is not None:
        session.check_modes(session.procedure.position_joints)
    connect(session, listener)
    for check in session.require_fixture():
        remedy = f": {check.remedy}" if check.remedy else ""
        listener.report(f"Fixture {check.severity.value}: {check.text}{remedy}")
    end = take_poses(session, listener, drives_of(session, listener), homing=homing)
    if end is not None:
        listener.report(f"Capture {'complete' if end.complete else 'ended'}: {end.text}.")
    session.arm.hold()
    if session.state.placement < session.procedure.placements:
        return None
    known = session.recorded_calibration()
    solution = session.calibrate(solver=solver) if known is None else known.solution
    listener.report(
        f"Solved from {solution.poses} poses in {solution.estimate.iterations} iterations."
    )
    checks = None if known is None else known.checks
    if checks is None:
        checks = session.check(solution, solver)
    session.reader.sensor_faults.record_stop_cause()
    exported = export(session, solution, forced=forced) if solution.accepted or forced else None
    return RunResult(
        solution=solution,
        checks=checks,
        exported=exported,
        capture=end,
        advice=_advice(session, solution, end),
    )


def _advice(session: Session, solution: Solution, end: Finished | None) -> str:
    if end is None or not end.weak or session.fixture.kind != "hinge":
        return ""
    try:
        ranked = advise(
            session.model,
            session.fixture,
            values=solution.estimate.values_by_name,
            parameters=tuple(w.name for w in end.weak),
            unsensed_joints=session.procedure.unsensed_joints,
            samples=session.procedure.capture.samples_per_pose,
            tries=QUICK_TRIES,
            best=1,
        )
    except SessionError as error:
        return error.happened
    return hint(ranked)


_WORD = "mounted"
"""Word to type as confirmation: an Enter typed earlier must not count as one, since the arm moves afterwards."""


def next_placement(
    opening: Opening, listener: ConsoleListener, *, root: Path, drives_off: bool = False
) -> Opening:
    """Wait until the operator confirms that the fixture is remounted, record this, and return the session to resume.

    For an arm simulated by this program, nothing is asked. `drives_off`: whether this program has released the arm, and
    the drives then reported that they are off. Raises `SessionError` without confirmation or after a sensor fault.
    """
    # Take the bus from the journal, since the options may leave it to the environment.
    opening = resume(str(opening.folder), opening.choices, root=root)
    require_no_sensor_fault(opening.state, "remounting is refused")
    number, placements = opening.state.placement + 1, opening.procedure.placements
    if opening.choices.interface == "virtual":
        listener.report(f"Placement {number} of {placements}: the virtual fixture is remounted.")
    else:
        _confirm(opening, listener, number, remounting_lines(opening, drives_off=drives_off))
    record_in(opening.folder, "remounted", number)
    return resume(str(opening.folder), opening.choices, root=root)


def require_mounted(opening: Opening, listener: ConsoleListener) -> None:
    """If the current placement must still be confirmed, ask whether the fixture is mounted, and record the answer.

    For an arm simulated by this program, nothing is asked. Raises `SessionError` if the operator did not confirm.
    """
    if not opening.state.unconfirmed_placement:
        return
    if opening.choices.interface != "virtual":
        line = (
            f"Placement {opening.state.placement} has no pose yet. Type {_WORD} and Enter when its fixture is "
            "mounted and nobody is within reach: the arm will move."
        )
        _confirm(opening, listener, opening.state.placement, (line,))
    record_in(opening.folder, "remounted", opening.state.placement)


def _confirm(
    opening: Opening, listener: ConsoleListener, number: int, lines: tuple[str, ...]
) -> None:
    """Write `lines`, and wait until the operator types the word "mounted"; text typed earlier is ignored."""
    try:
        for line in lines:
            listener.report(line)
        if sys.stdin.isatty():
            import termios

            termios.tcflush(sys.stdin, termios.TCIFLUSH)
        while line := sys.stdin.readline():
            if line.strip().lower() == _WORD:
                return
    except KeyboardInterrupt:
        listener.report(
            "The run was interrupted while the fixture was being mounted. Nothing commands the arm; all poses are "
            f"kept in {opening.folder}."
        )
        listener.report(f"Go on with: sarcal run --resume {opening.folder}")
        raise
    raise SessionError(
        f"the mounting of the fixture for placement {number} was not confirmed",
        f"when it is mounted, go on with: sarcal run --resume {opening.folder}",
    )


def remounting_lines(opening: Opening, *, drives_off: bool) -> tuple[str, ...]:
    """Return the instructions between two placements. They include a check of the drives, unless `drives_off`."""
    off = "This program does not command the arm and has not checked its drives: make sure that they are off."
    if drives_off:
        off = "Nothing commands the arm any more: its drives are off."
    number = opening.state.placement + 1
    lines = [
        f"All poses of placement {opening.state.placement} of {opening.procedure.placements} are captured.",
        f"{off} Leave its controller on, so that no counter is reset.",
        *remounting_steps(opening.procedure),
    ]
    if opening.choices.interface == "loopback":
        again = f"its controller and start it again with --placement {number}"
        lines.append(f"(Virtual arm: end {again}.)")
    lines.append(
        f"When placement {number} is mounted and nobody is within reach, type '{_WORD}' and press Enter: the arm will "
        "move. Ctrl-C quits; "
        f"sarcal run --resume {opening.folder} then asks again."
    )
    return tuple(lines)
