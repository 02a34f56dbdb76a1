"""`sarcal plan`: chooses drive joints and poses before anything moves."""

import argparse
import sys
from dataclasses import replace

from fixtures.base import Severity
from operator_app.commands.file_arguments import PLANNED_POSES, TRIES
from operator_app.commands.options import unsensed_joints
from operator_app.config.arm_file import parse_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.procedure import Procedure
from operator_app.config.procedure_file import load_procedure
from operator_app.config.resources import resolve
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.planning.advice import PlacementReport, advise
from operator_app.planning.preview import Preview, preview
from operator_app.planning.task import fixed_parameter_checks
from operator_app.report.results.plan import advice_json, advice_text, plan_json, plan_text
from operator_app.safe_output import as_json, say
from operator_app.session.workflow.opening import Choices, resume
from solver.arrays import FloatArray


def execute(args: argparse.Namespace) -> int:
    """Plan the poses and print the plan."""
    if args.tries is not None and not args.advise:
        raise UsageError("--tries is used only with --advise: add --advise, or leave --tries out")
    procedure, known_rad, basis = _of_session(args) if args.session else _of_files(args)
    capture = procedure.capture
    poses = args.poses or (capture.poses if capture.strategy == "planned" else PLANNED_POSES)
    shown = preview(
        procedure.arm,
        procedure.fixture.fixture,
        poses=poses,
        position_joints=procedure.position_joints,
        unsensed_joints=procedure.unsensed_joints,
        samples=capture.samples_per_pose,
        seed=capture.seed,
        known_rad=known_rad,
    )
    shown = replace(shown, checks=(*fixed_parameter_checks(procedure), *shown.checks))
    advice = _advice(args, procedure, shown, poses) if args.advise else None
    parameters = shown.parameters
    if args.json:
        data = plan_json(shown, basis=basis)
        if advice is not None:
            data["advice"] = advice_json(advice, parameters)
        say(as_json(data))
    else:
        where = f"{procedure.arm.name} in fixture {procedure.fixture.name}"
        title = f"Plan of {procedure.name}: {where}, from {basis}"
        # A terminal that cannot show braille gets ASCII without an option.
        plain = args.ascii or "utf" not in (sys.stdout.encoding or "").lower()
        say(plan_text(shown, title=title, ascii_only=plain))
        if advice is not None:
            say()
            say(advice_text(advice, parameters, procedure.arm.joint_count))
    # The exit code that `sarcal run` would return.
    refused = any(c.severity is Severity.REFUSED for c in shown.checks)
    return ExitCode.NOT_IDENTIFIABLE if refused else ExitCode.ACCEPTED


def _of_files(args: argparse.Namespace) -> tuple[Procedure, FloatArray | None, str]:
    """Return the procedure with arm and fixture from the options, None (no readings), and "nominal geometry".

    The drive joints are those of the procedure. In two cases, the planner chooses them instead: ``--arm`` is another
    arm, or ``--fixture`` is of another kind and ``--procedure`` is not given.
    """
    procedure = load_procedure(args.procedure or "hinge")
    if args.arm:
        resource = resolve("arm", args.arm)
        if resource.data != procedure.sources[1].data:
            procedure = replace(
                procedure,
                arm=parse_arm(resource.data, resource.file),
                position_joints=None,
                unsensed_joints=(),
                held={},
            )
    if args.fixture:
        fixture = load_fixture(args.fixture)
        if args.procedure is None and fixture.kind != procedure.fixture.kind:
            procedure = replace(procedure, position_joints=None)
        procedure = replace(procedure, fixture=fixture)
    joints = unsensed_joints(args, procedure.arm.joint_count)
    if joints is not None:
        procedure = replace(procedure, unsensed_joints=joints)
    return procedure, None, "nominal geometry"


def _of_session(args: argparse.Namespace) -> tuple[Procedure, FloatArray | None, str]:
    """Return the session's procedure, the readings (m, n), rad, of the used poses, and the plan's basis as text."""
    if args.procedure or args.arm or args.fixture:
        raise UsageError(
            "--session: a session states procedure, arm and fixture; leave those options out"
        )
    opening = resume(
        args.session, Choices(unsensed_joints=args.unsensed_joints), root=args.sessions
    )
    state = opening.state
    if not state.used_poses:
        raise UsageError(
            f"{opening.folder} has no pose yet: plan from nominal geometry, without --session"
        )
    procedure = opening.effective_procedure
    if procedure.position_joints is None and state.drives:
        procedure = replace(procedure, position_joints=state.drives)
    readings = state.pose_set().q_rad
    return procedure, readings, f"the estimate of {len(readings)} poses in {opening.folder}"


def _advice(
    args: argparse.Namespace, procedure: Procedure, shown: Preview, poses: int
) -> tuple[PlacementReport, ...]:
    """Return the best hinge placements near the estimated placement or, without an estimate, near the nominal one."""
    values: dict[str, float] = {}
    if shown.estimate is not None:
        values = dict(zip(shown.parameters, shown.estimate.x.tolist(), strict=True))
    return advise(
        procedure.arm,
        procedure.fixture.fixture,
        values=values,
        unsensed_joints=procedure.unsensed_joints,
        samples=procedure.capture.samples_per_pose,
        poses=poses,
        tries=TRIES if args.tries is None else args.tries,
    )
