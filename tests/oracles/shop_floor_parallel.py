"""Hinges mounted almost parallel to joint 1 or joint 7: a closed loop, and a chart of it.

The hand's half is nominal, except for its tilt against joint 7; the table's half follows from a random pose.
"""

from functools import cache

import numpy as np

from tests.oracles.shop_floor_chain import (
    FOLLOW,
    GRID,
    HOME_DEG,
    LOWER_DEG,
    UPPER_DEG,
    Chain,
    Chart,
    Loop,
    chart,
    in_range,
    link_transform,
    nominal_chain,
    rotation_about_z,
)

BOX_DEG = ((-16.0, 16.0), (-16.0, 16.0))
REACHABLE_FRACTION = 0.4
"""Fraction of the box that the arm must reach."""


@cache
def parallel_mount(joint: int, deg: float) -> tuple[Chain, Chart]:
    """Chain whose hinge axis is `deg` from parallel to joint 1 or 7, and its chart."""
    rng = np.random.default_rng([joint, int(10 * deg)])
    hand = nominal_chain()
    if joint == 7:
        hand = hand.changed(alpha_7=np.deg2rad(deg))
    middle = np.deg2rad(HOME_DEG if joint == 7 else 0.5 * (LOWER_DEG + UPPER_DEG))
    for _ in range(400):
        spread = np.deg2rad(8.0 if joint == 7 else 60.0)
        angles = middle + spread * rng.uniform(-1.0, 1.0, 7) + hand.theta_off[1:]
        if joint == 1:
            angles = _tilt_hand(hand, angles, np.deg2rad(deg))
        if angles is None:
            continue
        chain, home = mount_hinge(hand, angles)
        if not in_range((home - chain.theta_off)[None, 1:])[0]:
            continue
        mount_chart = chart(chain, home, BOX_DEG)
        reachable = in_range((mount_chart.angles - chain.theta_off)[:, 1:])
        if reachable.sum() > REACHABLE_FRACTION * GRID**2:
            return chain, Chart(
                place=mount_chart.place[reachable],
                angles=mount_chart.angles[reachable],
                drives=mount_chart.drives,
            )
    raise RuntimeError(f"no mount {deg} deg from joint {joint} was found")


def mount_hinge(hand: Chain, angles: np.ndarray) -> tuple[Chain, np.ndarray]:
    """Put the table's half of the hinge at the hand's half, at true angles (7,): the chain and its angles (8,).

    Joint 1 is counted from the new common normal: its offset changes, its reading does not.
    """
    T = np.eye(4)
    for j in range(1, 8):
        s = 0.0 if j == 1 else hand.s[j]
        T = T @ rotation_about_z(angles[j - 1]) @ link_transform(s, hand.a[j], hand.alpha[j])
    # M = Rz(theta_0) Tz(s_0) Tx(a_0) Rx(alpha_0) Rz(turn) Tz(s_1)
    M = np.linalg.inv(T)
    alpha = np.arccos(np.clip(M[2, 2], -1.0, 1.0))
    theta = np.arctan2(M[0, 2], -M[1, 2])
    turn = np.arctan2(M[2, 0], M[2, 1])
    axes = np.stack(([0.0, 0.0, 1.0], [np.cos(theta), np.sin(theta), 0.0], M[:3, 2]), axis=-1)
    s_0, a_0, s_1 = np.linalg.solve(axes, M[:3, 3])
    chain = hand.changed(
        s_0=s_0, a_0=a_0, alpha_0=alpha, s_1=s_1, theta_off_1=hand.theta_off[1] + turn
    )
    home = np.concatenate(([theta, angles[0] + turn], angles[1:]))
    return chain, Loop(chain=chain).closed(home[None], free=FOLLOW)[0][0]


def _tilt_hand(hand: Chain, angles: np.ndarray, tilt: float) -> np.ndarray | None:
    """Turn joints 2, 4 and 6 until the hand's axis is `tilt` from that of joint 1."""
    angles = angles.copy()

    def cosine(joint_angles):
        R = np.eye(3)
        for j in range(1, 8):
            step = rotation_about_z(joint_angles[j - 1]) @ link_transform(0.0, 0.0, hand.alpha[j])
            R = R @ step[:3, :3]
        return np.array([np.hypot(R[0, 2], R[1, 2]), R[2, 2]])

    for _ in range(60):
        sine, cos = cosine(angles)
        error = np.arctan2(sine, abs(cos)) - tilt
        if abs(error) < 1e-12:
            return angles
        slope = np.zeros(7)
        for j in (1, 3, 5):
            stepped = cosine(angles + 1e-6 * np.eye(7)[j])
            slope[j] = (np.arctan2(stepped[0], abs(stepped[1])) - tilt - error) / 1e-6
        step = -error * slope / max(float(slope @ slope), 1e-12)
        angles += np.clip(step, -0.2, 0.2)
    return None
