"""URDFs of serial chains as text, and poses of their links by pinocchio."""

from collections.abc import Sequence
from typing import Any

import numpy as np
import pinocchio as pin

from operator_app.calibration.calibrated_arm import T_base_flange
from operator_app.config.urdf_reading import UrdfChain
from solver.chain.kinematics import DhTable


def words(numbers: Sequence[float] | np.ndarray) -> str:
    return " ".join(repr(float(v)) for v in numbers)


def joint(
    name: str,
    parent: str,
    child: str,
    xyz: str = "0 0 0",
    rpy: str = "0 0 0",
    axis: str = "",
    *,
    kind: str = "revolute",
    ends: tuple[float, float] = (-3, 3),
    effort: float = 9,
    velocity: float = 2,
    more: str = "",
) -> str:
    """One joint, without limits if it has no axis."""
    turns = (
        f'<axis xyz="{axis}"/><limit lower="{ends[0]!r}" upper="{ends[1]!r}" effort="{effort!r}" '
        f'velocity="{velocity!r}"/>'
    )
    return (
        f'<joint name="{name}" type="{kind}"><parent link="{parent}"/><child link="{child}"/>'
        f'<origin xyz="{xyz}" rpy="{rpy}"/>{turns if axis else ""}{more}</joint>'
    )


def robot(*joints: str) -> str:
    links = {word.split('"')[1] for j in joints for word in j.split("link=")[1:]}
    text = "\n".join([*joints, *(f'<link name="{link}"/>' for link in sorted(links))])
    return f'<robot name="arm">{text}</robot>'


def serial_chain(steps: Sequence[tuple[Any, Any, Any]], limits: Sequence[dict[str, Any]]) -> str:
    """A chain from link `base`; a step has xyz (m), rpy (rad) and the joint's axis, that of the flange None."""
    joints, parent = [], "base"
    for k, (xyz, rpy, axis) in enumerate(steps):
        link = "flange" if axis is None else f"link_{k + 1}"
        at = (f"to_{link}", parent, link, words(xyz), words(rpy))
        own = {"kind": "fixed"} if axis is None else {"axis": words(axis), **limits[k]}
        joints.append(joint(*at, **own))
        parent = link
    return robot(*joints)


def tip_error(urdf: bytes, chain: UrdfChain, table: DhTable) -> float:
    """Largest difference of T_base_tip between pinocchio and a D-H table at 200 poses (m, or entries of a rotation)."""
    q = np.random.default_rng(1).uniform(-3.0, 3.0, (200, len(chain.joints)))
    tips = places(urdf, q, chain.tip, base=chain.base, joints=[j.name for j in chain.joints])
    expected = chain.frames[0] @ T_base_flange(table, q) @ chain.T_flange_tip
    return float(np.abs(tips - expected).max())


def places(
    urdf: str | bytes, q_rad: np.ndarray, tip: str, *, base: str = "", joints: Sequence[str] = ()
) -> np.ndarray:
    """Poses (m, 4, 4) of link `tip` in `base` or the root, at angles (m, n) of `joints` or of all joints."""
    model = pin.buildModelFromXML(urdf if isinstance(urdf, str) else urdf.decode())
    data, poses = model.createData(), []
    for angles in q_rad:
        q = pin.neutral(model)
        for name, angle in zip(joints or list(model.names)[1:], angles, strict=True):
            part = model.joints[model.getJointId(name)]
            turned = [angle] if part.nq == 1 else [np.cos(angle), np.sin(angle)]
            q[part.idx_q : part.idx_q + part.nq] = turned
        pin.framesForwardKinematics(model, data, q)
        at = data.oMf[model.getFrameId(tip, pin.FrameType.BODY)]
        if base:
            at = data.oMf[model.getFrameId(base, pin.FrameType.BODY)].inverse() * at
        poses.append(at.homogeneous)
    return np.array(poses)
