"""`sarcal verify`: new poses judged by parameters that were fixed before they were taken."""

from __future__ import annotations

import argparse
import json
import sys
from pathlib import Path
from typing import TYPE_CHECKING, Any

import numpy as np

from operator_app.commands.options import (
    bus_options,
    choices_from,
    json_option,
    scenario_options,
    sessions_option,
)
from operator_app.exit_codes import ExitCode, UsageError

if TYPE_CHECKING:
    from operator_app.calibration.solve import Solution
    from operator_app.calibration.verify import Verdict
    from operator_app.session.opening import Opening
    from solver.chain.poses import PoseSet

NEW_POSES = 12
"""Poses to take when no file is given."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("session", metavar="SESSION", help="session folder, its name or latest")
    parser.add_argument(
        "csv",
        nargs="?",
        metavar="POSES.csv",
        help="new poses; without it the arm takes new ones, elsewhere than the session did",
    )
    parser.add_argument(
        "--poses", type=int, metavar="N", help=f"how many new poses to take (default {NEW_POSES})"
    )
    sessions_option(parser)
    bus_options(parser)
    scenario_options(parser)
    json_option(parser)


def execute(args: argparse.Namespace) -> int:
    """Judge and report."""
    from operator_app.calibration.verify import fixed_by, judge_poses
    from operator_app.composition import carried_procedure
    from operator_app.config.poses_file import load_poses
    from operator_app.session.calibrated import calibrated
    from operator_app.session.folder import read_session
    from operator_app.session.opening import resume

    wanted, args.poses = args.poses, None
    opening = resume(args.session, choices_from(args), root=args.sessions)
    state = read_session(opening.folder).state
    if state is None or not state.used_poses:
        raise UsageError(f"{opening.folder} has no pose yet: there is no calibration to verify")
    procedure = carried_procedure(opening)
    arm, fixture = procedure.arm, procedure.fixture.fixture
    solution = calibrated(state, procedure).solution
    if args.csv:
        poses = load_poses(args.csv, joint_count=arm.joint_count).poses
        if poses.sha256() == state.pose_set().sha256():
            raise UsageError(
                "these are the poses the calibration was made from: they verify nothing"
            )
        if len(poses.placements) > 1:
            raise UsageError("new poses must be of one placement, the one that was calibrated")
        verdict = judge_poses(arm, fixture, poses, fixed_by(solution))
    else:
        verdict, poses = _on_the_arm(opening, solution, NEW_POSES if wanted is None else wanted)
    if args.json:
        print(json.dumps(_json(verdict, poses), indent=2, allow_nan=False))
    else:
        print(_text(verdict, poses, opening.folder))
    return ExitCode.ACCEPTED if verdict.holds else ExitCode.NOT_ACCEPTED


def _on_the_arm(opening: Opening, solution: Solution, count: int) -> tuple[Verdict, PoseSet]:
    """Take `count` poses in the session, elsewhere than it did."""
    from operator_app.composition import unattended
    from operator_app.session.drives import drives_of
    from operator_app.session.listener import Listener
    from operator_app.session.workflow import verify

    if count < 1:
        raise UsageError("--poses: take at least 1")
    with unattended(opening) as session:
        session.connect()
        session.set_modes(drives_of(session))
        found = verify(session, solution, count, Listener())
    print(f"Took {count} new poses: they are in the journal of {opening.folder}", file=sys.stderr)
    return found


def _json(verdict: Verdict, poses: PoseSet) -> dict[str, Any]:
    from operator_app.report.json_result import both_json

    found = verdict.verification
    return {
        "verdict": "holds" if verdict.holds else "does not hold",
        "poses": verdict.poses,
        "chi2_per_dof": found.chi2.per_dof,
        "chi2_band_99": [found.chi2.low, found.chi2.high],
        "sigma_pos_mm": both_json(found.sigmas.position_m),
        "sigma_ori_mrad": both_json(found.sigmas.orientation_rad),
        "nominal": {
            "sigma_pos_mm": both_json(verdict.nominal.position_m),
            "sigma_ori_mrad": both_json(verdict.nominal.orientation_rad),
        },
        "odd_poses": [poses.label[k] for k in verdict.odd_poses],
    }


def _text(verdict: Verdict, poses: PoseSet, folder: Path) -> str:
    from operator_app.report.text import aligned, paragraph

    found = verdict.verification
    head = (
        f"HOLDS: the calibration of {folder} predicts these {verdict.poses} poses as well as it "
        "claims to."
        if verdict.holds
        else f"DOES NOT HOLD: {verdict.poses} new poses disagree with the calibration of {folder} "
        "by more than its uncertainty allows."
    )
    rows = [["closure at the measured joints", "unit", "nominal", "calibrated"]]
    for name, unit, before, after in (
        ("sigma_pos rms", "mm", verdict.nominal.position_m, found.sigmas.position_m),
        ("sigma_ori rms", "mrad", verdict.nominal.orientation_rad, found.sigmas.orientation_rad),
    ):
        rows.append([name, unit, f"{1e3 * before.rms:.3f}", f"{1e3 * after.rms:.3f}"])
    lines = [
        paragraph(head),
        "",
        aligned(rows),
        paragraph(
            f"chi2/dof {found.chi2.per_dof:.2f}, where 99 % of sound sets lie between "
            f"{found.chi2.low:.2f} and {found.chi2.high:.2f}."
        ),
    ]
    if found.chi2.per_dof < found.chi2.low:
        lines.append(
            paragraph(
                "! these poses fit better than sensors of this kind allow: simulated, or read by "
                "other sensors than the arm file says?",
                indent=2,
            )
        )
    if verdict.odd_poses:
        worst = ", ".join(
            f"{poses.label[k]} (chance {found.pose_probability[k]:.1e})"
            for k in verdict.odd_poses[:5]
        )
        lines.append(paragraph(f"! look at pose {worst}", indent=2))
    if not verdict.holds and not np.all(found.closed):
        lines.append(
            paragraph("! some poses cannot be closed at all: was the hinge moved since?", indent=2)
        )
    return "\n".join(lines)
