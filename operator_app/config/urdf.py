"""An arm as URDF, written and read: what simulators and motion planners take. Knows no calibration.

A D-H link ``Rz(q + theta_off) Tz(s) Tx(a) Rx(alpha)`` is a revolute joint about z and then a fixed step;
that step is the origin of the next joint, ``xyz = (a cos(off), a sin(off), s)``, ``rpy = (alpha, 0, off)``
in URDF's Rz Ry Rx, so that every joint value is a sensor reading. Reading goes by the joints' axes alone
and works for any serial chain, however its frames were chosen.
"""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable, Mapping
from dataclasses import dataclass

import numpy as np

from operator_app.config.degrees import degrees_for_file
from operator_app.config.text import decode_text, only
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable

BASE, FLANGE = "base_link", "flange"

PARALLEL = 1e-9
"""Sine of the angle below which two axes count as parallel."""
MEET_M = 1e-9
"""Axes closer than this meet."""
NO_LIMIT_RAD = math.pi
"""Either way, of a joint that goes round and round."""

Matrix = FloatArray


def format_urdf(arm: ArmModel, table: DhTable, *, comment: Iterable[str] = ()) -> bytes:
    """Write links 1..n with the geometry of `table`, and ranges, speeds and torques of `arm`.

    Parameters
    ----------
    comment
        Lines for whoever opens the file.
    """
    robot = ET.Element("robot", name=_xml_text(arm.name))
    ET.SubElement(robot, "link", name=BASE)
    origin = {"xyz": "0 0 0", "rpy": "0 0 0"}
    rows = zip(arm.joints, *(column.tolist() for column in table.stacked()), strict=True)
    parent = BASE
    for j, (joint, off, s, a, alpha) in enumerate(rows, 1):
        element = ET.SubElement(robot, "joint", name=f"joint_{j}", type="revolute")
        ET.SubElement(element, "origin", origin)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=f"link_{j}")
        ET.SubElement(element, "axis", xyz="0 0 1")
        limits = {
            "lower": joint.lower_rad,
            "upper": joint.upper_rad,
            "effort": joint.max_torque_nm,
            "velocity": joint.max_speed_rad_per_s,
        }
        ET.SubElement(element, "limit", {key: repr(float(v)) for key, v in limits.items()})
        ET.SubElement(robot, "link", name=f"link_{j}")
        parent = f"link_{j}"
        origin = {
            "xyz": f"{a * math.cos(off)!r} {a * math.sin(off)!r} {s!r}",
            "rpy": f"{alpha!r} 0 {off!r}",
        }
    element = ET.SubElement(robot, "joint", name="flange_fixed", type="fixed")
    ET.SubElement(element, "origin", origin)
    ET.SubElement(element, "parent", link=parent)
    ET.SubElement(element, "child", link=FLANGE)
    ET.SubElement(robot, "link", name=FLANGE)
    ET.indent(robot)
    # Two hyphens would end a comment of XML.
    words = re.sub("-(?=-)", "- ", "\n".join(f"  {_xml_text(line)}" for line in comment))
    head = f"<!--\n{words}\n-->\n" if words else ""
    text = ET.tostring(robot, encoding="unicode")
    return f'<?xml version="1.0" encoding="utf-8"?>\n{head}{text}\n'.encode()


def _xml_text(text: str) -> str:
    """Write out as an escape what no XML may hold: somebody else chose serial numbers and names."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


# ---- reading -----------------------------------------------------------------------------------


@dataclass(frozen=True, slots=True, kw_only=True)
class UrdfJoint:
    """One joint that turns: name, range (rad), speed (rad/s) and torque (Nm); None where not stated."""

    name: str
    lower_rad: float
    upper_rad: float
    velocity_rad_per_s: float | None
    effort_nm: float | None


@dataclass(frozen=True, slots=True, kw_only=True)
class UrdfChain:
    """A serial chain of a URDF in D-H terms.

    Attributes
    ----------
    table
        Rows 1..n.
    T_link_base, T_flange_tip
        Fixed steps that D-H rows cannot hold, (4, 4), m: from the file's base link to frame 0, and from
        frame n to its last link. Identity for a file of ours.
    """

    name: str
    joints: tuple[UrdfJoint, ...]
    table: DhTable
    T_link_base: Matrix
    T_flange_tip: Matrix


@dataclass(frozen=True, slots=True)
class _Step:
    """One joint of the file: where it is on its parent, its axis, None where it does not turn."""

    name: str
    parent: str
    child: str
    T: Matrix
    axis: FloatArray | None
    joint: UrdfJoint | None


def parse_urdf(data: bytes, file: str, *, tip: str = "") -> UrdfChain:
    """Read the chain of revolute joints that ends at the link `tip`; empty: the only end there is.

    Raises
    ------
    ConfigError
        It is no URDF, or its joints are no serial chain of turning ones; says which is not.
    """
    text = decode_text(data, file)
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise only(file, None, None, "declares entities", "a URDF needs none: take them out")
    try:
        robot = ET.fromstring(text)  # noqa: S314 - entities were refused, and there are no others
    except ET.ParseError as error:
        line = error.position[0]
        raise only(file, line, None, f"is not XML: {error}", "is this the URDF?") from error
    if robot.tag != "robot":
        remedy = "give the URDF itself; xacro: `xacro arm.urdf.xacro > arm.urdf` first"
        raise only(file, None, None, f"holds a <{robot.tag}>, not a <robot>", remedy)
    steps = {step.child: step for step in (_step(e, file) for e in robot.findall("joint"))}
    parents = {step.parent for step in steps.values()}
    ends = [child for child in steps if child not in parents]
    if tip and tip not in steps:
        raise only(file, None, None, f"there is no link {tip!r}", f"ends: {', '.join(ends)}")
    if not tip and len(ends) != 1:
        raise only(file, None, None, f"has {len(ends)} ends", f"say which: --tip {'|'.join(ends)}")
    chain: list[_Step] = []
    link = tip or ends[0]
    while link in steps and len(chain) <= len(steps):
        chain.insert(0, steps[link])
        link = steps[link].parent
    if len(chain) > len(steps):
        raise only(file, None, None, "its links go round in a circle", "mend the parents")
    if not any(step.joint for step in chain):
        raise only(file, None, None, "no joint turns on the way to that link", "name another --tip")
    table, T_base, T_tip = _in_dh(chain)
    return UrdfChain(
        name=robot.get("name", "arm"),
        joints=tuple(step.joint for step in chain if step.joint),
        table=table,
        T_link_base=T_base,
        T_flange_tip=T_tip,
    )


def _step(element: ET.Element, file: str) -> _Step:
    name = element.get("name", "")

    def refuse(text: str, remedy: str) -> Exception:
        return only(file, None, None, f"joint {name!r}: {text}", remedy)

    def numbers(of: ET.Element | None, key: str, default: str, count: int) -> FloatArray:
        words = (default if of is None else of.get(key, default)).split()
        try:
            found = np.array([float(word) for word in words])
        except ValueError:
            found = np.array([np.nan])
        if len(found) != count or not np.isfinite(found).all():
            raise refuse(f"{key} is {' '.join(words)!r}", f"write {count} numbers")
        return found

    links = [
        e.get("link", "") if (e := element.find(k)) is not None else "" for k in ("parent", "child")
    ]
    if not all(links):
        raise refuse("has no parent or no child", "name both links")
    origin = element.find("origin")
    T = np.eye(4)
    T[:3, :3] = _rpy(numbers(origin, "rpy", "0 0 0", 3))
    T[:3, 3] = numbers(origin, "xyz", "0 0 0", 3)
    kind = element.get("type", "")
    if kind == "fixed":
        return _Step(name, links[0], links[1], T, None, None)
    if kind not in ("revolute", "continuous"):
        raise refuse(f"is of type {kind!r}", "an arm here has revolute joints only")
    axis = numbers(element.find("axis"), "xyz", "1 0 0", 3)
    if not np.linalg.norm(axis) > 0.0:
        raise refuse("has no axis", "write for example <axis xyz='0 0 1'/>")
    limit = element.find("limit")
    stated = limit if limit is not None else ET.Element("limit")
    low, high = -NO_LIMIT_RAD, NO_LIMIT_RAD
    if kind == "revolute":
        low, high = (float(numbers(stated, key, "0", 1)[0]) for key in ("lower", "upper"))
        if not low < high:
            raise refuse(f"its range goes from {low:g} to {high:g} rad", "state lower and upper")
    speed, effort = (
        float(numbers(stated, key, "0", 1)[0]) or None for key in ("velocity", "effort")
    )
    joint = UrdfJoint(
        name=name, lower_rad=low, upper_rad=high, velocity_rad_per_s=speed, effort_nm=effort
    )
    return _Step(name, links[0], links[1], T, axis / np.linalg.norm(axis), joint)


def _rpy(rpy: FloatArray) -> Matrix:
    """URDF's fixed-axis roll, pitch, yaw: ``Rz(yaw) Ry(pitch) Rx(roll)``."""
    (cr, cp, cy), (sr, sp, sy) = np.cos(rpy), np.sin(rpy)
    return np.array(
        [
            [cy * cp, cy * sp * sr - sy * cr, cy * sp * cr + sy * sr],
            [sy * cp, sy * sp * sr + cy * cr, sy * sp * cr - cy * sr],
            [-sp, cp * sr, cp * cr],
        ]
    )


def _in_dh(chain: list[_Step]) -> tuple[DhTable, Matrix, Matrix]:
    """D-H rows of the chain with all joints at zero, and the fixed steps before and behind them."""
    T, axes, points, hints = np.eye(4), [], [], []
    for step in chain:
        T = T @ step.T
        if step.axis is not None:
            axes.append(T[:3, :3] @ step.axis)
            points.append(T[:3, 3])
            hints.append(T[:3, 0])
    tip = T
    # Frame 0: the file's own base where that stands on the first axis.
    along = float(-points[0] @ axes[0])
    z, origin = axes[0], points[0] + along * axes[0]
    x = _across(z, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    base = _frame(x, z, origin)
    rows: list[tuple[float, float, float, float]] = []
    ends = [
        *zip(axes[1:], points[1:], hints[1:], strict=True),
        (tip[:3, 2], tip[:3, 3], tip[:3, 0]),
    ]
    for next_z, next_point, hint in ends:
        new_x, new_origin = _common_normal(z, origin, next_z, next_point, hint)
        s = float((new_origin - origin) @ z)
        a = float((new_origin - origin) @ new_x)
        rows.append((_angle(x, new_x, z), s, a, _angle(z, next_z, new_x)))
        x, z, origin = new_x, next_z, new_origin
    columns = _clean(np.array(rows).T)
    table = DhTable(theta_off_rad=columns[0], s_m=columns[1], a_m=columns[2], alpha_rad=columns[3])
    return table, base, np.linalg.inv(_frame(x, z, origin)) @ tip


def _common_normal(
    z: FloatArray, origin: FloatArray, next_z: FloatArray, point: FloatArray, hint: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Direction x of the common normal of two axes, and where it meets the second."""
    normal = np.cross(z, next_z)
    if np.linalg.norm(normal) > PARALLEL:
        x = normal / np.linalg.norm(normal)
        # origin + t z + d x = point + u next_z
        step = np.linalg.solve(np.column_stack((z, x, -next_z)), point - origin)
        x = -x if x @ hint < 0.0 else x
        return x, point + step[2] * next_z
    between = point - origin
    between = between - (between @ z) * z
    if np.linalg.norm(between) > MEET_M:
        x = between / np.linalg.norm(between)
        x = -x if x @ hint < 0.0 else x
    else:
        x = _across(z, hint, np.array([1.0, 0.0, 0.0]), np.array([0.0, 1.0, 0.0]))
    return x, point


def _across(z: FloatArray, *wanted: FloatArray) -> FloatArray:
    """Return the first of `wanted` that is not along z, made square to it."""
    for direction in wanted:
        x = direction - (direction @ z) * z
        if np.linalg.norm(x) > 0.1:
            return np.asarray(x / np.linalg.norm(x))
    return np.asarray(np.cross(z, wanted[-1]))


def _frame(x: FloatArray, z: FloatArray, origin: FloatArray) -> Matrix:
    T = np.eye(4)
    T[:3, :3], T[:3, 3] = np.column_stack((x, np.cross(z, x), z)), origin
    return T


def _angle(a: FloatArray, b: FloatArray, about: FloatArray) -> float:
    return float(np.arctan2(np.cross(a, b) @ about, a @ b))


def _clean(columns: FloatArray) -> FloatArray:
    """Take the rounding of sines and cosines out of what is zero."""
    return np.where(np.abs(columns) < 1e-12, 0.0, columns)


def arm_file_of(chain: UrdfChain, *, name: str) -> Mapping[str, object]:
    """Return the content of an arm file: geometry, ranges, speeds, torques as read; sensors assumed."""
    # What geometry brings in rounding beyond these places is nobody's figure.
    degrees = np.rad2deg(chain.table.stacked()[[0, 3]]).round(12)
    lengths = np.stack((chain.table.s_m, chain.table.a_m)).round(13)
    rows = np.column_stack((degrees[0], *lengths, degrees[1])).tolist()
    joints = chain.joints
    ranges = np.array([[j.lower_rad, j.upper_rad] for j in joints])
    speeds = np.array([j.velocity_rad_per_s or ASSUMED_SPEED for j in joints])
    stated = zip(joints, *(degrees_for_file(v).tolist() for v in (ranges, speeds)), strict=True)
    return {
        "schema": "sarcal/arm/1",
        "name": name,
        "dh": [
            {"row": k, "theta_off_deg": off, "s_m": s, "a_m": a, "alpha_deg": alpha}
            for k, (off, s, a, alpha) in enumerate(rows, 1)
        ],
        "joints": [
            {
                "joint": k,
                "name": joint.name,
                "range_deg": range_deg,
                "sensor": {"kind": "encoder", "counts_per_rev": COUNTS_PER_REV},
                "max_speed_deg_per_s": speed_deg,
                "max_torque_nm": joint.effort_nm or ASSUMED_TORQUE_NM,
            }
            for k, (joint, range_deg, speed_deg) in enumerate(stated, 1)
        ],
        "free": [f"theta_off_{k}" for k in range(1, len(joints) + 1)],
        "home_deg": degrees_for_file(ranges.mean(axis=1)).tolist(),
    }


COUNTS_PER_REV = 400_000
ASSUMED_SPEED = math.radians(90.0)
ASSUMED_TORQUE_NM = 50.0
