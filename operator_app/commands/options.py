"""Options that several commands share, declared once. Knows argparse and nothing else."""

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
"""As a poses file and a procedure may hold."""


def pose_count(text: str) -> int:
    """Read the value of ``--poses``; that at least one is needed is said where it is."""
    found = int(text) if re.fullmatch(r"[-+]?\d{1,18}", text) else MOST_POSES + 1
    if found > MOST_POSES:
        raise argparse.ArgumentTypeError(f"{text} is no whole number up to {MOST_POSES}")
    return found


def a_name(text: str) -> str:
    """Read the value of an option that names something, or says something in words."""
    if not text.strip():
        raise argparse.ArgumentTypeError(
            "the value is empty: name something, or leave it out; an unset shell variable is empty"
        )
    return text


def a_path(text: str) -> Path:
    """Read the value of an option that names a file or folder to write; ``~`` is a home folder."""
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
        help="how well the maker's link lengths are known, e.g. 1.5; default: what the arm file states",
    )


def tolerance_m(args: argparse.Namespace) -> float | None:
    """Return ``--length-tolerance`` in metres; UsageError when it is no length."""
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
        help="you agree that an arm that stands outside the procedure's box of drive angles goes home "
        "by itself, straight and at 5 deg/s; without it such an arm is not moved. Stand clear",
    )


def plan_option(parser: argparse.ArgumentParser) -> None:
    """``--plan``."""
    parser.add_argument(
        "--plan",
        choices=("explore", "planned"),
        help="how poses are chosen: explore visits a box of drive angles as it comes; planned "
        "explores a little, calibrates, and takes the 12 poses (or --poses) that tell most",
    )


def bus_options(parser: argparse.ArgumentParser, *, profile: bool = True) -> None:
    """python-can's own names: ``-i -c -b``; and which nodes are expected there."""
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
    """Read the value of ``--placements`` and ``--placement``."""
    found = int(text) if re.fullmatch(r"\d{1,4}", text) else 0
    if found < 1:
        raise argparse.ArgumentTypeError(f"{text} is no whole number from 1")
    return found


def tracker_option(parser: argparse.ArgumentParser) -> None:
    """``--tracker``: the port of the instrument that measures endpoints."""
    parser.add_argument(
        "--tracker",
        type=a_name,
        metavar="PORT",
        help="where measured endpoints of an open arm come from: tcp:HOST:PORT, file:PATH (CSV that grows) "
        "or stdin; a JSON object a line, with x_m, y_m, z_m and how the target is turned. Default: what the "
        "procedure says; an embedded virtual arm has a tracker of its own",
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
    """SESSION or ``--arm``: what a command connects to that takes no poses."""
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
    """Tell what to connect to: the arm of a session, or the one the options name."""
    from dataclasses import replace

    from operator_app.config.arm_file import load_arm
    from operator_app.config.procedure import DEFAULT_PROFILE
    from operator_app.config.profile_file import load_profile
    from operator_app.session.workflow.opening import begin, resume

    # Such a command takes no poses and keeps no journal: a wrong settings file need not stop it.
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
    """Where ``--record`` of a session goes."""
    return opening.folder / "bus.blf" if args.record else None


def record_option(parser: argparse.ArgumentParser) -> None:
    """``--record FILE``."""
    parser.add_argument(
        "--record", type=a_path, metavar="FILE", help="record the bus (.blf, .asc, .log)"
    )


def choices_from(args: argparse.Namespace, *, journal: bool = True) -> Choices:
    """Return what these options chose; None where they chose nothing.

    With `journal` the user's settings say who works here; where their file is wrong nobody, and that is said.
    """
    from operator_app.session.workflow.opening import Choices

    if args.seed is not None and args.seed < 0:
        raise UsageError("--seed: a seed is a whole number from zero")
    if args.channel is not None and not (args.channel.isprintable() and len(args.channel) <= 255):
        raise UsageError("--channel: a bus is named by at most 255 printable characters, e.g. can0")
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
        operator=_who_works_here() if journal else None,
        placements=getattr(args, "placements", None),
    )


def _who_works_here() -> str | None:
    from operator_app.config.user_settings import settings_if_right

    settings, wrong = settings_if_right()
    if wrong:
        say(f"sarcal: {wrong}.", err=True)
    return settings.operator


def parse_joints(text: str | None) -> tuple[int, ...]:
    """Read the value of ``--unsensed``; none where it is not given."""
    return given_joints(text) or ()


def given_joints(text: str | None) -> tuple[int, ...] | None:
    """Read the value of ``--unsensed``; None where it is not given, and something else decides."""
    return None if text is None else parse_numbers(text, "--unsensed")


def parse_numbers(text: str, option: str) -> tuple[int, ...]:
    """Read ``6,7`` into ascending numbers; UsageError when it is anything else."""
    if re.fullmatch(r"\d+(,\d+)*", text.replace(" ", "")) and "0" in re.split("[ ,]+", text):
        raise UsageError(f"{option} {text!r}: there is no 0, numbers count from 1")
    if not re.fullmatch(r"[1-9]\d*(,[1-9]\d*)*", text.replace(" ", "")):
        raise UsageError(f"{option} {text!r}: write numbers with commas, e.g. 6,7")
    return tuple(sorted({int(part) for part in text.replace(" ", "").split(",")}))


def require_joints(joints: tuple[int, ...], joint_count: int) -> None:
    """UsageError when one of `joints` is not a joint of the arm."""
    wrong = [j for j in joints if j > joint_count]
    if wrong:
        raise UsageError(f"--unsensed: there is no joint {wrong[0]}; the arm has {joint_count}")


def say_doubts(file: str, found: LoadedPoses) -> None:
    """Say what seems wrong with a file of poses that was read."""
    for warning in found.warnings:
        say(f"sarcal: {file}: {warning.text}", err=True)
