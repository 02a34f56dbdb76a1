"""Arguments and options of the commands that need no bus."""

from __future__ import annotations

import argparse
from pathlib import Path

from operator_app.commands.options import (
    a_path,
    arm_and_fixture_options,
    option,
    options,
    pose_count,
)

PLANNED_POSES = 12
"""Number of poses to plan if the procedure's own capture is not planned."""
TRIES = 24
OF_WHAT = {
    "arm": ("urdf", "base", "tip"),
    "fixture": (
        "arm",
        "kind",
        "hand_point",
        "hand_direction",
        "base_point",
        "base_direction",
        "tolerance_mm",
        "tolerance_deg",
    ),
    "procedure": ("arm", "fixture"),
}
"""Options of `sarcal new` that only some kinds of file have, by kind; other options apply to every kind."""
SETTINGS_MEANING = {
    "interface": "the bus, as -i",
    "channel": "as -c, with that interface",
    "bitrate": "as -b, with that interface",
    "theme": "of the terminal app: dark, light, none",
    "operator": "recorded in the journal of every session",
}


def check(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal check`."""
    option(
        parser,
        "files* FILE",
        "arm, fixture, procedure, bus profile, parameters (YAML) and poses (CSV), in any order: recognised "
        "by their contents",
    )
    for kind in ("arm", "fixture", "procedure"):
        option(parser, f"--{kind} NAME", f"built-in name or file of the {kind}")
    options(parser, "--json")


def compare(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal compare`."""
    for name, which in (("a", "earlier"), ("b", "later")):
        what = f"{which} parameters file, session folder, session name or latest"
        option(parser, f"{name} {name.upper()}", what)
    option(
        parser,
        "--level P",
        "probability of a false alarm over all parameters together (default 0.01)",
        type=float,
        default=0.01,
    )
    option(
        parser,
        "--remounted",
        "the fixture was taken off in between: compare the arm's own parameters only",
    )
    options(parser, "--sessions DIR, --json")


def eds(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal eds`."""
    option(
        parser,
        "-o --output DIR",
        "folder to write joint.eds and supervisor.eds into (default: this one)",
        type=a_path,
        default=Path(),
    )


def help_topic(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal help`."""
    option(parser, "topic? TOPIC", "page or command; without it, all topics")
    option(parser, "--markdown", "print the page as Markdown")
    option(
        parser,
        "--files FOLDER",
        "write the files of the page into a folder; never over existing files",
        type=a_path,
    )


def history(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal history`."""
    option(
        parser,
        "serial? SERIAL",
        "serial number of the arm, e.g. SDA-0001; optional if all sessions are from one arm",
    )
    option(
        parser,
        "--kept-mounted",
        "the fixture stays mounted between sessions: compare its placement too; without this option each session "
        "has a new placement",
    )
    option(
        parser,
        "--every DAYS",
        "interval between calibrations in days (default: the median so far)",
        type=float,
    )
    option(
        parser, "-o --output FILE", "write an HTML page with charts to this file too", type=a_path
    )
    options(parser, "--sessions DIR, --json")


def import_poses(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal import`."""
    option(
        parser,
        "poses+ POSES.csv",
        "a poses file; a log with a row of joint angles for each pose; or a recording: a ROS 2 bag "
        "(.mcap, .db3, its folder) or, with --time, a log over time; of several files each is a placement "
        "of the fixture, in this order",
    )
    arm_and_fixture_options(parser)
    unit = parser.add_mutually_exclusive_group()
    option(unit, "--rad", "the angles are radians")
    option(unit, "--deg", "the angles are degrees, however small they are")
    option(
        parser,
        "--columns LIST",
        "columns of joints 1, 2, ...: numbers from 1 (2-8) or names of the header (q1,q2,...); "
        "of a bag: names of its joints",
    )
    recorded = parser.add_argument_group("recordings: one pose for each time at rest")
    option(
        recorded,
        "--time COLUMN",
        "column of the times (s, or ISO 8601) by number or name, which makes the log a recording",
    )
    option(
        recorded, "--topic TOPIC", "of a bag's sensor_msgs/msg/JointState (default /joint_states)"
    )
    option(recorded, "--dwell-s S", "shortest time at rest, s (default 1)", type=float)
    option(
        recorded,
        "--spread-deg DEG",
        "largest minus smallest reading of each joint at rest, deg (default 0.05)",
        type=float,
    )
    option(
        parser,
        "--placement COLUMN",
        "column of a log, by number or name, with the fixture's placement for each pose",
    )
    option(parser, "--serial TEXT", "serial number of the arm, for compare")
    option(parser, "--name NAME", "name of the session (default: that of the file)")
    options(parser, "--estimator, --unsensed JOINTS, --length-tolerance MM, --sessions DIR, --json")


def new(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal new`."""
    option(parser, "what", "what to make", choices=tuple(OF_WHAT))
    option(
        parser,
        "--from NAME",
        "copy this built-in file with its comments, to change its numbers",
        dest="packaged",
    )
    option(parser, "--name NAME", "name of the new arm, fixture or procedure")
    option(parser, "-o --output FILE", "file to write (default: NAME.yaml)", type=a_path)
    urdf = parser.add_argument_group("arm")
    option(urdf, "--urdf FILE", "the arm's URDF (not xacro)")
    option(urdf, "--base LINK", "link that the chain starts at (default: the root)")
    option(urdf, "--tip LINK", "link that the chain ends at, e.g. the flange")
    fixture = parser.add_argument_group(
        "fixture, measured in the base (frame 0) and on the tool (frame n)"
    )
    option(fixture, "--arm ARM", "arm file or built-in name, for a fixture or a procedure")
    option(fixture, "--kind", "what constrains the tool", choices=("hinge", "ball"))
    for side, where in (
        ("hand", "in the last frame of the arm's D-H table"),
        ("base", "in its frame 0; default: its position at the arm's home_deg"),
    ):
        option(
            fixture,
            f"--{side}-point X,Y,Z",
            f"a point of the hinge axis, the same one on tool and base, or the ball's centre, {where}, mm",
        )
        option(fixture, f"--{side}-direction X,Y,Z", f"along the hinge axis, {where}")
    option(fixture, "--tolerance-mm MM", "standard deviation of positions", type=float)
    option(fixture, "--tolerance-deg DEG", "standard deviation of directions", type=float)
    procedure = parser.add_argument_group("procedure")
    option(procedure, "--fixture FIXTURE", "fixture file or built-in name")


def plan(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal plan`."""
    option(parser, "procedure?", "procedure file or built-in name (default hinge)")
    option(parser, "--arm ARM", "arm file or built-in name, in place of the procedure's")
    option(
        parser, "--fixture FIXTURE", "fixture file or built-in name, in place of the procedure's"
    )
    option(
        parser, "--poses N", f"how many poses to plan (default {PLANNED_POSES})", type=pose_count
    )
    option(parser, "--unsensed JOINTS", "joints whose readings are not used, e.g. 6,7")
    option(
        parser,
        "--session SESSION",
        "plan from the poses and estimate of a session: folder, name or latest",
    )
    option(parser, "--advise", "also search for better hinge placements")
    option(
        parser,
        "--tries N",
        f"placements to try with --advise (default {TRIES}, half a second each)",
        type=int,
        default=TRIES,
    )
    option(parser, "--ascii", "only ASCII characters")
    options(parser, "--sessions DIR, --json")


def report(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal report`."""
    options(parser, "session SESSION")
    option(
        parser,
        "-o --output FILE",
        "file to write (default: report.html in the session folder; - is stdout)",
        type=a_path,
    )
    shown = parser.add_mutually_exclusive_group()
    option(shown, "--text", "print what sarcal run printed, and write no page")
    option(shown, "--json", "print the object of sarcal run --json instead")
    option(
        shown,
        "--plots FOLDER",
        "write figures for a paper into this folder instead, as SVG, and as PDF with the extra [plots]",
        type=a_path,
    )
    options(parser, "--estimator, --unsensed JOINTS, --sessions DIR")


def reproduce(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal reproduce`."""
    option(parser, "--poses N", "how many (default 40)", type=pose_count, default=40)
    options(parser, "--json")


def session(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal session`."""
    option(
        parser,
        "action?",
        "list all (the default); show one; or repair a damaged journal: lines with a matching checksum are "
        "kept, the others are reported, the damaged file is kept beside it",
        choices=("list", "show", "repair"),
        default="list",
    )
    option(parser, "name?", "folder, name or latest (the default, but not to repair)")
    options(parser, "--sessions DIR, --json")


def settings(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal settings`."""
    option(
        parser,
        "settings* KEY=VALUE",
        "set it; KEY= removes it. Keys: " + ", ".join(SETTINGS_MEANING),
    )
    options(parser, "--json")


def solve(parser: argparse.ArgumentParser) -> None:
    """Declare the options of `sarcal solve`."""
    option(parser, "poses POSES.csv", "captured poses, angles in deg")
    arm_and_fixture_options(parser)
    option(parser, "--placements NUMBERS", "use these placements only, e.g. 1,2")
    option(parser, "--global-start", "search globally instead of starting from the nominal values")
    option(
        parser,
        "--checks",
        "add the pose-wise jackknife and hold-out (5 folds, and a block far from the rest)",
    )
    option(
        parser,
        "--test FILE",
        "test the result with other poses, of the same placement or, with a ball that stays on the tool, of "
        "others too; exit 4 if it fails",
    )
    option(
        parser,
        "--rvdt-table FILE",
        "correct the readings of RVDTs by the tables of this parameters file (an earlier calibration's)",
    )
    options(parser, "--estimator, --unsensed JOINTS, --length-tolerance MM, --json")
