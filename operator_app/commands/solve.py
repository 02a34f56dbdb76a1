"""`sarcal solve`: a calibration from a poses file, without an arm."""

import argparse

from fixtures.base import EndpointConstraint
from operator_app.calibration import new_poses
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.cross_validation import check
from operator_app.calibration.experiment import EndpointMissingError, Experiment, pick_placements
from operator_app.calibration.result import Solution
from operator_app.calibration.rvdt import ReadingTable, corrected_poses
from operator_app.calibration.verification import verify_poses
from operator_app.commands.file_arguments import poses_with_warnings
from operator_app.commands.options import unsensed_joints
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.config.parameters_file import load_parameters
from operator_app.config.poses_file import load_poses
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.messages.finding import Finding, FindingKind
from operator_app.report.calibration_json import unidentifiable_data
from operator_app.report.facts import facts_of
from operator_app.report.results.verification import verification_json, verification_text
from operator_app.report.text import facts_text, unidentifiable_text
from operator_app.safe_output import as_json, say
from operator_app.session.store.stored_calibration import require_estimator_for
from operator_app.units import ANGLE, Figure
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Rvdt
from solver.diagnostics.range_checks import ReadingsOutOfRangeError
from solver.errors import UnidentifiableError


def execute(args: argparse.Namespace) -> int:
    """Calibrate from the poses and print the result."""
    arm = load_arm(args.arm)
    fixture = load_fixture(args.fixture).fixture
    unsensed = unsensed_joints(args, arm.joint_count) or ()
    loaded = load_poses(args.poses, joint_count=arm.joint_count)
    poses = loaded.poses
    if args.placements:
        try:
            poses = pick_placements(poses, args.placements)
        except ValueError as error:
            raise UsageError(f"--placements: {error}") from error
    table_of, tables = _tables(args, arm)
    as_read, poses = poses, corrected_poses(poses, tables)
    _say_corrected(as_read, poses, tables)
    estimator = args.estimator or "implicit"
    require_estimator_for(unsensed, estimator)
    try:
        solution = calibrate(
            arm,
            fixture,
            poses,
            estimator=estimator,
            unsensed_joints=unsensed,
            search=args.global_start,
            drop=args.drop_unidentifiable,
            length_tolerance_m=args.length_tolerance_m,
        )
    except UnidentifiableError as error:
        if args.json:
            experiment = Experiment(arm=arm, fixture=fixture, poses=poses, unsensed=unsensed)
            say(as_json(unidentifiable_data(error, experiment, estimator=estimator)))
        else:
            say(unidentifiable_text(error))
        return ExitCode.NOT_IDENTIFIABLE
    except (EndpointMissingError, ReadingsOutOfRangeError) as error:
        raise UsageError(f"{args.poses}: {error}") from error
    solution = solution.with_notices(
        Finding(FindingKind.REPORTED, names=(w.code,), reported=(w.text,)) for w in loaded.warnings
    )
    if as_read.sha256() == table_of:
        solution = solution.with_notices([Finding(FindingKind.CIRCULAR_TABLE)])
    checks = check(solution, arm, fixture, poses) if args.checks else None
    facts = facts_of(solution, checks=checks)
    tested = None
    if args.test:
        try:
            new = corrected_poses(_test_poses(args, arm, fixture, as_read, solution), tables)
            elsewhere = new_poses.is_elsewhere(new, poses, fixture)
            tested = verify_poses(arm, fixture, new, solution, poses, elsewhere=elsewhere)
        except new_poses.NoTestError as error:
            raise UsageError(f"--test {args.test}: {error}") from error
    if args.json:
        document = facts.json
        if tested is not None:
            document["test"] = verification_json(tested, new)
        say(as_json(document))
    else:
        failed = args.test if tested is not None and not tested.holds else ""
        say(facts_text(facts, failed=failed))
        if tested is not None:
            say(f"\n{verification_text(tested, new, args.poses)}")
    holds = tested is None or tested.holds
    return ExitCode.ACCEPTED if solution.accepted and holds else ExitCode.NOT_ACCEPTED


def _test_poses(
    args: argparse.Namespace,
    arm: ArmModel,
    fixture: EndpointConstraint,
    poses: PoseSet,
    solution: Solution,
) -> PoseSet:
    new = poses_with_warnings(args.test, load_poses(args.test, joint_count=arm.joint_count))
    elsewhere = new_poses.may_be_elsewhere(fixture)
    if not elsewhere and (len(new.placements) > 1 or len(poses.placements) > 1):
        raise UsageError("--test: both files must be from the same single placement")
    if elsewhere and args.test == args.poses and args.placements:
        # The file contains all placements: test with those that were not used for the calibration.
        others = tuple(k for k in new.placements if k not in poses.placements)
        new = pick_placements(new, others) if others else new
    new_poses.require_in_range(arm, new, solution)
    new_poses.require_calibrated_placement(new, poses, fixture)
    new_poses.require_new(new, poses, fixture)
    return new


def _tables(args: argparse.Namespace, arm: ArmModel) -> tuple[str, tuple[ReadingTable, ...]]:
    """Return, from the file ``--rvdt-table``, the poses' SHA-256 and the tables; without this option, "" and ()."""
    if not args.rvdt_table:
        return "", ()
    document, option = load_parameters(args.rvdt_table), f"--rvdt-table {args.rvdt_table}"
    tables = tuple(map(ReadingTable.of, document.rvdt))
    if document.arm.model != arm.name:
        raise UsageError(f"{option} is for {document.arm.model}, these poses are from {arm.name}")
    if not tables:
        raise UsageError(
            f"{option} contains no RVDT table; calibrate in the hinge with poses that determine one"
        )
    for table in tables:
        if not isinstance(arm.joints[table.joint - 1].sensor, Rvdt):
            raise UsageError(f"{option}: joint {table.joint} of {arm.name} has no RVDT")
    return document.pose_set_sha256, tables


def _say_corrected(poses: PoseSet, corrected: PoseSet, tables: tuple[ReadingTable, ...]) -> None:
    for table in tables:
        read, now = (p.q_rad[:, table.joint - 1] for p in (poses, corrected))
        largest = Figure(float(abs(now - read).max()), ANGLE, places=3).with_unit
        outside = ""
        if beyond := table.beyond(read):
            outside = f"; {beyond} of {len(poses)} are beyond the table and use its nearest end"
        say(f"Readings of joint {table.joint} corrected by up to {largest}{outside}.", err=True)
