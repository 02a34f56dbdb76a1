"""The KUKA LBR iiwa 14 R820 by its data sheet, and it and the Panda as pinocchio models. Knows nothing of sarcal.

KUKA, "LBR iiwa 7 R800, LBR iiwa 14 R820, Specification": 360, 420 and 400 mm between the axes and 126 mm to the
flange (working envelope), ranges, speeds and torques of the axes (axis data). Where each joint's frame is on its
link is as the open ROS description (iiwa_description) has it.
"""

import math

import numpy as np
import pinocchio as pin

D_M = (0.360, 0.0, 0.420, 0.0, 0.400, 0.0, 0.126)
ALPHA_DEG = (-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0)
"""Distal D-H: a is zero throughout, every theta is the axis reading."""
RANGE_DEG = (170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0)
SPEED_DEG_PER_S = (85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0)
TORQUE_NM = (320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0)

ORIGINS = (
    ((0, 0, 0.1575), (0, 0, 0)),
    ((0, 0, 0.2025), (0.5, 0, 1)),
    ((0, 0.2045, 0), (0.5, 0, 1)),
    ((0, 0, 0.2155), (0.5, 0, 0)),
    ((0, 0.1845, 0), (-0.5, 1, 0)),
    ((0, 0, 0.2155), (0.5, 0, 0)),
    ((0, 0.081, 0), (-0.5, 1, 0)),
    ((0, 0, 0.045), (0, 0, 0)),
)
"""xyz (m) and rpy (half turns: of pi) of the seven joints and the flange, as the maker's description has them."""


def urdf() -> str:
    """Its description: axes about their own z, limits of the data sheet."""
    parts = ['<robot name="lbr_iiwa14_r820"><link name="base"/>']
    parent = "base"
    for k, (xyz, turns) in enumerate(ORIGINS, 1):
        child = f"l{k}" if k < 8 else "flange"
        rpy = " ".join(repr(math.pi * t) for t in turns)
        kind, limit = "fixed", ""
        if k < 8:
            kind, reach = "revolute", math.radians(RANGE_DEG[k - 1])
            speed, torque = math.radians(SPEED_DEG_PER_S[k - 1]), TORQUE_NM[k - 1]
            limit = (
                f'<axis xyz="0 0 1"/><limit lower="{-reach!r}" upper="{reach!r}" '
                f'velocity="{speed!r}" effort="{torque!r}"/>'
            )
        parts.append(
            f'<link name="{child}"/><joint name="j{k}" type="{kind}"><parent link="{parent}"/>'
            f'<child link="{child}"/><origin xyz="{" ".join(map(str, xyz))}" rpy="{rpy}"/>{limit}</joint>'
        )
        parent = child
    return "".join([*parts, "</robot>"])


def iiwa_hand(q_rad: np.ndarray) -> np.ndarray:
    """Flange in the base, (4, 4), by pinocchio from the description."""
    model = pin.buildModelFromXML(urdf())
    return _placed(model, q_rad, model.getFrameId("flange"))


def panda_hand(q_rad: np.ndarray) -> np.ndarray:
    """Flange of the Panda in its base, (4, 4), by pinocchio from the maker's modified D-H table."""
    model, parent = pin.Model(), 0
    steps = (
        (0.0, 0.0, 0.333), (-90.0, 0.0, 0.0), (90.0, 0.0, 0.316), (90.0, 0.0825, 0.0),
        (-90.0, -0.0825, 0.384), (90.0, 0.0, 0.0), (90.0, 0.088, 0.0),
    )  # fmt: skip
    for k, (alpha, a, d) in enumerate(steps, 1):
        turn = pin.utils.rotate("x", math.radians(alpha))
        place = pin.SE3(turn, np.array([a, 0.0, 0.0]) + turn @ [0.0, 0.0, d])
        parent = model.addJoint(parent, pin.JointModelRZ(), place, f"j{k}")
    flange = pin.SE3(np.eye(3), np.array([0.0, 0.0, 0.107]))
    frame = model.addFrame(pin.Frame("flange", parent, flange, pin.FrameType.OP_FRAME))
    return _placed(model, q_rad, frame)


def _placed(model: pin.Model, q_rad: np.ndarray, frame: int) -> np.ndarray:
    data = model.createData()
    pin.framesForwardKinematics(model, data, q_rad)
    return data.oMf[frame].homogeneous.copy()
