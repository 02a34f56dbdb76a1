"""Content of the files that `sarcal new` writes: fixtures, procedures, copies of built-in files.

All are checked by the same models as any other file.
"""

import math
import re
from collections.abc import Mapping, Sequence
from typing import Any

from fixtures.ball import Ball
from fixtures.hinge import Hinge
from operator_app.config.any_file import schema_line
from operator_app.config.atomic import dump_strict, scalar_text
from operator_app.config.errors import only
from operator_app.config.fixture_file import BallPlacement, HingePlacement
from operator_app.config.resources import Kind, builtin_names, resolve
from operator_app.config.strict_yaml import load_strict
from solver.chain.arm_model import ArmModel

MEASURED_HINGE = """\
{line}
Made by `sarcal new fixture` from two measured lines, for the arm {arm} (its zeros of joints 1 and n are
counted from this hinge: theta_off_1_deg, theta_off_n_deg). Check these assumptions:
- give: how far hinge and mounting yield under load, one standard deviation; 0 is rigid.
- tolerance: how well the lines were measured."""

MEASURED_BALL = """\
{line}
Made by `sarcal new fixture` from two measured points, for the arm {arm}. Check these assumptions:
- give: how far socket and mounting yield under load, one standard deviation; 0 is rigid.
- tolerance: how well the points were measured. stays_on_hand: whether other sockets may be used."""

PROCEDURE = """\
{line}
Made by `sarcal new procedure` for {arm} in {fixture}. Check these:
- bus: interface and channel of your arm. virtual takes the bus of the environment, can.conf or your settings, or
  the simulated arm if they name none; -i virtual is always the simulated arm.
- capture: how many poses, how fast. `sarcal plan` predicts what they determine.
- held: free entries of the arm that stay as its file has them, and why."""

EXPLORED_DEG = 20.0
"""Exploration range of each joint of an open arm, in either direction from home."""
POSES_BY_STRATEGY = {"planned": 12, "explore": 40}
SETTLE = {"window_syncs": 20, "spread_sigmas": 8, "spread_min_deg": 0.002, "timeout_syncs": 1000}
FASTEST_DEG_PER_S = 10.0
SLOW = 0.1
"""Command speed as a share of the slowest joint's maximum speed; at most `FASTEST_DEG_PER_S`."""


def copied(kind: Kind, packaged: str, *, name: str, **instead: str) -> bytes:
    """Return a copy of a built-in file with another name, and with new values of the top-level keys in `instead`.

    Raises ConfigError if there is no built-in file called `packaged`.
    """
    source = resolve(kind, packaged)
    if source.folder is not None:
        remedy = f"built-in: {', '.join(builtin_names(kind))}"
        raise only(source.file, f"is not a built-in {kind}", remedy)
    text = source.data.decode()
    for key, value in {"name": name, **instead}.items():
        # A path may have backslashes, which a template would interpret.
        line = f"{key}: {scalar_text(value)}".replace("\\", r"\\")
        text = re.sub(rf"^{key}: .*$", line, text, count=1, flags=re.MULTILINE)
    head = f"# {schema_line(kind)}\n# A copy of the built-in {packaged}.\n"
    return (head + text).encode()


def fixture_file(fixture: Hinge | Ball, *, name: str, arm: ArmModel) -> bytes:
    """Return the content of the fixture file for a hinge or ball whose placement was measured on this arm."""
    comment = MEASURED_HINGE if isinstance(fixture, Hinge) else MEASURED_BALL
    keys = (HingePlacement if isinstance(fixture, Hinge) else BallPlacement).model_fields
    in_si = {key: key.replace("_mm", "_m").replace("_deg", "_rad") for key in keys}
    # Compliance and check list are not measured: they are taken from the built-in file.
    packaged = load_strict(resolve("fixture", fixture.kind).data, fixture.kind).data
    data: dict[str, Any] = {
        "schema": "sarcal/fixture/1",
        "name": name,
        "kind": fixture.kind,
        "placement": {key: _placed(key, getattr(fixture, name)) for key, name in in_si.items()},
        "tolerance_mm": _millimetres(fixture.tolerance.position_m),
        "tolerance_deg": _degrees(fixture.tolerance.orientation_rad),
        "give": packaged["give"],
        "checklist": packaged["checklist"],
    }
    return dump_strict(data, comment=comment.format(line=schema_line("fixture"), arm=arm.name))


def _placed(key: str, value: Any) -> Any:
    """Convert a length or an angle from SI to the unit at the end of `key`; an offset that is None gives 0."""
    if isinstance(value, tuple):
        return [_placed(key, part) for part in value]
    return _millimetres(value) if key.endswith("_mm") else _degrees(value or 0.0)


def procedure_file(
    *,
    name: str,
    arm: ArmModel,
    arm_reference: str,
    fixture_reference: str,
    held: Mapping[str, str],
    closed: bool,
) -> bytes:
    """Return the content of a procedure file; `closed`: whether the fixture constrains the tool (closed chain)."""
    joints = range(1, arm.joint_count + 1)
    slowest = min(math.degrees(j.max_speed_rad_per_s) for j in arm.joints)
    plan = "planned" if closed else "explore"
    capture: dict[str, Any] = {
        "plan": plan,
        "poses": POSES_BY_STRATEGY[plan],
        **({} if closed else {"exploration": _boxes(arm)}),
        "speed_deg_per_s": round(min(FASTEST_DEG_PER_S, max(0.05, slowest * SLOW)), 3),
        "settle": SETTLE,
        "samples_per_pose": 32,
        "seed": 1,
    }
    data: dict[str, Any] = {
        "schema": "sarcal/procedure/1",
        "name": name,
        "arm": arm_reference,
        "fixture": fixture_reference,
        "bus": {"interface": "virtual"},
        "modes": "auto" if closed else {"position": list(joints)},
        **({"held": dict(held)} if held else {}),
        "capture": capture,
        "estimator": "implicit",
        "acceptance": {"scaled_condition_number": 100},
        "export": {"upload": False},
    }
    line = schema_line("procedure")
    comment = PROCEDURE.format(line=line, arm=arm.name, fixture=fixture_reference)
    return dump_strict(data, comment=comment)


def _boxes(arm: ArmModel) -> Sequence[Mapping[str, Any]]:
    boxes = []
    for k, (joint, home) in enumerate(zip(arm.joints, arm.home_rad.tolist(), strict=True), 1):
        low, high = math.degrees(joint.lower_rad - home), math.degrees(joint.upper_rad - home)
        ends = max(-EXPLORED_DEG, 0.9 * low), min(EXPLORED_DEG, 0.9 * high)
        boxes.append({"joint": k, "from_deg": round(ends[0], 3), "to_deg": round(ends[1], 3)})
    return boxes


def _millimetres(value_m: float) -> float:
    """Convert to mm, rounded to 0.01 mm, which is finer than a mounting can be measured."""
    return round(1e3 * value_m, 2)


def _degrees(value_rad: float) -> float:
    return round(math.degrees(value_rad), 3)
