"""Arguments and options of the commands that need no bus."""

from __future__ import annotations

from pathlib import Path
from typing import TYPE_CHECKING

from operator_app.commands.options import (
    ARM_AND_FIXTURE,
    a_path,
    declaration,
    group,
    one_of,
    option,
    pose_count,
    shared,
)
from operator_app.safe_output import say

if TYPE_CHECKING:
    from operator_app.config.poses_file import LoadedPoses

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
_PARAMETERS = "parameters file, session folder, session name or latest"
_POINT = "a point of the hinge axis, the same one on tool and base, or the ball's centre"
_MEASURED = (
    ("hand", "in the last frame of the arm's D-H table"),
    ("base", "in its frame 0; default: its position at the arm's home_deg"),
)
"""Parts of the arm at which a fixture is measured, each with a text that names the frame of the measurement."""

check = declaration(
    option(
        "files* FILE",
        "arm, fixture, procedure, bus profile, parameters (YAML) and poses (CSV), in any order: recognised "
        "by their contents",
    ),
    *(
        option(f"--{kind} NAME", f"built-in name or file of the {kind}")
        for kind in ("arm", "fixture", "procedure")
    ),
    shared("--json"),
)

compare = declaration(
    option("a A", f"earlier {_PARAMETERS}"),
    option("b B", f"later {_PARAMETERS}"),
    option(
        "--level P",
        "probability of a false alarm over all parameters together (default 0.01)",
        type=float,
        default=0.01,
    ),
    option(
        "--remounted", "the fixture was taken off in between: compare the arm's own parameters only"
    ),
    shared("--sessions DIR, --json"),
)

eds = declaration(
    option(
        "-o --output DIR",
        "folder to write joint.eds and supervisor.eds into (default: this one)",
        type=a_path,
        default=Path(),
    )
)

help_topic = declaration(
    option("topic? TOPIC", "page or command; without it, all topics"),
    option("--markdown", "print the page as Markdown"),
    option(
        "--files FOLDER",
        "write the files of the page into a folder; never over existing files",
        type=a_path,
    ),
)

history = declaration(
    option(
        "serial? SERIAL",
        "serial number of the arm, e.g. SDA-0001; optional if all sessions are from one arm",
    ),
    option(
        "--kept-mounted",
        "the fixture stays mounted between sessions: compare its placement too; without this option each session "
        "has a new placement",
    ),
    option(
        "--every DAYS",
        "interval between calibrations in days (default: the median so far)",
        type=float,
    ),
    option("-o --output FILE", "write an HTML page with charts to this file too", type=a_path),
    shared("--sessions DIR, --json"),
)

import_poses = declaration(
    option(
        "poses+ POSES.csv",
        "a poses file; a log with a row of joint angles for each pose; or a recording: a ROS 2 bag "
        "(.mcap, .db3, its folder) or, with --time, a log over time; several files: each is one placement "
        "of the fixture, in this order",
    ),
    ARM_AND_FIXTURE,
    one_of(
        option("--rad", "the angles are radians"),
        option("--deg", "the angles are degrees, however small they are"),
    ),
    option(
        "--columns LIST",
        "columns of joints 1, 2, ...: numbers from 1 (2-8) or names of the header (q1,q2,...); "
        "of a bag: names of its joints",
    ),
    group(
        "recordings: one pose for each time at rest",
        option(
            "--time COLUMN",
            "column of the times (s, or ISO 8601) by number or name, which makes the log a recording",
        ),
        option("--topic TOPIC", "topic of a bag's JointState messages (default /joint_states)"),
        option("--dwell-s S", "shortest time at rest, s (default 1)", type=float),
        option(
            "--spread-deg DEG",
            "largest minus smallest reading of each joint at rest, deg (default 0.05)",
            type=float,
        ),
    ),
    option(
        "--placement COLUMN",
        "column of a log, by number or name, with the fixture's placement for each pose",
    ),
    option("--serial TEXT", "serial number of the arm, for compare"),
    option("--name NAME", "name of the session (default: that of the file)"),
    shared("--estimator, --unsensed JOINTS, --length-tolerance MM, --sessions DIR, --json"),
)

new = declaration(
    option("what", "what to make", choices=tuple(OF_WHAT)),
    option(
        "--from NAME",
        "copy this built-in file with its comments, to change its numbers",
        dest="packaged",
    ),
    option("--name NAME", "name of the new arm, fixture or procedure"),
    option("-o --output FILE", "file to write (default: NAME.yaml)", type=a_path),
    group(
        "arm",
        option("--urdf FILE", "the arm's URDF (not xacro)"),
        option("--base LINK", "link that the chain starts at (default: the root)"),
        option("--tip LINK", "link that the chain ends at, e.g. the flange"),
    ),
    group(
        "fixture, measured in the base (frame 0) and on the tool (frame n)",
        option("--arm ARM", "arm file or built-in name, for a fixture or a procedure"),
        option("--kind", "what constrains the tool", choices=("hinge", "ball")),
        *(
            measured
            for side, where in _MEASURED
            for measured in (
                option(f"--{side}-point X,Y,Z", f"{_POINT}, {where}, mm"),
                option(f"--{side}-direction X,Y,Z", f"along the hinge axis, {where}"),
            )
        ),
        option("--tolerance-mm MM", "tolerance of the positions", type=float),
        option("--tolerance-deg DEG", "tolerance of the directions", type=float),
    ),
    group("procedure", option("--fixture FIXTURE", "fixture file or built-in name")),
)

plan = declaration(
    option("procedure?", "procedure file or built-in name (default hinge)"),
    option("--arm ARM", "arm file or built-in name, in place of the procedure's"),
    option("--fixture FIXTURE", "fixture file or built-in name, in place of the procedure's"),
    option("--poses N", f"how many poses to plan (default {PLANNED_POSES})", type=pose_count),
    option("--unsensed JOINTS", "joints whose readings are not used, e.g. 6,7"),
    option(
        "--session SESSION", "plan from the poses and estimate of a session: folder, name or latest"
    ),
    option("--advise", "also search for better hinge placements"),
    option(
        "--tries N",
        f"placements to try with --advise (default {TRIES}, half a second each)",
        type=int,
    ),
    option("--ascii", "only ASCII characters"),
    shared("--sessions DIR, --json"),
)

report = declaration(
    shared("session SESSION"),
    option(
        "-o --output FILE",
        "file to write (default: report.html in the session folder; - is stdout)",
        type=a_path,
    ),
    one_of(
        option("--text", "print what sarcal run printed, and write no page"),
        option("--json", "print the object of sarcal run --json instead"),
        option(
            "--plots FOLDER",
            "write figures for a paper into this folder instead, as SVG, and as PDF with the extra [plots]",
            type=a_path,
        ),
    ),
    shared("--estimator, --unsensed JOINTS, --sessions DIR"),
)

reproduce = declaration(
    option("--poses N", "how many poses (default 40)", type=pose_count, default=40),
    shared("--json"),
)

session = declaration(
    option(
        "action?",
        "list all (the default); show one; or repair a damaged journal: lines with a matching checksum are "
        "kept, the others are reported, the damaged file is kept beside it",
        choices=("list", "show", "repair"),
        default="list",
    ),
    option("name?", "folder, name or latest (default: latest; repair needs a name)"),
    shared("--sessions DIR, --json"),
)

settings = declaration(
    option(
        "settings* KEY=VALUE",
        f"a setting to change; KEY= removes it. Keys: {', '.join(SETTINGS_MEANING)}",
    ),
    shared("--json"),
)

solve = declaration(
    option("poses POSES.csv", "captured poses, angles in deg"),
    ARM_AND_FIXTURE,
    option("--placements NUMBERS", "use these placements only, e.g. 1,2"),
    option("--global-start", "search globally instead of starting from the nominal values"),
    option(
        "--checks",
        "add the pose-wise jackknife and hold-out (5 folds, and a block far from the rest)",
    ),
    option(
        "--test FILE",
        "test the result with other poses, of the same placement or, with a ball that stays on the tool, of "
        "others too; exit 4 if it fails",
    ),
    option(
        "--rvdt-table FILE",
        "correct the readings of RVDTs by the tables of this parameters file (an earlier calibration's)",
    ),
    shared("--estimator, --unsensed JOINTS, --length-tolerance MM, --json"),
)


def print_warnings(file: str, loaded: LoadedPoses) -> None:
    """Print the warnings about a poses file."""
    for warning in loaded.warnings:
        say(f"sarcal: {file}: {warning.text}", err=True)
