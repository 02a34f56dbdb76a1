"""`sarcal verify`: tests a calibration with new poses."""

import argparse
from dataclasses import replace

import numpy as np

from fixtures.measured import Measured
from operator_app.calibration.new_poses import NoTestError
from operator_app.calibration.open_loop import check_open_loop
from operator_app.calibration.result import Solution
from operator_app.calibration.verification import VerificationResult, verify_new_poses
from operator_app.commands.bus_arguments import NEW_POSES
from operator_app.commands.choices import choices_from, recording, require_instrument
from operator_app.commands.file_arguments import poses_with_warnings
from operator_app.composition import unattended
from operator_app.config.fixture_file import load_fixture
from operator_app.config.poses_file import load_poses
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.headless.console import ConsoleListener
from operator_app.report.results.verification import (
    open_loop_json,
    open_loop_text,
    verification_json,
    verification_text,
)
from operator_app.safe_output import as_json, say
from operator_app.session.store.stored_calibration import session_calibration
from operator_app.session.workflow.capture import connect, go_home_if_outside, take_poses, verify
from operator_app.session.workflow.drive_selection import drives_of
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Opening, begin, resume
from solver.chain.poses import PoseSet

OPEN_POSES = 24
"""Default number of poses of the open arm, from which a separate calibration is made for comparison."""


def execute(args: argparse.Namespace) -> int:
    """Verify the calibration and print the result."""
    requested, args.poses = args.poses, None
    opening = resume(args.session, choices_from(args), root=args.sessions)
    state = opening.state
    if not state.used_poses:
        raise UsageError(f"{opening.folder} has no pose yet: there is no calibration to verify")
    procedure = opening.effective_procedure
    arm, fixture = procedure.arm, procedure.fixture.fixture
    solution = session_calibration(state, procedure).solution
    if args.csv:
        for option, value in (("--poses", requested), ("--tracker", args.tracker)):
            if value is not None:
                raise UsageError(f"leave {option} out: the new poses are those of {args.csv}")
    if args.open_loop:
        return _open_loop(args, opening, solution, requested)
    require_instrument(args, procedure)
    if args.csv:
        poses = poses_with_warnings(args.csv, load_poses(args.csv, joint_count=arm.joint_count))
        try:
            verdict = verify_new_poses(
                arm, fixture, solution, made_from=state.pose_set(), new=poses
            )
        except NoTestError as error:
            raise UsageError(f"{args.csv}: {error}") from error
    else:
        if opening.state.imported:
            raise UsageError(
                f"{opening.folder} was imported from {opening.state.imported} and has no arm; give a file of "
                f"new poses: sarcal verify {args.session} POSES.csv"
            )
        verdict, poses = _on_the_arm(args, opening, solution, requested or NEW_POSES)
    say(
        as_json(verification_json(verdict, poses))
        if args.json
        else verification_text(verdict, poses, str(opening.folder))
    )
    return ExitCode.ACCEPTED if verdict.holds else ExitCode.NOT_ACCEPTED


def _open_loop(
    args: argparse.Namespace, opening: Opening, solution: Solution, count: int | None
) -> ExitCode:
    if solution.model.dh_table(solution.estimate.x) is None:
        raise UsageError(
            "--open-loop verifies a calibration of one placement of a hinge or rigid fixture; "
            f"for this one take new poses in the fixture: sarcal verify {args.session} [POSES.csv]"
        )
    arm = opening.effective_procedure.arm
    if args.csv:
        instrument = load_fixture(args.instrument).fixture
        if not isinstance(instrument, Measured):
            raise UsageError(
                f"--instrument: {args.instrument!r} is a fixture of kind {instrument.kind}; name one of kind measured"
            )
        poses = poses_with_warnings(args.csv, load_poses(args.csv, joint_count=arm.joint_count))
    else:
        instrument, poses = _open_arm(args, opening, count)
    check = check_open_loop(arm, instrument, poses, solution)
    say(as_json(open_loop_json(check)) if args.json else open_loop_text(check, str(opening.folder)))
    return ExitCode.ACCEPTED if check.holds else ExitCode.NOT_ACCEPTED


def _open_arm(
    args: argparse.Namespace, calibrated: Opening, count: int | None
) -> tuple[Measured, PoseSet]:
    choices = replace(
        calibrated.choices,
        poses=count or OPEN_POSES,
        plan=None,
        estimator=None,
        unsensed_joints=None,
        length_tolerance_m=None,
        upload=False,
        tracker=args.tracker,
    )
    opening = begin(args.procedure, choices, root=args.sessions)
    instrument = opening.procedure.fixture.fixture
    if not isinstance(instrument, Measured):
        raise UsageError(
            f"--procedure: {args.procedure!r} closes the chain with a {instrument.kind}; name a procedure "
            "whose fixture is an instrument, such as open_loop"
        )
    own_arm, other_arm = opening.procedure.arm, calibrated.procedure.arm
    if own_arm.name != other_arm.name or not np.array_equal(
        own_arm.table.stacked(), other_arm.table.stacked()
    ):
        raise UsageError(
            f"--procedure: {args.procedure} is for {own_arm.name}, not for the {other_arm.name} of "
            f"{calibrated.folder}; name a procedure with that arm file"
        )
    state, listener = calibrated.state, ConsoleListener()
    with unattended(opening, record_to=recording(args, opening)) as session:
        identity = connect(session, listener)
        if identity.serial_number != state.serial_number:
            raise UsageError(
                f"{calibrated.folder} calibrated arm {state.serial_number}, and the arm on the bus is "
                f"{identity.serial_number}: connect that one"
            )
        take_poses(session, listener, drives_of(session), homing=args.go_home)
        session.arm.hold()
        poses = session.state.pose_set()
    folder = session.journal.path.parent  # another program may have taken the name
    say(f"Captured {len(poses)} poses of the open arm, kept in {folder}", err=True)
    return instrument, poses


def _on_the_arm(
    args: argparse.Namespace, opening: Opening, solution: Solution, count: int
) -> tuple[VerificationResult, PoseSet]:
    with unattended(opening, record_to=recording(args, opening)) as session:
        connect(session, Listener())
        session.set_modes(drives_of(session))
        if args.go_home:
            go_home_if_outside(session, ConsoleListener())
        result = verify(session, solution, count, Listener())
    say(f"Captured {count} new poses, kept in the journal of {opening.folder}", err=True)
    return result
