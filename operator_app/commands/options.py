"""Options shared by several commands."""

from __future__ import annotations

import argparse
import re
from pathlib import Path
from typing import TYPE_CHECKING

from hardware.virtual import DEFAULT_SCENARIO, SCENARIOS
from operator_app.exit_codes import UsageError
from operator_app.safe_output import say

if TYPE_CHECKING:
    from operator_app.config.poses_file import LoadedPoses
    from operator_app.session.workflow.opening import Choices, Opening


MOST_POSES = 100_000
"""Limit of poses files and procedures."""


def pose_count(text: str) -> int:
    """Parse ``--poses``; commands check the lower limit."""
    found = int(text) if re.fullmatch(r"[-+]?\d{1,18}", text) else MOST_POSES + 1
    if found > MOST_POSES:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number up to {MOST_POSES}")
    return found


def a_name(text: str) -> str:
    """Parse a text option that must not be empty."""
    if not text.strip():
        raise argparse.ArgumentTypeError(
            "the value is empty: give a value, or leave the option out; an unset shell variable is empty"
        )
    return text


def a_path(text: str) -> Path:
    """Parse the path of a file or folder to write; expands ``~``."""
    try:
        return Path(a_name(text)).expanduser()
    except RuntimeError as error:
        raise argparse.ArgumentTypeError(
            f"{text}: there is no such home folder; for a folder of that name write ./{text}"
        ) from error


def json_option(parser: argparse.ArgumentParser) -> None:
    """``--json``: one JSON object on stdout."""
    parser.add_argument("--json", action="store_true", help="print one JSON object on stdout")


def estimator_options(parser: argparse.ArgumentParser) -> None:
    """``--estimator`` and ``--unsensed``."""
    parser.add_argument(
        "--estimator",
        choices=("implicit", "paper"),
        help="implicit weights every joint by its sensor (default); paper is the published "
        "unweighted least squares",
    )
    parser.add_argument(
        "--unsensed",
        type=a_name,
        metavar="JOINTS",
        help="joints whose readings are not to be used, e.g. 6,7",
    )


def tolerance_option(parser: argparse.ArgumentParser) -> None:
    """``--length-tolerance``."""
    parser.add_argument(
        "--length-tolerance",
        type=float,
        metavar="MM",
        help="standard deviation of the link lengths, e.g. 1.5; default: as in the arm file",
    )


def tolerance_m(args: argparse.Namespace) -> float | None:
    """Return ``--length-tolerance`` in metres; UsageError if it is out of range."""
    found: float | None = args.length_tolerance
    if found is None:
        return None
    if not 0.0 < found <= 100.0:
        raise UsageError("--length-tolerance: millimetres, more than 0 and at most 100")
    return found / 1e3


def force_option(parser: argparse.ArgumentParser) -> None:
    """``--force``."""
    parser.add_argument(
        "--force",
        type=a_name,
        metavar="REASON",
        help="export a calibration even if it is not accepted; the reason is kept in the journal and "
        "in the parameters",
    )


def homing_option(parser: argparse.ArgumentParser) -> None:
    """``--go-home``."""
    parser.add_argument(
        "--go-home",
        action="store_true",
        help="agree that an arm outside the procedure's box of drive angles goes home by itself, straight and at "
        "5 deg/s; without it such an arm is not moved. Stand clear",
    )


def plan_option(parser: argparse.ArgumentParser) -> None:
    """``--plan``."""
    parser.add_argument(
        "--plan",
        choices=("explore", "planned"),
        help="how poses are chosen: explore visits a box of drive angles in a fixed order; planned explores "
        "first, calibrates, and captures the 12 (or --poses) most informative poses",
    )


def bus_options(parser: argparse.ArgumentParser, *, profile: bool = True) -> None:
    """``-i -c -b`` as in python-can, and ``--profile``."""
    group = parser.add_argument_group("bus (python-can's names; also CAN_INTERFACE and can.conf)")
    group.add_argument(
        "-i",
        "--interface",
        type=a_name,
        help="virtual (default, embedded controller), loopback, socketcan, ...",
    )
    group.add_argument(
        "-c", "--channel", type=a_name, help="e.g. can0, vcan0; for loopback any name"
    )
    group.add_argument("-b", "--bitrate", type=int, help="bit/s, e.g. 1000000")
    if profile:
        group.add_argument(
            "--profile",
            type=a_name,
            metavar="P",
            help="how the arm's nodes are set up: bus profile file or built-in name (default sarcos, or "
            "what the procedure says); sarcal probe --draft writes one",
        )


def scenario_options(parser: argparse.ArgumentParser) -> None:
    """``--scenario`` and ``--seed`` of the virtual arm."""
    group = parser.add_argument_group("virtual arm")
    group.add_argument(
        "--scenario",
        choices=SCENARIOS,
        help="what is wrong with the virtual arm: exact (nothing), datasheet (sensors at their "
        "specification), as_reported (the paper's three error sources), wild (another arm and "
        f"hinge for every seed); default {DEFAULT_SCENARIO}",
    )
    group.add_argument("--seed", type=int, help="of the virtual arm (default 0)")


def placement_count(text: str) -> int:
    """Parse ``--placements`` and ``--placement``."""
    found = int(text) if re.fullmatch(r"\d{1,4}", text) else 0
    if found < 1:
        raise argparse.ArgumentTypeError(f"{text} is not a whole number from 1")
    return found


def tracker_option(parser: argparse.ArgumentParser) -> None:
    """``--tracker``: the port of the instrument that measures endpoints."""
    parser.add_argument(
        "--tracker",
        type=a_name,
        metavar="PORT",
        help="port of the instrument that measures an open arm: tcp:HOST:PORT, file:PATH (CSV that grows) or "
        "stdin; one JSON object per line, with x_m, y_m, z_m and the orientation of the target. Default: as in "
        "the procedure; an embedded virtual arm has its own tracker",
    )


def session_argument(parser: argparse.ArgumentParser) -> None:
    """SESSION: the session of a command about one."""
    parser.add_argument(
        "session", type=a_name, metavar="SESSION", help="session folder, its name or latest"
    )


def arm_and_fixture_options(parser: argparse.ArgumentParser) -> None:
    """``--arm``, ``--fixture`` and ``--drop-unidentifiable`` of a command with a file of poses."""
    parser.add_argument(
        "--arm", type=a_name, default="sarcos_dextrous", help="arm file or built-in name"
    )
    parser.add_argument(
        "--fixture", type=a_name, default="hinge", help="fixture file or built-in name"
    )
    parser.add_argument(
        "--drop-unidentifiable",
        action="store_true",
        help="fix unidentifiable parameters at their nominal values, instead of refusing",
    )


def sessions_option(parser: argparse.ArgumentParser) -> None:
    """``--sessions``: where session folders are kept."""
    parser.add_argument(
        "--sessions",
        type=a_path,
        default=Path("sessions"),
        metavar="DIR",
        help="folder that holds the session folders (default ./sessions)",
    )


def arm_options(parser: argparse.ArgumentParser) -> None:
    """SESSION or ``--arm``: the arm of a command without poses."""
    parser.add_argument(
        "session",
        type=a_name,
        nargs="?",
        metavar="SESSION",
        help="a session on the arm: its arm file and its bus (folder, name or latest)",
    )
    parser.add_argument(
        "--arm",
        type=a_name,
        default="sarcos_dextrous",
        help="arm file or built-in name, where no session is named (default sarcos_dextrous)",
    )
    sessions_option(parser)


def opening_from(args: argparse.Namespace) -> Opening:
    """Return the opening for the arm of a session, or of the options."""
    from dataclasses import replace

    from operator_app.config.arm_file import load_arm
    from operator_app.config.procedure import DEFAULT_PROFILE
    from operator_app.config.profile_file import load_profile
    from operator_app.session.workflow.opening import begin, resume

    # Such a command writes no journal: it does not need the user settings.
    choices = choices_from(args, journal=False)
    if args.session is not None:
        return resume(args.session, choices, root=args.sessions)
    arm = load_arm(args.arm)
    profile = load_profile(args.profile or DEFAULT_PROFILE, joints=arm.joint_count)
    opening = begin("hinge", replace(choices, profile=None), root=args.sessions)
    return replace(opening, procedure=replace(opening.procedure, arm=arm, profile=profile))


def session_record_option(parser: argparse.ArgumentParser) -> None:
    """``--record``: into the session's folder."""
    parser.add_argument(
        "--record",
        action="store_true",
        help="record the bus to bus.blf in the session folder (bus-2.blf beside an earlier one)",
    )


def recording(args: argparse.Namespace, opening: Opening) -> Path | None:
    """Return the file of ``--record`` in a session folder."""
    return opening.folder / "bus.blf" if args.record else None


def record_option(parser: argparse.ArgumentParser) -> None:
    """``--record FILE``."""
    parser.add_argument(
        "--record", type=a_path, metavar="FILE", help="record the bus (.blf, .asc, .log)"
    )


def choices_from(args: argparse.Namespace, *, journal: bool = True) -> Choices:
    """Return the choices of these options, with the operator of the user settings if `journal`."""
    from operator_app.session.workflow.opening import Choices

    if args.seed is not None and args.seed < 0:
        raise UsageError("--seed: a seed is a whole number from zero")
    if args.channel is not None and not (args.channel.isprintable() and len(args.channel) <= 255):
        raise UsageError("--channel: a bus name has at most 255 printable characters, e.g. can0")
    return Choices(
        poses=getattr(args, "poses", None),
        plan=getattr(args, "plan", None),
        estimator=getattr(args, "estimator", None),
        unsensed_joints=given_joints(getattr(args, "unsensed", None)),
        length_tolerance_m=tolerance_m(args) if hasattr(args, "length_tolerance") else None,
        upload=False if getattr(args, "no_upload", False) else None,
        interface=args.interface,
        channel=args.channel,
        bitrate=args.bitrate,
        profile=getattr(args, "profile", None),
        scenario=args.scenario,
        seed=args.seed,
        tracker=getattr(args, "tracker", None),
        operator=_operator_name() if journal else None,
        placements=getattr(args, "placements", None),
    )


def _operator_name() -> str | None:
    from operator_app.config.user_settings import settings_if_right

    settings, wrong = settings_if_right()
    if wrong:
        say(f"sarcal: {wrong}.", err=True)
    return settings.operator


def parse_joints(text: str | None) -> tuple[int, ...]:
    """Parse ``--unsensed``; () without it."""
    return given_joints(text) or ()


def given_joints(text: str | None) -> tuple[int, ...] | None:
    """Parse ``--unsensed``; None without it."""
    return None if text is None else parse_numbers(text, "--unsensed")


def parse_numbers(text: str, option: str) -> tuple[int, ...]:
    """Parse ``6,7`` into ascending numbers; UsageError for anything else."""
    if re.fullmatch(r"\d+(,\d+)*", text.replace(" ", "")) and "0" in re.split("[ ,]+", text):
        raise UsageError(f"{option} {text!r}: there is no 0, numbers count from 1")
    if not re.fullmatch(r"[1-9]\d*(,[1-9]\d*)*", text.replace(" ", "")):
        raise UsageError(f"{option} {text!r}: write numbers with commas, e.g. 6,7")
    return tuple(sorted({int(part) for part in text.replace(" ", "").split(",")}))


def require_joints(joints: tuple[int, ...], joint_count: int) -> None:
    """Raise UsageError if one of `joints` is not a joint of the arm."""
    wrong = [j for j in joints if j > joint_count]
    if wrong:
        raise UsageError(f"--unsensed: there is no joint {wrong[0]}; the arm has {joint_count}")


def print_warnings(file: str, found: LoadedPoses) -> None:
    """Print the warnings about a poses file."""
    for warning in found.warnings:
        say(f"sarcal: {file}: {warning.text}", err=True)
