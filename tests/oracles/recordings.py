"""Simulated recordings of an arm that stops at given poses, and files of them by independent writers."""

from pathlib import Path

import numpy as np
from rosbags.rosbag2 import StoragePlugin, Writer
from rosbags.typesys import Stores, get_typestore

BEGAN_S = 1_790_000_000.0
NOISE_RAD = 2e-6


def recorded_arm(
    poses_rad: np.ndarray, *, decoys: int, seed: int, rate_hz: float = 50.0
) -> tuple[np.ndarray, np.ndarray]:
    """Times (m,) and angles (m, n): 2 s a pose, fast moves, `decoys` slow motions, jitter, a drop-out every 10 s."""
    rng = np.random.default_rng(seed)
    step = 1.0 / rate_hz
    parts = [np.tile(poses_rad[0], (round(2.0 * rate_hz), 1))]
    slow = set(rng.choice(np.arange(1, len(poses_rad)), decoys, replace=False).tolist())
    for k in range(1, len(poses_rad)):
        position = parts[-1][-1]
        if k in slow:
            # 0.2 to 1 deg/s for 3 s, in one to three joints, without acceleration.
            speed = np.zeros(len(position))
            moving = rng.choice(len(position), rng.integers(1, 4), replace=False)
            speed[moving] = np.deg2rad(rng.uniform(0.2, 1.0, len(moving)))
            parts.append(position + np.outer(np.arange(1, 3.0 * rate_hz + 1) * step, speed))
            position = parts[-1][-1]
        blend = 0.5 - 0.5 * np.cos(np.pi * np.arange(1, round(1.5 * rate_hz)) / (1.5 * rate_hz))
        parts.append(position + np.outer(blend, poses_rad[k] - position))
        parts.append(np.tile(poses_rad[k], (round(2.0 * rate_hz), 1)))
    q = np.concatenate(parts)
    q = q + rng.normal(0.0, NOISE_RAD, q.shape)
    time_s = BEGAN_S + np.arange(len(q)) * step + rng.uniform(-0.3, 0.3, len(q)) * step
    recorded = rng.random(len(q)) > 0.05
    for begin in rng.choice(len(q), round(len(q) * step / 10.0), replace=False):
        recorded[begin : begin + round(0.3 * rate_hz)] = False
    return time_s[recorded], q[recorded]


def write_bag(
    folder: Path,
    time_s: np.ndarray,
    q_rad: np.ndarray,
    names: list[str],
    *,
    storage: str,
    seed: int,
) -> Path:
    """Write a bag with the joints and a gripper in random order in each message; return its file."""
    rng = np.random.default_rng(seed)
    types = get_typestore(Stores.ROS2_HUMBLE)
    state = types.types["sensor_msgs/msg/JointState"]
    header, stamp = types.types["std_msgs/msg/Header"], types.types["builtin_interfaces/msg/Time"]
    none = np.zeros(0)
    with Writer(folder, version=9, storage_plugin=StoragePlugin[storage.upper()]) as bag:
        topic = bag.add_connection("/joint_states", state.__msgtype__, typestore=types)
        other = bag.add_connection("/joint_commands", state.__msgtype__, typestore=types)
        for time, q in zip(time_s, q_rad, strict=True):
            ns = round(time * 1e9)
            head = header(stamp=stamp(sec=ns // 10**9, nanosec=ns % 10**9), frame_id="")
            order = rng.permutation(len(names) + 1)
            all_names, positions = [*names, "finger_joint1"], np.append(q, 0.04)
            message = state(head, [all_names[k] for k in order], positions[order], none, none)
            received_ns = ns + int(rng.integers(0, 5_000_000))
            bag.write(topic, received_ns, types.serialize_cdr(message, state.__msgtype__))
            if rng.random() < 0.1:
                gripper = state(head, ["finger_joint1"], np.array([0.04]), none, none)
                bag.write(topic, received_ns, types.serialize_cdr(gripper, state.__msgtype__))
                bag.write(other, received_ns, types.serialize_cdr(message, state.__msgtype__))
    return next(folder.glob("*.mcap" if storage == "mcap" else "*.db3"))


def write_log(path: Path, time_s: np.ndarray, q_rad: np.ndarray, names: list[str]) -> Path:
    """Write a CSV log with a header and a column of no joint."""
    rows = np.column_stack((time_s - time_s[0], np.zeros(len(time_s)), q_rad))
    head = ",".join(["time", "mode", *names])
    np.savetxt(path, rows, fmt="%.12g", delimiter=",", header=head, comments="")
    return path
