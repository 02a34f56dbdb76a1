"""The KUKA LBR iiwa 14 R820 by its data sheet, and it and the Panda as pinocchio models. Knows nothing of sarcal.

KUKA, "LBR iiwa 7 R800, LBR iiwa 14 R820, Specification": 360, 420 and 400 mm between the axes and 126 mm to the
flange (working envelope), ranges, speeds and torques of the axes (axis data). Where each joint's frame is on its
link is as the open ROS description (iiwa_description) has it.
"""

import math

import numpy as np

from tests.oracles.panda import A_BEFORE_M, ALPHA_BEFORE_DEG
from tests.oracles.panda import D_M as D_M_OF_PANDA
from tests.oracles.urdfs import joint, places, robot, words

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


def urdf(steps: int = 8) -> str:
    """Its description, or the beginning of it: axes about their own z, limits of the data sheet."""
    joints = []
    for k, (xyz, turns) in enumerate(ORIGINS[:steps], 1):
        at = words(xyz), words([math.pi * t for t in turns])
        if k == 8:
            joints.append(joint("j8", "l7", "flange", *at, kind="fixed"))
            continue
        reach, speed = math.radians(RANGE_DEG[k - 1]), math.radians(SPEED_DEG_PER_S[k - 1])
        limits = {"ends": (-reach, reach), "velocity": speed, "effort": TORQUE_NM[k - 1]}
        joints.append(joint(f"j{k}", f"l{k - 1}", f"l{k}", *at, "0 0 1", **limits))
    return robot(*joints)


def iiwa_hand(q_rad: np.ndarray) -> np.ndarray:
    """Flange in the base, (4, 4), by pinocchio from the description."""
    return places(urdf(), q_rad[None], "flange")[0]


def panda_hand(q_rad: np.ndarray) -> np.ndarray:
    """Flange of the Panda in its base, (4, 4), by pinocchio from the maker's modified D-H table."""
    joints = []
    *to_joints, to_flange = D_M_OF_PANDA
    rows = zip(ALPHA_BEFORE_DEG, A_BEFORE_M, (*to_joints, 0.0), strict=True)
    for k, (alpha_deg, a, d) in enumerate(rows, 1):
        alpha = math.radians(alpha_deg)
        xyz = words((a, -math.sin(alpha) * d, math.cos(alpha) * d))
        joints.append(joint(f"j{k}", f"l{k - 1}", f"l{k}", xyz, words((alpha, 0, 0)), "0 0 1"))
    flange = joint("end", "l7", "flange", words((0, 0, to_flange)), kind="fixed")
    return places(robot(*joints, flange), q_rad[None], "flange")[0]
