"""Joint states of ROS 2 bags, MCAP and SQLite, by the library `rosbags` of the extra ``[ros]``.

Nothing of ROS needs to be installed. Joints are found by name, message by message: their order may change.
"""

from __future__ import annotations

from collections.abc import Sequence
from pathlib import Path
from typing import Any

import numpy as np

from operator_app.config.errors import ConfigError
from operator_app.config.recording import JointRecording, find_joints, recording_of
from operator_app.config.resources import expanded
from operator_app.config.text import only

FILES = (".mcap", ".db3")
TOPIC = "/joint_states"
JOINT_STATE = "sensor_msgs/msg/JointState"


def is_bag(path: str | Path) -> bool:
    """Whether it is a file of a ROS 2 bag, or the folder of one."""
    where = expanded(path)
    return where.suffix in FILES or (where / "metadata.yaml").is_file()


def load_bag(
    path: str | Path, *, joints: Sequence[str], columns: str = "", topic: str = ""
) -> JointRecording:
    """Read the joint states of a ROS 2 bag: a file (.mcap, .db3) or its folder.

    Parameters
    ----------
    joints
        What the arm calls joints 1 to n.
    columns
        What the bag calls them, in this order; empty: the arm's names, or the one row of numbered names.
    topic
        Of the joint states; empty: ``/joint_states``, or the only one of that type.

    Raises
    ------
    ConfigError
        With what is wrong; also where the extra is not installed.
    """
    file = str(path)
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        text = "is a ROS 2 bag, which needs the extra [ros]"
        raise only(file, None, None, text, "pip install 'sarcal[ros]'") from error
    messages = get_typestore(Stores.ROS2_HUMBLE)
    states: list[tuple[int, int, dict[str, float]]] = []
    where = expanded(path)
    if not where.exists():
        raise only(file, None, None, "there is no such file", "give the path of a bag")
    try:
        with Reader(where) as bag:
            wanted = [c for c in bag.connections if c.msgtype == JOINT_STATE]
            chosen = _topic(sorted({c.topic for c in wanted}), topic, file)
            for connection, log_ns, data in bag.messages(
                connections=[c for c in wanted if c.topic == chosen]
            ):
                found: Any = messages.deserialize_cdr(data, connection.msgtype)
                stamp_ns = found.header.stamp.sec * 10**9 + found.header.stamp.nanosec
                at = dict(zip(found.name, found.position.tolist(), strict=False))
                states.append((stamp_ns, log_ns, at))
    except ConfigError:
        raise
    except Exception as error:
        # A damaged bag fails in any way inside the library.
        text = f"cannot be read as a ROS 2 bag: {str(error) or type(error).__name__}"
        remedy = "record it anew, or repair it (mcap recover, ros2 bag reindex)"
        raise only(file, None, None, text, remedy) from error
    names = sorted({name for _, _, at in states for name in at})
    order = find_joints(names, joints, file=file, columns=columns)
    # A gripper may speak on the same topic, in messages of its own.
    own = [state for state in states if not state[2].keys().isdisjoint(order)]
    stamped = all(stamp_ns for stamp_ns, _, _ in own)
    return recording_of(
        # Doubles hold times since 1970 to 0.24 us.
        np.array([(stamp_ns if stamped else log_ns) / 1e9 for stamp_ns, log_ns, _ in own]),
        np.array([[at.get(name, np.nan) for name in order] for _, _, at in own]),
        joints=order,
        file=file,
        source=f"messages of {chosen}",
    )


def _topic(there: list[str], wanted: str, file: str) -> str:
    if not there:
        text = f"has no topic of type {JOINT_STATE}"
        raise only(file, None, None, text, f"record {TOPIC} (ros2 bag record {TOPIC})")
    if wanted and wanted not in there:
        text = f"--topic: there is no {wanted} of type {JOINT_STATE}"
        raise only(file, None, None, text, f"there is {', '.join(there)}")
    if not wanted and TOPIC not in there and there[1:]:
        text = f"has {len(there)} topics of joint states: {', '.join(there)}"
        raise only(file, None, None, text, f"name one, e.g. --topic {there[0]}")
    return wanted or (TOPIC if TOPIC in there else there[0])
