"""An arm as URDF, written: what simulators and motion planners take.

A D-H link ``Rz(q + theta_off) Tz(s) Tx(a) Rx(alpha) Ry(beta)`` is a revolute joint about z and then a fixed
step; that step is the origin of the next joint, so that every joint value is a sensor reading.
"""

from __future__ import annotations

import re
import xml.etree.ElementTree as ET
from collections.abc import Iterable

from operator_app.config.urdf_rows import link_transform, origin_words
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.kinematics import DhTable

BASE, FLANGE, TIP = "base_link", "flange", "tip"


def format_urdf(
    arm: ArmModel,
    table: DhTable,
    *,
    T_tip: FloatArray | None = None,
    comment: Iterable[str] = (),
) -> bytes:
    """Write links 1..n with the geometry of `table`, and ranges, speeds and torques of `arm`.

    Joints have the arm's names for them where those are names in a URDF: without spaces, each its own.

    Parameters
    ----------
    T_tip
        Place of the link 'tip' on the last one at a reading of zero, (4, 4), m; None: there is none.
    comment
        Lines for whoever opens the file.
    """
    names = [joint.name for joint in arm.joints]
    if len({re.sub(r"\s", "", name) for name in names} & set(names)) != len(names):
        names = [f"joint_{j}" for j in range(1, len(names) + 1)]
    robot = ET.Element("robot", name=_xml_text(arm.name))
    ET.SubElement(robot, "link", name=BASE)
    origin = {"xyz": "0 0 0", "rpy": "0 0 0"}
    parent = BASE
    for j, (joint, row) in enumerate(zip(arm.joints, table.stacked().T.tolist(), strict=True), 1):
        element = ET.SubElement(robot, "joint", name=_xml_text(names[j - 1]), type="revolute")
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
        origin = origin_words(link_transform(row))
    ends = {FLANGE: origin} | ({} if T_tip is None else {TIP: origin_words(T_tip)})
    for link, place in ends.items():
        element = ET.SubElement(robot, "joint", name=f"{link}_fixed", type="fixed")
        ET.SubElement(element, "origin", place)
        ET.SubElement(element, "parent", link=parent)
        ET.SubElement(element, "child", link=link)
        ET.SubElement(robot, "link", name=link)
    ET.indent(robot)
    text = ET.tostring(robot, encoding="unicode")
    return b'<?xml version="1.0" encoding="utf-8"?>\n' + xml_comment(comment) + f"{text}\n".encode()


def xml_comment(lines: Iterable[str]) -> bytes:
    """Lines as a comment of XML; nothing where there are none."""
    # Two hyphens would end it.
    words = re.sub("-(?=-)", "- ", "\n".join(f"  {_xml_text(line)}" for line in lines))
    return f"<!--\n{words}\n-->\n".encode() if words else b""


def _xml_text(text: str) -> str:
    """Write out as an escape what no XML may hold: somebody else chose serial numbers and names."""
    return "".join(c if c.isprintable() else ascii(c)[1:-1] for c in text)
