"""Arguments and options of the commands that need no bus."""

from __future__ import annotations

from typing import TYPE_CHECKING

from operator_app.commands.options import (
    ARM_AND_FIXTURE,
    declaration,
    group,
    one_of,
    option,
    shared,
    whole,
)
from operator_app.safe_output import say

if TYPE_CHECKING:
    from operator_app.config.poses_file import LoadedPoses
    from solver.chain.poses import PoseSet

PLANNED_POSES = 12
"""Number of poses to plan if neither ``--poses`` nor a procedure with planned capture states it."""
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

check = declaration(
    """
    files* FILE  arm, fixture, procedure, bus profile, parameters (YAML) and poses (CSV), in any order:
        recognised by their contents
    --arm NAME  built-in name or file of the arm
    --fixture NAME  built-in name or file of the fixture
    --procedure NAME  built-in name or file of the procedure
    """,
    shared("--json"),
)

compare = declaration(
    """
    a A  earlier parameters file, session folder, session name or latest
    b B  later parameters file, session folder, session name or latest
    --level P  probability of a false alarm over all parameters together (default 0.01)
    --remounted  the fixture was taken off in between: compare the arm's own parameters only
    """,
    shared("--sessions DIR, --json"),
)

eds = declaration(
    "-o --output DIR  folder to write joint.eds and supervisor.eds into (default: this one)"
)

help_topic = declaration(
    """
    topic? TOPIC  page or command; without it, all topics
    --markdown  print the page as Markdown
    --files FOLDER  write the files of the page into a folder; never over existing files
    """
)

history = declaration(
    """
    serial? SERIAL  serial number of the arm, e.g. SDA-0001; optional if all sessions are from one arm
    --kept-mounted  the fixture stays mounted between sessions: compare its placement too; without this
        option each session has a new placement
    --every DAYS  interval between calibrations in days (default: the median so far)
    -o --output FILE  write an HTML page with charts to this file too
    """,
    shared("--sessions DIR, --json"),
)

import_poses = declaration(
    """
    poses+ POSES.csv  a poses file; a log with a row of joint angles for each pose; or a recording: a
        ROS 2 bag (.mcap, .db3, its folder) or, with --time, a log over time; several files: each is
        one placement of the fixture, in this order
    """,
    ARM_AND_FIXTURE,
    one_of(
        """
        --rad  the angles are radians
        --deg  the angles are degrees, however small they are
        """
    ),
    """
    --columns LIST  columns of joints 1, 2, ...: numbers from 1 (2-8) or names of the header
        (q1,q2,...); of a bag: names of its joints
    """,
    group(
        "recordings: one pose for each time at rest",
        """
        --time COLUMN  column of the times (s, or ISO 8601) by number or name, which makes the log a
            recording
        --topic TOPIC  topic of a bag's JointState messages (default /joint_states)
        --dwell-s S  shortest time at rest, s (default 1)
        --spread-deg DEG  largest minus smallest reading of each joint at rest, deg (default 0.05)
        """,
    ),
    """
    --placement COLUMN  column of a log, by number or name, with the fixture's placement for each pose
    --serial TEXT  serial number of the arm, for compare
    --name NAME  name of the session (default: that of the file)
    """,
    shared("--estimator, --unsensed JOINTS, --length-tolerance MM, --sessions DIR, --json"),
)

new = declaration(
    option("what", "what to make", choices=tuple(OF_WHAT)),
    """
    --from NAME  copy this built-in file with its comments, to change its numbers
    --name NAME  name of the new arm, fixture or procedure
    -o --output FILE  file to write (default: NAME.yaml)
    """,
    group(
        "arm",
        """
        --urdf FILE  the arm's URDF (not xacro)
        --base LINK  link that the chain starts at (default: the root)
        --tip LINK  link that the chain ends at, e.g. the flange
        """,
    ),
    group(
        "fixture, measured in the base (frame 0) and on the tool (frame n)",
        """
        --arm ARM  arm file or built-in name, for a fixture or a procedure
        --kind  what constrains the tool
        --hand-point X,Y,Z  a point of the hinge axis, or the ball's centre, in mm in the last frame of
            the arm's D-H table
        --hand-direction X,Y,Z  along the hinge axis, in the last frame of the arm's D-H table
        --base-point X,Y,Z  the same point, in mm in frame 0 of the table (default: where it is at the
            arm's home_deg)
        --base-direction X,Y,Z  along the hinge axis, in frame 0 of the table (default: its direction at
            the arm's home_deg)
        --tolerance-mm MM  tolerance of the positions
        --tolerance-deg DEG  tolerance of the directions
        """,
    ),
    group("procedure", "--fixture FIXTURE  fixture file or built-in name"),
)

plan = declaration(
    f"""
    procedure?  procedure file or built-in name (default hinge)
    --arm ARM  arm file or built-in name, in place of the procedure's
    --fixture FIXTURE  fixture file or built-in name, in place of the procedure's
    --poses N  how many poses to plan (default {PLANNED_POSES})
    --unsensed JOINTS  joints whose readings are not used, e.g. 6,7
    --session SESSION  plan from the poses and estimate of a session: folder, name or latest
    --advise  also search for better hinge placements
    --tries N  placements to try with --advise (default {TRIES}, half a second each)
    --ascii  only ASCII characters
    """,
    shared("--sessions DIR, --json"),
)

report = declaration(
    shared("session SESSION"),
    """
    -o --output FILE  file to write (default: report.html in the session folder; - is stdout)
    """,
    one_of(
        """
        --text  print what sarcal run printed, and write no page
        --json  print the object of sarcal run --json instead
        --plots FOLDER  write figures for a paper into this folder instead, as SVG, and as PDF with the
            extra [plots]
        """
    ),
    shared("--estimator, --unsensed JOINTS, --sessions DIR"),
)

reproduce = declaration(
    option("--poses N", "how many poses (default 40)", type=whole(8, 120), default=40),
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
    "name?  folder, name or latest (default: latest; repair needs a name)",
    shared("--sessions DIR, --json"),
)

settings = declaration(
    f"""
    settings* KEY=VALUE  a setting to change; KEY= removes it. Keys: {", ".join(SETTINGS_MEANING)}
    """,
    shared("--json"),
)

solve = declaration(
    "poses POSES.csv  captured poses, angles in deg",
    ARM_AND_FIXTURE,
    """
    --placements NUMBERS  use these placements only, e.g. 1,2
    --global-start  search globally instead of starting from the nominal values
    --checks  add the pose-wise jackknife and hold-out (5 folds, and a block far from the rest)
    --test FILE  test the result with other poses, of the same placement or, with a ball that stays on
        the tool, of others too; exit 4 if it fails
    --rvdt-table FILE  correct the readings of RVDTs by the tables of this parameters file (an earlier
        calibration's)
    """,
    shared("--estimator, --unsensed JOINTS, --length-tolerance MM, --json"),
)


def poses_with_warnings(file: str, loaded: LoadedPoses) -> PoseSet:
    """Print the warnings about a poses file, and return its poses."""
    for warning in loaded.warnings:
        say(f"sarcal: {file}: {warning.text}", err=True)
    return loaded.poses
