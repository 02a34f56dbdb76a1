"""Data sheet and URDF of the KUKA LBR iiwa 14 R820.

KUKA, "LBR iiwa 7 R800, LBR iiwa 14 R820, Specification": 360, 420 and 400 mm between the axes, 126 mm to the flange
(working envelope), ranges, speeds and torques of the axes (axis data). Joint frames: ROS package iiwa_description.
"""

import math

from tests.oracles.urdfs import joint, robot, words

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
"""xyz (m) and rpy (units of pi) of the seven joints and the flange, from iiwa_description."""


def urdf(steps: int = 8) -> str:
    """The URDF of the first joints: axes about their own z, limits of the data sheet."""
    joints = []
    for k, (xyz, turns) in enumerate(ORIGINS[:steps], 1):
        at = words(xyz), words([math.pi * t for t in turns])
        if k == 8:
            joints.append(joint("j8", "l7", "flange", *at, kind="fixed"))
            continue
        end, speed = math.radians(RANGE_DEG[k - 1]), math.radians(SPEED_DEG_PER_S[k - 1])
        limits = {"ends": (-end, end), "velocity": speed, "effort": TORQUE_NM[k - 1]}
        joints.append(joint(f"j{k}", f"l{k - 1}", f"l{k}", *at, "0 0 1", **limits))
    return robot(*joints)
