"""`sarcal import`: a session made of poses that were taken by somebody else's program."""

from __future__ import annotations

import argparse
import json
from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.commands.options import (
    a_name,
    estimator_options,
    json_option,
    parse_joints,
    require_joints,
    say_doubts,
    sessions_option,
    tolerance_m,
    tolerance_option,
)
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.safe_output import say

if TYPE_CHECKING:
    from solver.chain.poses import PoseSet


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument(
        "poses",
        type=a_name,
        nargs="+",
        metavar="POSES.csv",
        help="a poses file, or a log with a row of joint angles for each pose; of several files each is "
        "a placement of the fixture, in this order",
    )
    parser.add_argument(
        "--arm", type=a_name, default="sarcos_dextrous", help="arm file or built-in name"
    )
    parser.add_argument(
        "--fixture", type=a_name, default="hinge", help="fixture file or built-in name"
    )
    unit = parser.add_mutually_exclusive_group()
    unit.add_argument("--rad", action="store_true", help="the angles are radians")
    unit.add_argument(
        "--deg", action="store_true", help="the angles are degrees, however small they are"
    )
    parser.add_argument(
        "--columns",
        type=a_name,
        metavar="LIST",
        help="columns of joints 1, 2, ...: numbers from 1 (2-8) or names of the header (q1,q2,...)",
    )
    parser.add_argument(
        "--placement",
        type=a_name,
        metavar="COLUMN",
        help="column of a log, by number or name, that says in which placement of the fixture a pose was taken",
    )
    parser.add_argument(
        "--serial", type=a_name, metavar="TEXT", help="serial number of the arm, for compare"
    )
    parser.add_argument(
        "--name", type=a_name, help="name of the session (default: that of the file)"
    )
    parser.add_argument(
        "--drop-unidentifiable",
        action="store_true",
        help="hold at its nominal value what the poses cannot see, instead of refusing",
    )
    estimator_options(parser)
    tolerance_option(parser)
    sessions_option(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Make the session, calibrate, report on stdout."""
    from operator_app.config.arm_file import parse_arm
    from operator_app.config.poses_file import save_poses
    from operator_app.config.resources import resolve
    from operator_app.report.facts import facts_of
    from operator_app.report.results.session import session_json, session_text, unidentifiable_json
    from operator_app.report.text import facts_text, unidentifiable_text
    from operator_app.session.store.folders import POSES_NAME
    from operator_app.session.workflow.importing import UNSTATED, How, ImportedSession
    from solver.diagnostics.range_checks import ReadingsOutOfRangeError
    from solver.errors import UnidentifiableError

    arm = resolve("arm", args.arm)
    model = parse_arm(arm.data, arm.file)
    unsensed = parse_joints(args.unsensed)
    require_joints(unsensed, model.joint_count)
    session = ImportedSession(
        _poses(args, model.joint_count),
        arm=arm,
        fixture=resolve("fixture", args.fixture),
        file=", ".join(args.poses),
        name=args.name or Path(args.poses[0]).stem,
        serial_number=(args.serial or UNSTATED).strip(),
        how=How(
            estimator=args.estimator or "implicit",
            unsensed_joints=unsensed,
            length_tolerance_m=tolerance_m(args),
            drop_unidentifiable=args.drop_unidentifiable,
        ),
    )
    try:
        solution, checks = session.calibrate()
    except UnidentifiableError as error:
        # The poses are kept: report and compare say the same of them.
        folder = session.write(root=args.sessions)
        if args.json:
            parameters = len(session.model.parameters)
            found = unidentifiable_json(
                error,
                parameters=parameters,
                folder=folder,
                state=session.state,
            )
            say(json.dumps(found, indent=2, allow_nan=False))
        else:
            say(f"{unidentifiable_text(error)}\n\nSession     {folder}")
        return ExitCode.NOT_IDENTIFIABLE
    except ReadingsOutOfRangeError as error:
        raise UsageError(f"{', '.join(args.poses)}: {error}") from error
    folder = session.write(root=args.sessions)
    save_poses(folder / POSES_NAME, session.state.pose_set())
    facts = facts_of(solution, checks=checks, limits=session.procedure.acceptance)
    if args.json:
        said = session_json(facts, solution.paper, folder, session.state)
        say(json.dumps(said, indent=2, allow_nan=False))
    else:
        words = session_text(folder, session.state, accepted=solution.accepted)
        say(f"{facts_text(facts)}\n\n{words}")
    return ExitCode.ACCEPTED if solution.accepted else ExitCode.NOT_ACCEPTED


def _poses(args: argparse.Namespace, joint_count: int) -> PoseSet:
    """Read all files; of several, each is one placement."""
    import numpy as np

    from operator_app.config.joint_log import Unit, load_joint_log
    from solver.chain.poses import PoseSet

    unit: Unit | None = "rad" if args.rad else "deg" if args.deg else None
    found = []
    for file in args.poses:
        read = load_joint_log(
            file,
            joint_count=joint_count,
            unit=unit,
            columns=args.columns or "",
            placement=args.placement or "",
        )
        say_doubts(file, read)
        found.append(read.poses)
    if len(found) == 1:
        return found[0]
    for file, poses in zip(args.poses, found, strict=True):
        if len(poses.placements) > 1 or poses.endpoint is not None:
            raise UsageError(
                f"{file}: with several files each is one placement without endpoints; import it alone"
            )
    return PoseSet(
        placement=np.repeat(np.arange(1, len(found) + 1), [len(p) for p in found]),
        label=tuple(label for p in found for label in p.label),
        q_rad=np.concatenate([p.q_rad for p in found]),
        samples=None
        if any(p.samples is None for p in found)
        else np.concatenate([p.samples for p in found if p.samples is not None]),
        sd_rad=None
        if any(p.sd_rad is None for p in found)
        else np.concatenate([p.sd_rad for p in found if p.sd_rad is not None]),
    )
