"""Arms as their makers' public robot descriptions have them, joint by joint; multiplied out. Tests only.

A line is where a joint is on the link before, xyz (m) and rpy (deg), and its axis; the last is the flange.
Second to the D-H tables that the makers publish, from which the packaged files are.
"""

import numpy as np
from scipy.spatial.transform import Rotation

Z, Y, X, NONE = (0, 0, 1), (0, 1, 0), (1, 0, 0), None


def ur(d1, a2, a3, d4, d5, d6):
    return [
        ((0, 0, d1), (0, 0, 0), Z),
        ((0, 0, 0), (90, 0, 0), Z),
        ((a2, 0, 0), (0, 0, 0), Z),
        ((a3, 0, d4), (0, 0, 0), Z),
        ((0, -d5, 0), (90, 0, 0), Z),
        ((0, d6, 0), (90, 180, 180), Z),
        ((0, 0, 0), (0, 0, 0), NONE),
    ]


def _iiwa(shoulder, elbow):
    return [
        ((0, 0, 0.1475), (0, 0, 0), Z),
        ((0, 0, shoulder - 0.1475), (0, 0, 0), Y),
        ((0, 0, 0.2075), (0, 0, 0), Z),
        ((0, 0, elbow - 0.2075), (0, 0, 0), (0, -1, 0)),
        ((0, 0, 0.2075), (0, 0, 0), Z),
        ((0, 0, 0.1925), (0, 0, 0), Y),
        ((0, 0, 0.091), (0, 0, 0), Z),
        ((0, 0, 0.035), (0, 0, 0), NONE),
    ]


CHAINS = {
    "ur5e": ur(0.1625, -0.425, -0.3922, 0.1333, 0.0997, 0.0996),
    "ur10e": ur(0.1807, -0.6127, -0.57155, 0.17415, 0.11985, 0.11655),
    "kuka_iiwa7": _iiwa(0.34, 0.4),
    "kuka_iiwa14": _iiwa(0.36, 0.42),
    "franka_fr3": [
        ((0, 0, 0.333), (0, 0, 0), Z),
        ((0, 0, 0), (-90, 0, 0), Z),
        ((0, -0.316, 0), (90, 0, 0), Z),
        ((0.0825, 0, 0), (90, 0, 0), Z),
        ((-0.0825, 0.384, 0), (-90, 0, 0), Z),
        ((0, 0, 0), (90, 0, 0), Z),
        ((0.088, 0, 0), (90, 0, 0), Z),
        ((0, 0, 0.107), (0, 0, 0), NONE),
    ],
    "xarm6": [
        ((0, 0, 0.267), (0, 0, 0), Z),
        ((0, 0, 0), (-90, 0, 0), Z),
        ((0.0535, -0.2845, 0), (0, 0, 0), Z),
        ((0.0775, 0.3425, 0), (-90, 0, 0), Z),
        ((0, 0, 0), (90, 0, 0), Z),
        ((0.076, 0.097, 0), (-90, 0, 0), Z),
        ((0, 0, 0), (0, 0, 0), NONE),
    ],
    "xarm7": [
        ((0, 0, 0.267), (0, 0, 0), Z),
        ((0, 0, 0), (-90, 0, 0), Z),
        ((0, -0.293, 0), (90, 0, 0), Z),
        ((0.0525, 0, 0), (90, 0, 0), Z),
        ((0.0775, -0.3425, 0), (90, 0, 0), Z),
        ((0, 0, 0), (90, 0, 0), Z),
        ((0.076, 0.097, 0), (-90, 0, 0), Z),
        ((0, 0, 0), (0, 0, 0), NONE),
    ],
    "kinova_gen3": [
        ((0, 0, 0.15643), (180, 0, 0), Z),
        ((0, 0.005375, -0.12838), (90, 0, 0), Z),
        ((0, -0.21038, -0.006375), (-90, 0, 0), Z),
        ((0, 0.006375, -0.21038), (90, 0, 0), Z),
        ((0, -0.20843, -0.006375), (-90, 0, 0), Z),
        ((0, 0.00017505, -0.10593), (90, 0, 0), Z),
        ((0, -0.10593, -0.00017505), (-90, 0, 0), Z),
        ((0, 0, -0.061525), (180, 0, 0), NONE),
    ],
    "kinova_gen3_lite": [
        ((0, 0, 0.12825), (0, 0, 0), Z),
        ((0, -0.03, 0.115), (90, 0, 0), Z),
        ((0, 0.28, 0), (-180, 0, 0), Z),
        ((0, -0.14, 0.02), (90, 0, 0), Z),
        ((0.0285, 0, 0.105), (0, 90, 0), Z),
        ((-0.105, 0, 0.0285), (0, -90, 0), Z),
        ((0, 0, 0), (0, 0, 0), NONE),
    ],
    "abb_irb120": [
        ((0, 0, 0), (0, 0, 0), Z),
        ((0, 0, 0.29), (0, 0, 0), Y),
        ((0, 0, 0.27), (0, 0, 0), Y),
        ((0, 0, 0.07), (0, 0, 0), X),
        ((0.302, 0, 0), (0, 0, 0), Y),
        ((0.072, 0, 0), (0, 0, 0), X),
        ((0, 0, 0), (0, 90, 0), NONE),
    ],
}
CHAINS["franka_panda"] = CHAINS["franka_fr3"]


def flange(name, q_rad):
    """Place (4, 4) of the flange on the base link at joint angles (n,)."""
    T, angles = np.eye(4), iter(q_rad)
    for xyz, rpy, axis in CHAINS[name]:
        step = np.eye(4)
        step[:3, :3], step[:3, 3] = Rotation.from_euler("xyz", rpy, degrees=True).as_matrix(), xyz
        T = T @ step
        if axis is not None:
            turn = np.eye(4)
            turn[:3, :3] = Rotation.from_rotvec(next(angles) * np.array(axis, float)).as_matrix()
            T = T @ turn
    return T
