"""Data sheet and URDF of the KUKA LBR iiwa 14 R820.

KUKA, "LBR iiwa 7 R800, LBR iiwa 14 R820, Specification": 360, 420 and 400 mm between the axes, 126 mm to the flange
(working envelope), ranges, speeds and torques of the axes (axis data).
"""

import numpy as np

from tests.oracles.makers_chains import CHAINS
from tests.oracles.urdfs import serial_chain

D_M = (0.360, 0.0, 0.420, 0.0, 0.400, 0.0, 0.126)
ALPHA_DEG = (-90.0, 90.0, 90.0, -90.0, -90.0, 90.0, 0.0)
"""Distal D-H: a is zero throughout, every theta is the axis reading."""
RANGE_DEG = (170.0, 120.0, 170.0, 120.0, 170.0, 120.0, 175.0)
SPEED_DEG_PER_S = (85.0, 85.0, 100.0, 75.0, 130.0, 135.0, 135.0)
TORQUE_NM = (320.0, 320.0, 176.0, 176.0, 110.0, 40.0, 40.0)


def urdf(steps: int = 8) -> str:
    """The URDF of the first joints, with the limits of the data sheet; with eight steps also the flange."""
    chain = [(xyz, np.deg2rad(rpy), axis) for xyz, rpy, axis in CHAINS["kuka_iiwa14"][:steps]]
    axis_data = zip(np.deg2rad(RANGE_DEG), np.deg2rad(SPEED_DEG_PER_S), TORQUE_NM, strict=True)
    limits = [
        {"ends": (-float(end), float(end)), "velocity": float(speed), "effort": torque}
        for end, speed, torque in axis_data
    ]
    return serial_chain(chain, limits)
