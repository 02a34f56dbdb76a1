"""Reads the chain between two links of a URDF as D-H rows."""

from __future__ import annotations

import math
import re
import xml.etree.ElementTree as ET
from collections import Counter
from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass
from itertools import product

import numpy as np

from operator_app.config.errors import decode_text, only
from operator_app.config.quantities import degrees_for_file
from operator_app.config.urdf_rows import AxisLine, exact_deg, rotation_of_rpy, rows_of
from operator_app.units import plural
from solver.arrays import FloatArray
from solver.chain.kinematics import DhTable

NO_REVOLUTE = "no revolute joint is on the path to that link"
ONLY_REVOLUTE = "only revolute joints are supported: exclude others with --base and --tip"

NO_LIMIT_RAD = math.pi
"""Range of a continuous joint, in either direction."""
PLACEHOLDER_ANGLE_RAD, PLACEHOLDER_RAD_PER_S = math.radians(3600.0), math.radians(3600.0)
PLACEHOLDER_NM = 1e5
"""Limits above these, such as 1e6 rad, and speeds and torques of 0 or less are placeholders: they count as missing."""
TURNING = ("revolute", "continuous")
GRIPPER = re.compile(r"finger|grip|jaw|knuckle|thumb", re.IGNORECASE)
"""Names of joints of a gripper, not of the arm."""
FLANGES = ("tool0", "flange")
"""Preferred last links of the arm (REP 199), if all possible last links have the same number of revolute joints."""
ENDS_SHOWN = 12
REPORTED_RAD = 1e-8
"""A rounded angle is reported if it differs from the exact angle by more than this."""


@dataclass(frozen=True, slots=True, kw_only=True)
class UrdfJoint:
    """One revolute joint: axis (3,), range (rad), speed (rad/s), torque (N m); the last two are None if not stated.

    `unstated`: a text for each limit that is missing from the file, or is a placeholder such as 1e6 rad.
    """

    name: str
    axis: FloatArray
    lower_rad: float
    upper_rad: float
    velocity_rad_per_s: float | None
    effort_nm: float | None
    unstated: tuple[str, ...]


@dataclass(frozen=True, slots=True, kw_only=True)
class UrdfStep:
    """One joint element of a URDF. `T`: pose (4, 4), m, in the parent link. `joint`: None for a fixed joint.

    `rounded` maps the text of each angle that the file rounds by more than `REPORTED_RAD` to the exact value, deg.
    """

    name: str
    T: FloatArray
    joint: UrdfJoint | None
    rounded: Mapping[str, float]


@dataclass(frozen=True, slots=True, kw_only=True)
class UrdfChain:
    """The serial chain between the links `base` and `tip` of a URDF, and its D-H rows.

    Attributes
    ----------
    steps
        All joints between `base` and `tip`, including fixed ones.
    table
        D-H rows 1..n.
    frames
        D-H frames 0..n with all joints at zero, in the base link's frame, (4, 4), m.
    T_flange_tip
        Fixed transform from frame n to the tip, (4, 4), m. The D-H rows contain neither this transform nor the pose of
        frame 0. In a URDF written by this program, this transform and the pose of frame 0 are the identity.
    """

    name: str
    base: str
    tip: str
    steps: tuple[UrdfStep, ...]
    joints: tuple[UrdfJoint, ...]
    table: DhTable
    frames: tuple[FloatArray, ...]
    T_flange_tip: FloatArray

    @property
    def unstated(self) -> list[str]:
        """A text for each joint that has a missing limit, or a placeholder such as 1e6 rad instead of a limit."""
        return [f"{j.name}: {', '.join(j.unstated)}" for j in self.joints if j.unstated]

    @property
    def rounded(self) -> dict[str, float]:
        """Exact value, deg, of each angle that the file rounds by more than `REPORTED_RAD`, by its text in the file."""
        return {word: deg for step in self.steps for word, deg in step.rounded.items()}


def parse_urdf(data: bytes, file: str, *, base: str = "", tip: str = "") -> UrdfChain:
    """Read the chain of revolute joints between the links `base` and `tip`; the rest of the file is ignored.

    An empty `base` means the file's root link; an empty `tip`, the end of the only arm, without its gripper. Raises
    ConfigError if the file is not a URDF, or has no serial chain of revolute joints between the two links.
    """
    return UrdfTree.read(data, file).chain(base, tip)


@dataclass(frozen=True, slots=True, kw_only=True)
class UrdfTree:
    """The joints of a URDF, by child link."""

    name: str
    file: str
    elements: Mapping[str, ET.Element]

    @classmethod
    def read(cls, data: bytes, file: str) -> UrdfTree:
        """Read a file; raises ConfigError if it is not a URDF or has no joint."""
        robot = _robot(data, file)
        # Simulators nest joints of their own in other elements.
        joints = [e for e in robot.iterfind("joint") if e.get("type")]
        if not joints:
            raise only(file, "has no joint", "is it a xacro or a part of a URDF?")
        elements: dict[str, ET.Element] = {}
        for element in joints:
            link = _links(element)[1]
            if link in elements:
                both = f"{elements[link].get('name')!r} and {element.get('name')!r}"
                text = f"link {link!r} is the child of two joints, {both}"
                raise only(file, text, "a link has one parent: remove one joint")
            elements[link] = element
        return cls(name=robot.get("name", "arm"), file=file, elements=elements)

    def chain(self, base: str, tip: str) -> UrdfChain:
        """Return the chain between two links; for empty names and errors, see `parse_urdf`."""
        file, elements = self.file, self.elements
        links = {*elements, *(_links(e)[0] for e in elements.values())}
        for option, name in (("base", base), ("tip", tip)):
            if name and name not in links:
                remedy = f"links for --{option}: {_first_names(sorted(links))}"
                raise only(file, f"there is no link {name!r}", remedy)
        tip = tip or _only_end(elements, base, file)
        path = _joints_to(tip, elements, file)
        before = [_links(e)[0] for e in path]
        if base and base not in before:
            remedy = f"links on that path: {_first_names(before)}"
            raise only(file, f"link {base!r} is not on the path to {tip!r}", remedy)
        first = before.index(base) if base else 0
        named = Counter(e.get("name", "") for e in path[first:])
        if twice := [name for name, count in named.items() if count > 1]:
            text = f"has several joints named {twice[0]!r} on the path to {tip!r}"
            raise only(file, text, "give every joint a unique name")
        steps = tuple(_step(e, file) for e in path[first:])
        joints = tuple(step.joint for step in steps if step.joint)
        if not joints:
            raise only(file, NO_REVOLUTE, "choose another --tip")
        T, axes = np.eye(4), []
        for step in steps:
            T = T @ step.T
            if step.joint:
                axes.append(AxisLine(z=T[:3, :3] @ step.joint.axis, point_m=T[:3, 3], x=T[:3, 0]))
        table, frames = rows_of(axes, T)
        return UrdfChain(
            name=self.name,
            base=before[first],
            tip=tip,
            steps=steps,
            joints=joints,
            table=table,
            frames=frames,
            T_flange_tip=np.linalg.inv(frames[-1]) @ T,
        )

    def around(self, first: str, last: str) -> Iterator[tuple[str, str]]:
        """Yield all pairs of a link fixed to the parent link of joint `first` and one fixed to the child of `last`."""
        named = {e.get("name", ""): e for e in self.elements.values()}
        if first not in named or last not in named:
            return
        bases, tips = [_links(named[first])[0]], [_links(named[last])[1]]
        while (up := self.elements.get(bases[-1])) is not None and up.get("type") == "fixed":
            bases.append(_links(up)[0])
        for link in tips:
            fixed = (e for e in self.elements.values() if e.get("type") == "fixed")
            tips += [_links(e)[1] for e in fixed if _links(e)[0] == link]
        yield from product(bases, tips)


def _robot(data: bytes, file: str) -> ET.Element:
    text = decode_text(data, file)
    if re.search(r"<!\s*(DOCTYPE|ENTITY)", text, re.IGNORECASE):
        raise only(file, "declares entities", "a URDF needs none: remove them")
    try:
        robot = ET.fromstring(text)  # noqa: S314 - entities were refused, and there are no others
    except ET.ParseError as error:
        line = error.position[0]
        raise only(file, f"is not XML: {error}", "is this the URDF?", line=line) from error
    if robot.tag != "robot":
        remedy = "give the URDF itself; expand a xacro first: `xacro arm.urdf.xacro > arm.urdf`"
        raise only(file, f"contains a <{robot.tag}>, not a <robot>", remedy)
    return robot


def _links(element: ET.Element) -> tuple[str, str]:
    """Return the parent link and the child link of a joint; a link that the file does not name is empty."""
    ends = (element.find(key) for key in ("parent", "child"))
    parent, child = ("" if e is None else e.get("link", "") for e in ends)
    return parent, child


def _joints_to(link: str, elements: Mapping[str, ET.Element], file: str) -> list[ET.Element]:
    path: list[ET.Element] = []
    while link in elements:
        if len(path) > len(elements):
            raise only(file, "its links form a cycle", "mend the parents")
        path.insert(0, elements[link])
        link = _links(elements[link])[0]
    return path


def _only_end(elements: Mapping[str, ET.Element], base: str, file: str) -> str:
    """Return the last link of the arm, without its gripper; raises ConfigError unless there is exactly one arm."""
    parents = {_links(e)[0] for e in elements.values()}
    leaves = [child for child in elements if child not in parents]
    # A cycle has no end; `_joints_to` reports the cycle from any of its links.
    ends = dict[str, int]()
    for leaf in leaves or list(elements):
        path = _joints_to(leaf, elements, file)
        start = next((k for k, e in enumerate(path) if _links(e)[0] == base), None if base else 0)
        if start is None:
            continue
        count, end = 0, leaf
        for k, e in enumerate(path[start:], start + 1):
            if count and _begins_a_gripper(e, path[k:]):
                end = _links(e)[0]
                break
            count += e.get("type") in TURNING
        if count:
            ends[end] = count
    inner = {_links(e)[0] for end in ends for e in _joints_to(end, elements, file)}
    ends = {end: count for end, count in ends.items() if end not in inner}
    usual = [end for end in FLANGES if end in ends and len(set(ends.values())) == 1]
    if len(ends) == 1 or usual:
        return (usual or list(ends))[0]
    if not ends:
        raise only(file, NO_REVOLUTE, "choose another --tip")
    most = sorted(ends, key=lambda end: -ends[end])
    names = _first_names([f"{end} ({plural(ends[end], 'revolute joint')})" for end in most])
    raise only(file, f"has {len(ends)} ends", f"choose with --tip: {names}")


def _begins_a_gripper(element: ET.Element, later: Sequence[ET.Element]) -> bool:
    """Whether a joint has a gripper's name, or is prismatic or a mimic with no arm joint among the `later` joints."""
    if _has_gripper_name(element):
        return True
    if element.get("type") != "prismatic" and element.find("mimic") is None:
        return False
    return all(
        e.get("type") not in TURNING or e.find("mimic") is not None or _has_gripper_name(e)
        for e in later
    )


def _has_gripper_name(element: ET.Element) -> bool:
    return GRIPPER.search(element.get("name", "")) is not None


def _first_names(names: Sequence[str]) -> str:
    more = f" and {len(names) - ENDS_SHOWN} more" if len(names) > ENDS_SHOWN else ""
    return ", ".join(names[:ENDS_SHOWN]) + more


def _step(element: ET.Element, file: str) -> UrdfStep:
    name = element.get("name", "")

    def refuse(text: str, remedy: str) -> Exception:
        return only(file, f"joint {name!r}: {text}", remedy)

    def words(of: ET.Element | None, key: str, default: str, count: int) -> list[str]:
        written = (default if of is None else of.get(key, default)).split()
        try:
            good = len(written) == count and all(math.isfinite(float(word)) for word in written)
        except ValueError:
            good = False
        if not good:
            shown = " ".join(written)
            remedy = "expand it with xacro first" if "$" in shown else f"write {count} numbers"
            raise refuse(f"{key} is {shown!r}", remedy)
        return written

    def numbers(of: ET.Element | None, key: str, default: str, count: int) -> FloatArray:
        return np.array([float(word) for word in words(of, key, default, count)])

    if not all(_links(element)):
        raise refuse("has no parent or no child", "name both links")
    origin = element.find("origin")
    turns = words(origin, "rpy", "0 0 0", 3)
    exact = {word: deg for word in turns if (deg := exact_deg(word)) is not None}
    rpy = [math.radians(exact[w]) if w in exact else float(w) for w in turns]
    rounded = {w: d for w, d in exact.items() if abs(float(w) - math.radians(d)) > REPORTED_RAD}
    T = np.eye(4)
    T[:3, :3] = rotation_of_rpy(np.array(rpy))
    T[:3, 3] = numbers(origin, "xyz", "0 0 0", 3)
    kind = element.get("type", "")
    joint = None
    if kind in TURNING:
        if (mimic := element.find("mimic")) is not None:
            remedy = f"{ONLY_REVOLUTE}; if it has a sensor of its own, remove <mimic>"
            raise refuse(f"moves with joint {mimic.get('joint', '')!r} (<mimic>)", remedy)
        axis = numbers(element.find("axis"), "xyz", "1 0 0", 3)
        if not np.linalg.norm(axis) > 0.0:
            raise refuse("has no axis", "write for example <axis xyz='0 0 1'/>")
        stated = next(element.iterfind("limit"), ET.Element("limit"))
        low, high, unstated = -NO_LIMIT_RAD, NO_LIMIT_RAD, ["no range"]
        if kind == "revolute":
            low, high = (float(numbers(stated, key, "0", 1)[0]) for key in ("lower", "upper"))
            unstated = []
            if not low < high:
                shown = f"lower is {low:g} rad and upper is {high:g} rad"
                raise refuse(shown, "state lower and upper, lower below upper")
        speed, effort = (float(numbers(stated, k, "0", 1)[0]) for k in ("velocity", "effort"))
        joint = _joint(name, axis / np.linalg.norm(axis), low, high, speed, effort, unstated)
    elif kind != "fixed":
        raise refuse(f"is of type {kind!r}", ONLY_REVOLUTE)
    return UrdfStep(name=name, T=T, joint=joint, rounded=rounded)


def _joint(
    name: str, axis: FloatArray, low: float, high: float, speed: float, effort: float,
    unstated: list[str],
) -> UrdfJoint:  # fmt: skip
    """Return a joint. A missing or placeholder limit becomes None or `NO_LIMIT_RAD`; `unstated` gets a text on it."""
    if max(-low, high) > PLACEHOLDER_ANGLE_RAD:
        unstated.append(f"range of {low:g} to {high:g} rad")
    if not 0.0 < speed <= PLACEHOLDER_RAD_PER_S:
        unstated.append(f"velocity of {speed:g} rad/s" if speed > 0.0 else "no velocity")
    if not 0.0 < effort <= PLACEHOLDER_NM:
        unstated.append(f"effort of {effort:g} N m" if effort > 0.0 else "no effort")
    return UrdfJoint(
        name=name,
        axis=axis,
        lower_rad=low if -low <= PLACEHOLDER_ANGLE_RAD else -NO_LIMIT_RAD,
        upper_rad=high if high <= PLACEHOLDER_ANGLE_RAD else NO_LIMIT_RAD,
        velocity_rad_per_s=speed if 0.0 < speed <= PLACEHOLDER_RAD_PER_S else None,
        effort_nm=effort if 0.0 < effort <= PLACEHOLDER_NM else None,
        unstated=tuple(unstated),
    )


def arm_file_of(chain: UrdfChain, *, name: str) -> Mapping[str, object]:
    """Return the content of an arm file: geometry and limits as read, and assumed sensors."""
    joints = chain.joints
    ranges = np.array([[j.lower_rad, j.upper_rad] for j in joints])
    speeds = np.array([j.velocity_rad_per_s or ASSUMED_SPEED for j in joints])
    stated = zip(joints, *(degrees_for_file(v).tolist() for v in (ranges, speeds)), strict=True)
    table, rows = chain.table.stacked(), list[dict[str, float]]()
    # Further decimal places are rounding errors of the geometry.
    columns = (*table[1:3].round(13), *np.rad2deg(table[[0, 3, 4]]).round(12))
    for k, (s, a, theta_off, alpha, beta) in enumerate(np.column_stack(columns).tolist(), 1):
        row = {"row": k, "theta_off_deg": theta_off, "s_m": s, "a_m": a, "alpha_deg": alpha}
        rows.append(row | ({"beta_deg": beta} if beta else {}))
    return {
        "schema": "sarcal/arm/1",
        "name": name,
        "dh": rows,
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
        "offset_tolerance_deg": ASSUMED_OFFSET_DEG,
        "free": [f"theta_off_{k}" for k in range(1, len(joints) + 1)],
        "home_deg": degrees_for_file(ranges.mean(axis=1)).tolist(),
    }


COUNTS_PER_REV = 400_000
ASSUMED_SPEED = math.radians(90.0)
ASSUMED_TORQUE_NM = 50.0
ASSUMED_OFFSET_DEG = 5.0
