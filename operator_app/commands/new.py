"""`sarcal new arm`: an arm file made from a URDF, for somebody to complete."""

from __future__ import annotations

import argparse
from pathlib import Path

from operator_app.exit_codes import ExitCode, UsageError
from operator_app.units.figure import ANGLE, LENGTH, Figure
from operator_app.words_out import say

LARGEST = 16 * 1024 * 1024

COMMENT = """\
Made from {urdf} by `sarcal new arm`. Geometry, ranges, speeds and torques are that file's.
Look at these before use; nobody stated them there:
- sensor of every joint: encoder of {counts} counts/rev assumed. joints: {{kind: rvdt, ...}} and
  {{kind: none}} are known as well; accuracy_deg, gain, backlash_deg and sag_deg have their
  defaults.
- free: the entries to calibrate beside the fixture's. home_deg: the middle of the ranges.
- tolerance: how well lengths and twists are known, by default 0.5 mm and 0.1 deg.
- offset_tolerance_deg: how well the joints' zeros are known before; without it nothing is."""


def add_arguments(parser: argparse.ArgumentParser) -> None:
    """Declare the options."""
    parser.add_argument("what", choices=("arm",), help="what to make")
    parser.add_argument("--urdf", required=True, metavar="FILE", help="the arm's URDF (not xacro)")
    parser.add_argument(
        "--tip", default="", metavar="LINK", help="link that the chain ends at, e.g. the flange"
    )
    parser.add_argument("--name", default="", help="name of the arm (default: that of the robot)")
    parser.add_argument(
        "-o", "--output", type=Path, metavar="FILE", help="write it there (default: NAME.yaml)"
    )


def execute(args: argparse.Namespace) -> int:
    """Read the URDF, write the arm file, say what to look at."""
    import re

    import numpy as np

    from operator_app.config.arm_file import parse_arm
    from operator_app.config.atomic import write_atomically
    from operator_app.config.resources import expanded, read_limited
    from operator_app.config.urdf import COUNTS_PER_REV, arm_file_of, parse_urdf
    from operator_app.config.yaml_writer import dump_strict

    data = read_limited(expanded(args.urdf), args.urdf, limit=LARGEST)
    chain = parse_urdf(data, args.urdf, tip=args.tip)
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", args.name or chain.name).strip("_.-")[:64]
    if not re.match(r"[A-Za-z]", name):
        raise UsageError(f"--name: {name!r} does not begin with a letter; name the arm")
    target = args.output or Path(f"{name}.yaml")
    if target.exists():
        raise UsageError(f"{target} exists already; name another file with -o")
    comment = COMMENT.format(urdf=Path(args.urdf).name, counts=COUNTS_PER_REV)
    content = dump_strict(arm_file_of(chain, name=name), comment=comment)
    parse_arm(content, str(target))
    write_atomically(target, content)
    say(f"Arm         {target}: {len(chain.joints)} joints")
    for T, where in (
        (chain.T_link_base, "the file's base link to frame 0"),
        (chain.T_flange_tip, f"frame {len(chain.joints)} to the link at the end"),
    ):
        if not np.allclose(T, np.eye(4), atol=1e-9):
            step = ", ".join(Figure(x, LENGTH, places=3).shown for x in T[:3, 3].tolist())
            cosine = np.clip(0.5 * (np.trace(T[:3, :3]) - 1.0), -1.0, 1.0)
            turn = Figure(float(np.arccos(cosine)), ANGLE, places=3).with_unit
            say(
                f"! From {where} there is a fixed step that D-H rows do not hold: "
                f"({step}) {LENGTH.unit} and a turn of {turn}."
            )
    say("! Sensors, free entries and home pose are assumed: see the top of the file.")
    return ExitCode.ACCEPTED
