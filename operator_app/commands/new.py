"""`sarcal new`: creates an arm, fixture or procedure file, to be completed."""

import argparse
import math
import os
import re
from collections.abc import Callable, Sequence
from dataclasses import replace
from pathlib import Path

import numpy as np

from fixtures.ball import Ball
from fixtures.hinge import Hinge
from operator_app.commands.file_arguments import OF_WHAT
from operator_app.config import resources
from operator_app.config.any_file import save_with_schema, schema_line
from operator_app.config.arm_file import load_arm, parse_arm
from operator_app.config.atomic import dump_strict
from operator_app.config.fixture_file import load_fixture, parse_fixture
from operator_app.config.new_files import copied, fixture_file, procedure_file
from operator_app.config.procedure_file import parse_procedure
from operator_app.config.quantities import short_degrees
from operator_app.config.urdf_reading import COUNTS_PER_REV, arm_file_of, parse_urdf
from operator_app.exit_codes import ExitCode, UsageError
from operator_app.planning.feasibility import home_to_closed_rad
from operator_app.planning.proposals import ball_between, bent_home, hinge_between
from operator_app.planning.task import entries_to_fix
from operator_app.safe_output import say
from operator_app.units import ANGLE, DEVIATION, LENGTH, Figure
from solver.arrays import FloatArray
from solver.loops.endpoint_geometry import Line

URDF_COMMENT = """\
{line}
Made from {urdf} by `sarcal new arm`. Geometry, ranges, speeds and torques are that file's, unless listed here.
Check these before use; the URDF does not state them:
{limits}- sensor of every joint: encoder of {counts} counts/rev assumed. joints: {{kind: rvdt, ...}} and
  {{kind: none}} are known as well; accuracy_deg, gain, backlash_deg and sag_deg have their
  defaults.
- free: the entries to calibrate beside the fixture's.
- home_deg: {home}
  Check it before a fixture is made for it; change it if something is in the way.
- tolerance: standard deviation of lengths and twists, by default 0.5 mm and 0.1 deg.
- offset_tolerance_deg: standard deviation of the joint offsets, 5 deg assumed; `unknown` if nothing is
  known."""

ASSUMED_LIMITS = {
    "range": "a range to -180 or 180 deg",
    "velocity": "a speed of 90 deg/s",
    "effort": "a torque of 50 N m",
}


def execute(args: argparse.Namespace) -> int:
    """Create the file, and print what the user must check in it."""
    of_others = {o for options in OF_WHAT.values() for o in options} - set(OF_WHAT[args.what])
    for name in sorted(of_others):
        if getattr(args, name) is not None:
            raise UsageError(f"{_typed(name)} is not an option of sarcal new {args.what}")
    for name in ("tolerance_mm", "tolerance_deg"):
        stated = getattr(args, name)
        if stated is not None and not math.isfinite(stated):
            raise UsageError(f"{_typed(name)} {stated}: not a finite number, e.g. 0.5")
    return {"arm": _arm, "fixture": _fixture, "procedure": _procedure}[args.what](args)


def _arm(args: argparse.Namespace) -> int:
    if bool(args.urdf) == bool(args.packaged):
        raise UsageError("new arm: give --urdf FILE or --from NAME")
    if args.packaged:
        return _copy(args, parse_arm)
    data = resources.read_limited(
        resources.expanded(args.urdf), args.urdf, limit=resources.DESCRIPTION_LIMIT_BYTES
    )
    chain = parse_urdf(data, args.urdf, base=args.base or "", tip=args.tip or "")
    name = _named(args.name or chain.name)
    body = dict(arm_file_of(chain, name=name))
    bent = bent_home(parse_arm(dump_strict(body), args.urdf))
    home = "the middle of the ranges."
    if bent is not None:
        body["home_deg"] = short_degrees(bent)
        home = "bent so that every joint moves in a hinge; in the middle of the ranges the arm is stretched out."
    limits = [f"- limits of {text}\n" for text in chain.unstated]
    # Without the names of the joints, which may contain any word.
    unstated = " ".join(text.partition(": ")[2] for text in chain.unstated)
    assumed = "Assumed: " + ", ".join(v for k, v in ASSUMED_LIMITS.items() if k in unstated)
    comment = URDF_COMMENT.format(
        line=schema_line("arm"),
        urdf=Path(args.urdf).name,
        limits="".join([*limits, f"  {assumed}.\n"] if limits else []),
        counts=COUNTS_PER_REV,
        home=home,
    )
    target = _save(args, name, dump_strict(body, comment=comment), parse_arm)
    say(f"Arm         {target}: {len(chain.joints)} joints, {chain.base} to {chain.tip}")
    if chain.rounded:
        meanings = ", ".join(f"{word} is {deg:g} deg" for word, deg in chain.rounded.items())
        say(f"Angles      rounded in the file are taken as exact: {meanings}")
    if chain.unstated:
        say(
            f"! Limits that the URDF does not state, or states as placeholders: {'; '.join(chain.unstated)}. "
            f"{assumed}. State the arm's own limits in its file."
        )
    if bent is not None:
        say("Home        bent: the middle of the ranges does not identify all parameters")
    for T, where in (
        (chain.frames[0], "the file's base link to frame 0"),
        (chain.T_flange_tip, f"frame {len(chain.joints)} to the link at the end"),
    ):
        if not np.allclose(T, np.eye(4), atol=1e-9):
            step = ", ".join(Figure(x, LENGTH, places=3).shown for x in T[:3, 3].tolist())
            cosine = np.clip(0.5 * (np.trace(T[:3, :3]) - 1.0), -1.0, 1.0)
            turn = Figure(float(np.arccos(cosine)), ANGLE, places=3).with_unit
            say(
                f"! From {where} there is a fixed transform that D-H rows cannot represent: "
                f"({step}) {LENGTH.unit} and a turn of {turn}."
            )
    say("! Sensors, free entries and home pose are assumptions: see the top of the file.")
    return ExitCode.ACCEPTED


def _fixture(args: argparse.Namespace) -> int:
    if args.packaged:
        for option in OF_WHAT["fixture"]:
            if getattr(args, option) is not None:
                raise UsageError(f"--from copies a file: leave {_typed(option)} out")
        return _copy(args, parse_fixture)
    if not (args.kind and args.arm and args.hand_point):
        raise UsageError(
            "new fixture: give --from NAME, or --kind, --arm and the measured --hand-point"
        )
    arm = load_arm(args.arm)
    name = _named(args.name or f"{arm.name}_{args.kind}")
    fixture: Ball | Hinge
    if args.kind == "ball":
        for option in ("hand_direction", "base_direction"):
            if getattr(args, option):
                raise UsageError(f"{_typed(option)}: a ball is a point and has no direction")
        base = _millimetres(args, "base_point") if args.base_point else None
        fixture = ball_between(arm, _millimetres(args, "hand_point"), base)
    else:
        on_hand, on_base = _line(args, "hand"), args.base_point or args.base_direction
        fixture = hinge_between(arm, on_hand, _line(args, "base") if on_base else None)
    tolerance = load_fixture(args.kind).fixture.tolerance
    if args.tolerance_mm is not None:
        tolerance = replace(tolerance, position_m=args.tolerance_mm / 1e3)
    if args.tolerance_deg is not None:
        tolerance = replace(tolerance, orientation_rad=math.radians(args.tolerance_deg))
    content = fixture_file(replace(fixture, tolerance=tolerance), name=name, arm=arm)
    target = _save(args, name, content, parse_fixture)
    say(f"Fixture     {target}: {args.kind} for {arm.name}")
    distance = home_to_closed_rad(arm, fixture)
    if distance is None:
        say(
            "! No pose near the arm's home_deg closes. Check the measured values; then find a home that closes: "
            f"sarcal check --arm {args.arm} {target}"
        )
    else:
        joint = int(np.argmax(np.abs(distance)))
        size = DEVIATION(float(abs(distance[joint]))).with_unit
        say(
            f"From the arm's home_deg to the nearest pose that closes: {size} at most, joint {joint + 1}."
        )
    say("! The compliance of the fixture is an assumption: see the top of the file.")
    return ExitCode.ACCEPTED


def _procedure(args: argparse.Namespace) -> int:
    def read(data: bytes, file: str) -> object:
        return parse_procedure(resources.Resource(file=file, folder=Path(file).parent, data=data))

    if args.packaged:
        return _copy(args, read, refers=("arm", "fixture"))
    if not (args.arm and args.fixture):
        raise UsageError("new procedure: give --arm and --fixture, or --from NAME")
    arm, spec = load_arm(args.arm), load_fixture(args.fixture)
    name = _named(args.name or f"{arm.name}_in_{spec.name}")
    held = entries_to_fix(arm, spec.fixture)
    content = procedure_file(
        name=name,
        arm=arm,
        arm_reference=_reference(args, name, args.arm),
        fixture_reference=_reference(args, name, args.fixture),
        held=held,
        closed=spec.fixture.holds_hand,
    )
    target = _save(args, name, content, read)
    say(f"Procedure   {target}: {arm.name} in {spec.name}")
    for entry, reason in held.items():
        say(f"{entry} is fixed: {reason}.")
    say(f"Check it with: sarcal check {target}")
    return ExitCode.ACCEPTED


def _copy(
    args: argparse.Namespace, parse: Callable[[bytes, str], object], *, refers: Sequence[str] = ()
) -> int:
    name = _named(args.name or f"my_{args.packaged}")
    instead = {k: _reference(args, name, v) for k in refers if (v := getattr(args, k))}
    content = copied(args.what, args.packaged, name=name, **instead)
    target = _save(args, name, content, parse)
    say(f"{args.what.capitalize():<12}{target}: a copy of {args.packaged}; change its numbers")
    return ExitCode.ACCEPTED


def _typed(option: str) -> str:
    return f"--{option.replace('_', '-')}"


def _named(text: str) -> str:
    name = re.sub(r"[^A-Za-z0-9_.-]+", "_", text).strip("_.-")[:64]
    if not re.match(r"[A-Za-z]", name):
        raise UsageError(f"--name: {name!r} does not begin with a letter; use another")
    return name


def _target(args: argparse.Namespace, name: str) -> Path:
    return args.output or Path(f"{name}.yaml")


def _save(
    args: argparse.Namespace, name: str, content: bytes, parse: Callable[[bytes, str], object]
) -> Path:
    """Check a file by parsing it, then write it and its JSON Schema; an existing file is never overwritten."""
    target = _target(args, name)
    if resources.exists(target):
        raise UsageError(f"{target} exists already; name another file with -o")
    parse(content, str(target))
    save_with_schema(target, content, args.what)
    return target


def _reference(args: argparse.Namespace, name: str, file: str) -> str:
    """Return the entry for `file` in a procedure: built-in name, absolute path, or path from the procedure's folder."""
    builtin = (*resources.builtin_names("arm"), *resources.builtin_names("fixture"))
    if file in builtin:
        return file
    path = resources.expanded(file)
    if path.is_absolute():
        return str(path)
    relative = os.path.relpath(path, _target(args, name).parent)
    # Without ./ the path would mean the built-in file, or a home folder.
    return f"./{relative}" if relative in builtin or relative.startswith("~") else relative


def _millimetres(args: argparse.Namespace, option: str) -> FloatArray:
    return _vector(args, option) / 1e3


def _line(args: argparse.Namespace, side: str) -> Line:
    direction = _vector(args, f"{side}_direction")
    largest = float(np.abs(direction).max())
    if largest == 0.0:
        raise UsageError(f"{_typed(f'{side}_direction')}: a direction cannot be 0,0,0")
    direction /= largest
    length = float(np.linalg.norm(direction))
    return Line(point_m=_millimetres(args, f"{side}_point"), direction=direction / length)


def _vector(args: argparse.Namespace, option: str) -> FloatArray:
    text = getattr(args, option)
    if not text:
        raise UsageError(
            f"a hinge is measured as a point and a direction along it: {_typed(option)} is missing"
        )
    try:
        vector = np.array([float(part) for part in text.split(",")])
    except ValueError:
        vector = np.array([])
    if vector.shape != (3,) or not np.all(np.isfinite(vector)):
        raise UsageError(
            f"{_typed(option)} {text!r}: write three numbers separated by commas, e.g. 0,30,-12.5"
        )
    return vector
