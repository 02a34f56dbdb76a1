"""Writes a calibration as URDF: a new file, or new joint origins in the user's URDF or UR file.

A D-H link ``Rz(q + theta_off) Tz(s) Tx(a) Rx(alpha) Ry(beta)`` becomes a revolute joint about z with the value q and
a fixed transform, the origin of the next joint. Since the origins include theta_off, joint values are sensor readings.
"""

import math
import re
import xml.etree.ElementTree as ET
from codecs import BOM_UTF8
from collections.abc import Iterable, Iterator, Mapping, Sequence
from itertools import product
from xml.parsers import expat

import numpy as np

from operator_app.config.errors import decode_text, only
from operator_app.config.urdf_reading import UrdfChain, UrdfTree, parse_urdf
from operator_app.config.urdf_rows import link_transform, origin_words, rpy_of
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry, DhKind, wrap_angle

BASE_LINK, FLANGE, TIP_LINK = "base_link", "flange", "tip"


def format_urdf(
    arm: ArmModel, table: DhTable, *, T_tip: FloatArray | None = None, comment: Iterable[str] = ()
) -> bytes:
    """Return a URDF of links 1..n with the geometry of `table`, and ranges, speeds and torques of `arm`.

    Joints have their names in the arm file if all names are unique and have no spaces, else ``joint_1``, ``joint_2``...
    `T_tip`: pose (4, 4), m, of an additional link ``tip`` in the link of joint n; None: no such link.
    `comment`: lines of a comment in the file.
    """
    names = [joint.name for joint in arm.joints]
    if len({re.sub(r"\s", "", name) for name in names} & set(names)) != len(names):
        names = [f"joint_{j}" for j in range(1, len(names) + 1)]
    robot = ET.Element("robot", name=_xml_text(arm.name))
    ET.SubElement(robot, "link", name=BASE_LINK)
    origin = {"xyz": "0 0 0", "rpy": "0 0 0"}
    parent = BASE_LINK
    for j, (joint, row) in enumerate(zip(arm.joints, table.stacked().T.tolist(), strict=True), 1):
        name = _xml_text(names[j - 1])
        element = _add_joint(robot, name, "revolute", origin, parent, f"link_{j}")
        limits = {
            "lower": joint.lower_rad,
            "upper": joint.upper_rad,
            "effort": joint.max_torque_nm,
            "velocity": joint.max_speed_rad_per_s,
        }
        ET.SubElement(element, "limit", {key: repr(float(v)) for key, v in limits.items()})
        ET.SubElement(robot, "link", name=f"link_{j}")
        parent = f"link_{j}"
        origin = origin_words(link_transform(row))
    ends = {FLANGE: origin} | ({} if T_tip is None else {TIP_LINK: origin_words(T_tip)})
    for link, place in ends.items():
        _add_joint(robot, f"{link}_fixed", "fixed", place, parent, link)
        ET.SubElement(robot, "link", name=link)
    ET.indent(robot)
    text = ET.tostring(robot, encoding="unicode")
    return (
        b'<?xml version="1.0" encoding="utf-8"?>\n' + _xml_comment(comment) + f"{text}\n".encode()
    )


def _add_joint(
    robot: ET.Element, name: str, kind: str, origin: dict[str, str], parent: str, child: str
) -> ET.Element:
    joint = ET.SubElement(robot, "joint", name=name, type=kind)
    ET.SubElement(joint, "origin", origin)
    ET.SubElement(joint, "parent", link=parent)
    ET.SubElement(joint, "child", link=child)
    if kind != "fixed":
        ET.SubElement(joint, "axis", xyz="0 0 1")
    return joint


def _xml_comment(lines: Iterable[str]) -> bytes:
    # Two hyphens would end the comment.
    text = re.sub("-(?=-)", "- ", "\n".join(f"  {_xml_text(line)}" for line in lines))
    return f"<!--\n{text}\n-->\n".encode() if text else b""


def _xml_text(text: str) -> str:
    """Escape unprintable characters in names and serial numbers, since XML does not allow all such characters."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)


SAME = 1e-11
"""Origins nearer to each other than this (m, or entries of a rotation) count as equal."""
OTHER_ARM_M, OTHER_ARM_RAD = 0.05, math.radians(10.0)
"""If a D-H row of a file differs by more than this from that of the arm file, the file describes another arm."""

UR_LINKS = ("shoulder", "upper_arm", "forearm", "wrist_1", "wrist_2", "wrist_3")
UR_KEYS = ("x", "y", "z", "roll", "pitch", "yaw")
"""Keys of each block in UR's kinematics file: the pose of a joint, which turns about z, in the previous link."""


def chain_of(data: bytes, file: str, arm: ArmModel) -> UrdfChain:
    """Return the chain in a file that is most similar to `arm`, the nominal (uncalibrated) arm.

    The file is a URDF, a xacro whose chain has literal numbers, or UR's ``default_kinematics.yaml``. Raises ConfigError
    if the file cannot be read or describes another arm.
    """
    chains = [_ur_chain(data, file)] if _is_yaml(file) else _chains(data, file, arm)
    return _matching(chains, arm, file)


def _is_yaml(file: str) -> bool:
    return file.lower().endswith((".yaml", ".yml"))


def with_calibration(
    data: bytes, file: str, chain: UrdfChain, table: DhTable, comment: Sequence[str]
) -> bytes:
    """Return `data` with a comment added, and with the joint origins of `chain` changed to match `table`."""
    origins = calibrated_origins(chain, table)
    return (_into_yaml if _is_yaml(file) else _into_xml)(data, origins, comment)


def calibrated_origins(chain: UrdfChain, table: DhTable) -> dict[str, FloatArray]:
    """Return the new origin (4, 4), m, of each joint whose origin must change for the chain to match `table`.

    In the file, joint frame j has the pose ``C_j`` in D-H frame j-1 with all joints at zero. The new origins make
    this pose ``Rz(q_j + d_j) C_j`` at reading q_j. Here, d_j is the change of theta_off_j. The meshes also turn by d_j.
    """
    rows, stated = table.stacked().T, chain.table.stacked().T
    turned = [
        link_transform((d, 0.0, 0.0, 0.0, 0.0)) for d in wrap_angle(rows[:, 0] - stated[:, 0])
    ]
    rows[:, 0] = stated[:, 0]
    place, T = chain.frames[0], np.eye(4)
    before: FloatArray = np.eye(4)
    fixed: FloatArray = np.eye(4)
    origins, j = dict[str, FloatArray](), 0
    for step in chain.steps:
        T = T @ step.T
        target = step.T
        if step.joint is None:
            fixed = fixed @ step.T
        else:
            own = _inverse(chain.frames[j]) @ T
            target = _inverse(fixed) @ before @ place @ turned[j] @ own
            before, place, fixed = _inverse(own), link_transform(rows[j]), np.eye(4)
            j += 1
        if step.rounded or np.abs(target - step.T).max() > SAME:
            origins[step.name] = target
    after = before @ place @ chain.T_flange_tip
    if np.abs(after - fixed).max() > SAME and not entries_without_origin(chain):
        last = next(s for s in reversed(chain.steps[:-1]) if s.joint is not None)
        first = chain.steps[chain.steps.index(last) + 1]
        origins[first.name] = after @ _inverse(fixed) @ first.T
    return origins


def entries_without_origin(chain: UrdfChain) -> tuple[str, ...]:
    """Return the D-H entries that no origin can express: s, a, alpha, beta of row n if joint n ends the chain."""
    behind = tuple(f"{kind}_{len(chain.joints)}" for kind in ("s", "a", "alpha", "beta"))
    return behind if chain.steps[-1].joint is not None else ()


def _inverse(T: FloatArray) -> FloatArray:
    return np.asarray(np.linalg.inv(T), dtype=np.float64)


def _chains(data: bytes, file: str, arm: ArmModel) -> Iterator[UrdfChain]:
    """Yield every chain that begins at a link fixed to the arm's base and ends at one fixed to the arm's last link.

    The arm is found by the names of its joints. A file without these names must contain only one arm.
    """
    tree = UrdfTree.read(data, file)
    ends = list(tree.around(arm.joints[0].name, arm.joints[-1].name))
    if not ends:
        joints = tree.chain("", "").joints
        ends = list(tree.around(joints[0].name, joints[-1].name))
    yield from (tree.chain(base, tip) for base, tip in ends)


def _matching(chains: Iterable[UrdfChain], arm: ArmModel, file: str) -> UrdfChain:
    n, candidates = arm.joint_count, list[tuple[float, str, UrdfChain]]()
    for chain in chains:
        if len(chain.joints) != n:
            text = f"has {len(chain.joints)} revolute joints from {chain.base} to {chain.tip}"
            raise only(file, text, f"{arm.name} has {n}: is this its URDF?")
        difference = chain.table.stacked() - arm.table.stacked()
        angles = [kind for kind in DhKind if kind.is_angle]
        difference[angles] = wrap_angle(difference[angles]) / OTHER_ARM_RAD
        difference[[DhKind.S, DhKind.A]] /= OTHER_ARM_M
        kind, row = np.unravel_index(np.argmax(np.abs(difference)), difference.shape)
        entry = DhEntry(DhKind(int(kind)), int(row) + 1)
        candidates.append((float(np.abs(difference).max()), entry.name, chain))
    size, entry_name, nearest = min(candidates, key=lambda item: item[0])
    if size > 1.0:
        text = f"its {entry_name} differs from {arm.name}'s {size:.0f} times more than arms of one model can"
        raise only(file, text, "is this the file that the arm file was made from?")
    return nearest


_TAG = re.compile(rb"""<[^\s>/]+(?:[^>"']|"[^"]*"|'[^']*')*>""")


def _into_xml(data: bytes, origins: Mapping[str, FloatArray], comment: Sequence[str]) -> bytes:
    cuts, open_tags, joint = list[tuple[int, int, bytes]](), list[str](), ""
    parser = expat.ParserCreate()

    def start(tag: str, attributes: dict[str, str]) -> None:
        nonlocal joint
        at = parser.CurrentByteIndex
        match = _TAG.match(data, at)
        if match is None:
            raise ValueError(f"there is no tag at byte {at}")
        if not open_tags:
            cuts.append((at, at, _xml_comment(comment)))
        if tag == "joint" and "type" in attributes and attributes.get("name") in origins:
            joint = attributes["name"]
            attribute = origin_words(origins[joint])
            added = f'<origin xyz="{attribute["xyz"]}" rpy="{attribute["rpy"]}"/>'.encode()
            cuts.append((match.end(), match.end(), added))
        elif tag == "origin" and joint and open_tags[-1] == "joint" and cuts[-1][0] == cuts[-1][1]:
            # The joint has an origin: change it instead of adding one.
            cuts[-1] = (at, match.end(), _changed_tag(match[0], origins[joint]))
        open_tags.append(tag)

    def end(tag: str) -> None:
        nonlocal joint
        open_tags.pop()
        joint = "" if tag == "joint" else joint

    parser.StartElementHandler, parser.EndElementHandler = start, end
    parser.Parse(data, True)
    return _replaced(data, cuts)


def _changed_tag(tag: bytes, T: FloatArray) -> bytes:
    for key, value in origin_words(T).items():
        word = f'{key}="{value}"'.encode()
        tag, count = re.subn(rb"\b" + key.encode() + rb"""\s*=\s*("[^"]*"|'[^']*')""", word, tag)
        if not count:
            tag = re.sub(rb"\s*/?>$", lambda m, w=word: b" " + w + m[0], tag)  # type: ignore[misc]
    return tag


def _replaced(data: bytes, cuts: Sequence[tuple[int, int, bytes]]) -> bytes:
    parts, at = list[bytes](), 0
    for start, stop, new in sorted(cuts, key=lambda cut: cut[0]):
        parts += [data[at:start], new]
        at = stop
    return b"".join([*parts, data[at:]])


def _ur_lines(data: bytes, file: str) -> Iterator[tuple[str, str, re.Match[bytes], int]]:
    """Yield each value in UR's kinematics file: link, key, regex match in the line, and byte offset of the line."""
    decode_text(data, file)
    link, at = "", 0
    for line in data.splitlines(keepends=True):
        if (head := re.match(rb"\s+(\w+):\s*(#.*)?$", line.rstrip())) is not None:
            link = head[1].decode()
        value = re.match(rb"\s+(x|y|z|roll|pitch|yaw):\s*([-+.\w]+)", line)
        if value is not None and link in UR_LINKS:
            yield link, value[1].decode(), value, at
        at += len(line)


def _ur_chain(data: bytes, file: str) -> UrdfChain:
    """Return the chain of the six joints in UR's kinematics file; its tip is the last link, wrist_3."""
    values: dict[tuple[str, str], str] = {}
    for link, key, value, _ in _ur_lines(data, file):
        values[link, key] = value[2].decode()
    for link, key in product(UR_LINKS, UR_KEYS):
        if (link, key) not in values:
            remedy = f"write {', '.join(UR_KEYS)} below every link, a number on a line of its own"
            raise only(file, f"{link} has no {key}", remedy)
    robot = ET.Element("robot", name="ur")
    for link, parent in zip(UR_LINKS, ("base", *UR_LINKS), strict=False):
        xyz, rpy = (
            " ".join(values[link, key] for key in keys) for keys in (UR_KEYS[:3], UR_KEYS[3:])
        )
        _add_joint(robot, link, "continuous", {"xyz": xyz, "rpy": rpy}, parent, link)
    return parse_urdf(ET.tostring(robot), file)


def _into_yaml(data: bytes, origins: Mapping[str, FloatArray], comment: Sequence[str]) -> bytes:
    head = "".join(f"# {line}\n" for line in comment)
    begin = len(BOM_UTF8) if data.startswith(BOM_UTF8) else 0
    cuts = [(begin, begin, head.encode())]
    for link, key, value, at in _ur_lines(data, ""):
        if link in origins:
            T = origins[link]
            new = float((*T[:3, 3], *rpy_of(T[:3, :3]))[UR_KEYS.index(key)])
            cuts.append((at + value.start(2), at + value.end(2), repr(new).encode()))
    return _replaced(data, cuts)
