"""Joint angles over time: CSV logs with times, and joint states of ROS 2 bags (`rosbags`)."""

from collections.abc import Sequence
from contextlib import suppress
from dataclasses import dataclass, replace
from datetime import UTC, datetime
from pathlib import Path
from typing import Any

import numpy as np

from operator_app.config import joint_log
from operator_app.config.csv_table import BadCell
from operator_app.config.dwells import Dwell
from operator_app.config.errors import ConfigError, decode_text, only, shortened
from operator_app.config.measured_endpoints import endpoint_columns, endpoints_of, mean_endpoint
from operator_app.config.poses_file import BAG_SUFFIXES
from operator_app.config.resources import exists, expanded, read_limited
from solver.arrays import FloatArray

RECORDING_LIMIT_BYTES = 1024 * 1024 * 1024
"""Largest size of a recording; a CSV log of seven joints at 1 kHz over an hour has some 500 MB."""

LARGEST_ANGLE_RAD = 20.0 * np.pi
PER_SECOND = ((1e17, 1e9), (1e14, 1e6), (1e11, 1e3), (0.0, 1.0))
"""For ns, us, ms and s: the smallest last time of a recording in this unit, and the number of units in 1 s."""

SINCE_1970_S = 1e8
"""Times from this value on count from 1970; smaller ones count from the start of the recording."""


@dataclass(frozen=True, slots=True, kw_only=True)
class JointRecording:
    """Angles (m, n), rad, of joints 1 to n at rising times (m,), s.

    `joints`: names of these joints in the recording.
    `source`: text that states where the samples are from: the topic of the messages, or the time column of the lines.
    `left_out`: number of samples left out, because the angle of a joint is missing or the time is repeated.
    `endpoint`: measured endpoints (m, 3) or (m, 6), m and rad, nan where the target was not seen; None if not measured.
    """

    file: str
    time_s: FloatArray
    q_rad: FloatArray
    joints: tuple[str, ...]
    source: str
    left_out: int = 0
    endpoint: FloatArray | None = None


def utc_text(time_s: float) -> str:
    """Return a time, s since 1970, as in poses files. A time below `SINCE_1970_S` is no calendar time and gives ""."""
    if time_s < SINCE_1970_S:
        return ""
    return f"{datetime.fromtimestamp(time_s, UTC):%Y-%m-%dT%H:%M:%S.%f}"[:-3] + "Z"


def load_timed_log(
    path: str | Path,
    *,
    time: str,
    joints: Sequence[str],
    unit: joint_log.Unit | None = None,
    columns: str = "",
    instrument: bool = False,
) -> JointRecording:
    """Read a CSV log of angles over time; raises ConfigError if the file is invalid.

    `time`: name or number of the column of times, which are in s (from any start), in ms, us or ns since 1970, or in
    ISO 8601. `joints`: names of joints 1 to n in the arm file. `columns`: names or numbers of these joints' columns; if
    empty, the names `joints` or numbered names. `unit`: unit of the angles; if None, that in the header, or else
    degrees. `instrument`: whether the log must have columns of measured endpoints.
    """
    file = str(path)
    text = decode_text(read_limited(expanded(path), file, limit=RECORDING_LIMIT_BYTES), file)
    lines = joint_log.read_rows(text)
    if len(lines) < 2:
        raise only(file, "has no samples", "it must have a line of time and angles for each sample")
    header = [] if any(map(joint_log.is_number, lines[0][1])) else lines[0][1]
    first, lines = lines[0][0], lines[1:] if header else lines
    width = len(lines[0][1])
    if header and len(header) != width:
        raise joint_log.wrong_header(header, width, file, first)
    by = joint_log.find_column("--time", time, header, width, file)
    measured = endpoint_columns(header, file, first, needed=instrument)
    remaining = [k for k in range(width) if k != by and not (header and header[k] in measured)]
    if header and not columns:
        _find_joints([header[k] for k in remaining], joints, file=file)
    where = joint_log.find_columns(columns, header, remaining, len(joints), lines, file, joints)
    order = tuple(header[k] if header else f"column {k + 1}" for k in where)
    used = unit
    if header and not (columns and unit):
        used = joint_log.unit_of(order, unit, file, first)
    if len(lines[-1][1]) != width:
        # A killed recorder leaves its last line incomplete.
        lines = lines[:-1]
    of_samples = [(k, "", _number) for k in (*where, *map(header.index, measured))]
    table = joint_log.read_numbers(lines, [(by, "", _time_s), *of_samples], file)
    time_s, q = table[:, 0], table[:, 1 : 1 + len(where)]
    if unit is None:
        largest = float(np.max(np.abs(q), initial=0.0, where=np.isfinite(q)))
        joint_log.require_degrees(largest, f"{len(q)} lines", file, stated=used)
    latest = float(np.max(np.abs(time_s), initial=0.0, where=np.isfinite(time_s)))
    per_s = next(per for least, per in PER_SECOND if latest >= least)
    source = f"lines (times: {header[by] if header else f'column {by + 1}'})"
    measurements, numbers = table[:, 1 + len(where) :], [line for line, _ in lines]
    recorded = JointRecording(
        file=file,
        time_s=time_s / per_s,
        q_rad=q if used == "rad" else np.deg2rad(q),
        joints=order,
        source=source,
        endpoint=endpoints_of(measured, measurements, file, numbers) if measured else None,
    )
    return complete_samples(recorded)


def endpoints_at_rest(recording: JointRecording, dwells: Sequence[Dwell]) -> FloatArray | None:
    """Return the mean endpoint, m and rad, of each of k dwells, (k, 3) or (k, 6); None if none was measured.

    Raises ConfigError if the instrument measured nothing in one of the dwells.
    """
    if recording.endpoint is None or not np.isfinite(recording.endpoint).any():
        return None
    means = []
    for k, dwell in enumerate(dwells, 1):
        samples = recording.endpoint[dwell.first : dwell.first + dwell.samples]
        seen = samples[np.all(np.isfinite(samples), axis=1)]
        if not len(seen):
            text = f"has no measured endpoint at rest {k}, {dwell.start_s - recording.time_s[0]:.2f} s after the start"
            raise only(recording.file, text, "measure it there, or remove the lines of that rest")
        means.append(mean_endpoint(seen))
    return np.array(means)


def _time_s(cell: str) -> float:
    """Return a number unchanged, or a time in ISO 8601 (UTC unless it has a zone) as s since 1970; raises BadCell."""
    with suppress(ValueError):
        return float(cell or "nan")
    try:
        time = datetime.fromisoformat(cell)
    except ValueError as error:
        remedy = "write seconds, or a time such as 2026-01-31T12:00:00.250Z"
        raise BadCell(f"{shortened(cell)!r} is not a time", remedy) from error
    return (time if time.tzinfo else time.replace(tzinfo=UTC)).timestamp()


def _number(cell: str) -> float:
    try:
        return float(cell or "nan")
    except ValueError as error:
        raise BadCell(f"{shortened(cell)!r} is not a number", "correct the cell") from error


def complete_samples(recorded: JointRecording) -> JointRecording:
    """Return the complete samples in order of time; of several with the same time, only the first is kept.

    Raises ConfigError if no complete sample remains, or if an angle exceeds `LARGEST_ANGLE_RAD`.
    """
    time_s, q_rad, joints = recorded.time_s, recorded.q_rad, recorded.joints
    complete = np.flatnonzero(np.isfinite(time_s) & np.all(np.isfinite(q_rad), axis=1))
    if not len(complete):
        text = f"no sample has an angle of every joint ({', '.join(joints)})"
        raise only(recorded.file, text, "record all joints at once")
    rising, first = np.unique(time_s[complete], return_index=True)
    kept = complete[first]
    joint = int(np.argmax(np.abs(q_rad[kept]).max(axis=0)))
    if (largest := float(np.abs(q_rad[kept, joint]).max())) > LARGEST_ANGLE_RAD:
        text = f"{joints[joint]} reaches {np.rad2deg(largest):.4g} deg"
        remedy = "degrees where radians belong, or not a revolute joint?"
        raise only(recorded.file, text, remedy)
    return replace(
        recorded,
        time_s=rising,
        q_rad=q_rad[kept],
        left_out=len(time_s) - len(kept),
        endpoint=None if recorded.endpoint is None else recorded.endpoint[kept],
    )


def _find_joints(
    names: Sequence[str], joints: Sequence[str], *, file: str, columns: str = ""
) -> tuple[str, ...]:
    """Return the names of joints 1 to n in a recording, whose columns or joints are `names`.

    The text `columns` lists the n names. If it is empty, the arm file's names `joints` are used. If the recording lacks
    one, the only n names numbered from 0 or 1 are used, such as panda_joint1 to 7. Otherwise raises ConfigError.
    """
    count = len(joints)
    if columns:
        listed = tuple(part.strip() for part in columns.split(","))
        if missing := [name for name in listed if name not in names]:
            text = f"--columns: there is no joint {missing[0]!r}"
            raise only(file, text, f"there is {', '.join(names[:40])}")
        if len(listed) != count or len(set(listed)) != count:
            text = f"--columns names {len(set(listed))} joints of an arm of {count}"
            raise only(file, text, "name one for each joint, in the order of the joints")
        return listed
    if not (order := joint_log.joint_order(names, joints, count)):
        text = f"its columns of joints 1 to {count} cannot be recognised: {', '.join(names[:40])}"
        raise only(file, text, "name them in order: --columns NAME,NAME,...")
    return tuple(names[k] for k in order)


TOPIC = "/joint_states"
JOINT_STATE = "sensor_msgs/msg/JointState"


def is_bag(path: str | Path) -> bool:
    """Whether the path is a file of a ROS 2 bag, or a bag's folder."""
    where = expanded(path)
    try:
        return where.suffix in BAG_SUFFIXES or (where / "metadata.yaml").is_file()
    except OSError:  # e.g. the name is too long; opening the file reports it
        return False


def load_bag(
    path: str | Path, *, joints: Sequence[str], columns: str = "", topic: str = ""
) -> JointRecording:
    """Read the joint states of a ROS 2 bag: a file (.mcap, .db3) or its folder.

    `joints`: names of joints 1 to n in the arm file.
    `columns`: names of these joints in the bag, separated by commas. If empty, the names are `joints`. If the bag lacks
    one of these, the only n names that differ just in a number are used.
    `topic`: topic of the joint states. If empty, ``/joint_states``, or else the only topic of this type.

    Raises ConfigError if the bag cannot be read, or if rosbags is not installed.
    """
    file = str(path)
    try:
        from rosbags.rosbag2 import Reader
        from rosbags.typesys import Stores, get_typestore
    except ImportError as error:
        text = "is a ROS 2 bag, which needs the extra [ros]"
        raise only(file, text, "pip install 'sarcal[ros]'") from error
    messages = get_typestore(Stores.ROS2_HUMBLE)
    states: list[tuple[int, int, dict[str, float]]] = []
    where = expanded(path)
    if not exists(where):
        raise only(file, "there is no such file", "give the path of a bag")
    try:
        with Reader(where) as bag:
            connections = [c for c in bag.connections if c.msgtype == JOINT_STATE]
            chosen = _topic(sorted({c.topic for c in connections}), topic, file)
            connections = [c for c in connections if c.topic == chosen]
            for connection, log_ns, data in bag.messages(connections=connections):
                message: Any = messages.deserialize_cdr(data, connection.msgtype)
                stamp_ns = message.header.stamp.sec * 10**9 + message.header.stamp.nanosec
                at = dict(zip(message.name, message.position.tolist(), strict=False))
                states.append((stamp_ns, log_ns, at))
    except ConfigError:
        raise
    except Exception as error:
        # A damaged bag may raise anything inside the library.
        text = f"cannot be read as a ROS 2 bag: {str(error).rstrip('.') or type(error).__name__}"
        remedy = "record it again, or repair it (mcap recover, ros2 bag reindex)"
        raise only(file, text, remedy) from error
    names = sorted({name for _, _, at in states for name in at})
    order = _find_joints(names, joints, file=file, columns=columns)
    # A gripper may send separate messages on the same topic.
    own = [state for state in states if not state[2].keys().isdisjoint(order)]
    stamped = all(stamp_ns for stamp_ns, _, _ in own)
    # Doubles hold times since 1970 to 0.24 us.
    time_s = np.array([(stamp_ns if stamped else log_ns) / 1e9 for stamp_ns, log_ns, _ in own])
    q_rad = np.array([[at.get(name, np.nan) for name in order] for _, _, at in own])
    source = f"messages of {chosen}"
    recorded = JointRecording(file=file, time_s=time_s, q_rad=q_rad, joints=order, source=source)
    return complete_samples(recorded)


def _topic(topics: list[str], option: str, file: str) -> str:
    if not topics:
        text = f"has no topic of type {JOINT_STATE}"
        raise only(file, text, f"record {TOPIC} (ros2 bag record {TOPIC})")
    if option and option not in topics:
        text = f"--topic: there is no {option} of type {JOINT_STATE}"
        raise only(file, text, f"there is {', '.join(topics)}")
    if not option and TOPIC not in topics and topics[1:]:
        text = f"has {len(topics)} topics of joint states: {', '.join(topics)}"
        raise only(file, text, f"name one, e.g. --topic {topics[0]}")
    return option or (TOPIC if TOPIC in topics else topics[0])
