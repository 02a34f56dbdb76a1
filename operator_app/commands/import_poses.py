"""`sarcal import`: makes a session from poses or recordings that another program wrote."""

import argparse
from dataclasses import replace
from functools import reduce
from pathlib import Path
from typing import Any

import numpy as np

from fixtures.measured import Measured
from operator_app.calibration.experiment import EndpointMissingError
from operator_app.calibration.prediction import concatenated_poses
from operator_app.commands.file_arguments import poses_with_warnings
from operator_app.commands.options import unsensed_joints
from operator_app.config.arm_file import parse_arm
from operator_app.config.dwells import (
    DWELL_S,
    DWELL_SPREAD_DEG,
    find_dwells,
    poses_of,
    smallest_spread_rad,
)
from operator_app.config.fixture_file import parse_fixture
from operator_app.config.joint_log import Unit, load_joint_log
from operator_app.config.poses_file import save_poses
from operator_app.config.recording import (
    endpoints_at_rest,
    is_bag,
    load_bag,
    load_timed_log,
    utc_text,
)
from operator_app.config.resources import resolve
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.report.facts import facts_of
from operator_app.report.results.recording import recording_json, recording_text
from operator_app.report.results.session import result_text
from operator_app.safe_output import say
from operator_app.session.store.folders import POSES_NAME
from operator_app.session.workflow import importing
from solver.chain.poses import PoseSet
from solver.diagnostics.range_checks import ReadingsOutOfRangeError
from solver.errors import UnidentifiableError


def execute(args: argparse.Namespace) -> int:
    """Calibrate from the poses, write the session, and print the result."""
    arm = resolve("arm", args.arm)
    model = parse_arm(arm.data, arm.file)
    unsensed = unsensed_joints(args, model.joint_count) or ()
    fixture = resolve("fixture", args.fixture)
    instrument = isinstance(parse_fixture(fixture.data, fixture.file).fixture, Measured)
    names = tuple(joint.name for joint in model.joints)
    poses, recordings = _poses(args, names, instrument=instrument)
    session = importing.ImportedSession(
        poses,
        arm=arm,
        fixture=fixture,
        file=", ".join(args.poses),
        name=args.name or Path(args.poses[0]).stem,
        serial_number=(args.serial or importing.UNKNOWN_SERIAL_NUMBER).strip(),
        options=importing.CalibrationOptions(
            estimator=args.estimator or "implicit",
            unsensed_joints=unsensed,
            length_tolerance_m=args.length_tolerance_m,
            drop_unidentifiable=args.drop_unidentifiable,
        ),
    )
    unidentifiable = None
    try:
        solution, checks = session.calibrate()
    except UnidentifiableError as error:
        # The poses are kept, for report and compare.
        unidentifiable = error
    except (EndpointMissingError, ReadingsOutOfRangeError) as error:
        raise UsageError(f"{', '.join(args.poses)}: {error}") from error
    folder = session.write(root=args.sessions)
    save_poses(folder / POSES_NAME, session.state.pose_set())
    procedure, state = session.procedure, session.state
    result = unidentifiable or facts_of(solution, checks=checks, limits=procedure.acceptance)
    say(result_text(result, procedure, folder, state, in_json=args.json, more=recordings))
    if unidentifiable is not None:
        if not args.json:
            say(f"\nSession     {folder}")
        return ExitCode.NOT_IDENTIFIABLE
    return ExitCode.ACCEPTED if solution.accepted else ExitCode.NOT_ACCEPTED


def _poses(
    args: argparse.Namespace, joints: tuple[str, ...], *, instrument: bool
) -> tuple[PoseSet, dict[str, list[dict[str, Any]]]]:
    """Return the poses of all files, and JSON data on the recordings. Each of several files is a separate placement."""
    unit: Unit | None = "rad" if args.rad else "deg" if args.deg else None
    pose_sets, recordings = [], []
    of_recordings = (args.dwell_s, args.spread_deg, args.topic) != (None, None, None)
    for file in args.poses:
        if args.time or is_bag(file):
            poses, data = _recorded(args, file, joints, unit, instrument=instrument)
            pose_sets.append(poses)
            recordings.append(data)
            continue
        if of_recordings:
            raise UsageError(
                f"{file}: --dwell-s, --spread-deg and --topic are for recordings; name the time column of a log "
                "with --time"
            )
        read = load_joint_log(
            file,
            joint_count=len(joints),
            unit=unit,
            columns=args.columns or "",
            placement=args.placement or "",
            joints=joints,
            instrument=instrument,
        )
        pose_sets.append(poses_with_warnings(file, read))
    recording_data = {"recordings": recordings} if recordings else {}
    if len(pose_sets) == 1:
        return pose_sets[0], recording_data
    columns = [0 if p.endpoint is None else p.endpoint.shape[1] for p in pose_sets]
    for k, (file, poses) in enumerate(zip(args.poses, pose_sets, strict=True)):
        if same := [
            args.poses[i] for i in range(k) if np.array_equal(pose_sets[i].q_rad, poses.q_rad)
        ]:
            raise UsageError(
                f"{file}: holds the same readings as {same[0]}; give each placement's file once"
            )
        if len(poses.placements) > 1:
            raise UsageError(f"{file}: with several files each is one placement; import it alone")
        if columns[k] != columns[0]:
            raise UsageError(
                f"{file}: its measured endpoints have other columns than those of {args.poses[0]}; import it alone"
            )
    together = replace(
        reduce(concatenated_poses, pose_sets),
        placement=np.repeat(np.arange(1, len(pose_sets) + 1), [len(p) for p in pose_sets]),
        label=tuple(label for p in pose_sets for label in p.label),
        notes=tuple(note for p in pose_sets for note in p.notes or ("",) * len(p)),
    )
    return together, recording_data


def _recorded(
    args: argparse.Namespace,
    file: str,
    joints: tuple[str, ...],
    unit: Unit | None,
    *,
    instrument: bool,
) -> tuple[PoseSet, dict[str, Any]]:
    dwell_s = DWELL_S if args.dwell_s is None else args.dwell_s
    spread_deg = DWELL_SPREAD_DEG if args.spread_deg is None else args.spread_deg
    if args.placement:
        raise UsageError(
            "--placement is for logs with a row for each pose; give a recording for each placement"
        )
    columns = args.columns or ""
    if is_bag(file):
        if args.time or unit is not None:
            raise UsageError(
                f"{file}: a bag has times and is in radians; leave --time, --rad and --deg out"
            )
        recording = load_bag(file, joints=joints, columns=columns, topic=args.topic or "")
    else:
        if args.topic:
            raise UsageError(f"{file}: --topic is for bags")
        recording = load_timed_log(
            file, time=args.time, joints=joints, unit=unit, columns=columns, instrument=instrument
        )
    step_s = float(np.median(np.diff(recording.time_s, append=recording.time_s[-1])))
    if step_s > dwell_s:
        raise UsageError(
            f"{file}: its samples are {step_s:.3g} s apart (median), too far for a dwell of {dwell_s:g} s; "
            "if its times are ms, write them in seconds, else give a longer --dwell-s"
        )
    dwells, refused = find_dwells(
        recording.time_s, recording.q_rad, dwell_s=dwell_s, spread_rad=np.deg2rad(spread_deg)
    )
    text = recording_text(recording, dwells, refused, dwell_s=dwell_s, spread_deg=spread_deg)
    say(text, err=True)
    if not dwells:
        smallest_spread_deg = np.rad2deg(
            smallest_spread_rad(recording.time_s, recording.q_rad, dwell_s)
        )
        smallest = f" (smallest spread in {dwell_s:g} s: {smallest_spread_deg:.3g} deg)"
        raise UsageError(
            f"{file}: the arm is never at rest for {dwell_s:g} s within {spread_deg:g} deg"
            f"{smallest if np.isfinite(smallest_spread_deg) else ''}; give another --dwell-s or --spread-deg, or "
            "record an arm that stops at its poses"
        )
    poses = poses_of(dwells, utc_text, endpoints_at_rest(recording, dwells))
    return poses, recording_json(recording, dwells, refused)
