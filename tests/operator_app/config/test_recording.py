"""ROS 2 bags of both storages, written by the library's writer: joints by name in any order."""

import sys

import numpy as np
import pytest

from operator_app.config.dwells import find_dwells
from operator_app.config.errors import ConfigError
from operator_app.config.recording import endpoints_at_rest, is_bag, load_bag, load_timed_log
from tests.oracles.panda import panda_readings
from tests.oracles.recordings import recorded_arm, write_bag

PANDA = [f"panda_joint{j}" for j in range(1, 8)]
ARM = [f"joint {j}" for j in range(1, 8)]


@pytest.mark.parametrize("storage", ["mcap", "sqlite3"])
def test_bag_is_read_by_joint_names(tmp_path, storage):
    _, q_rad = panda_readings()
    time_s, q = recorded_arm(q_rad[:4], decoys=2, seed=1)
    file = write_bag(tmp_path / "run", time_s, q, PANDA, storage=storage, seed=2)
    for bag in (file, tmp_path / "run"):
        assert is_bag(bag)
        recording = load_bag(bag, joints=ARM)
        assert recording.joints == tuple(PANDA)
        assert recording.left_out == 0
        np.testing.assert_allclose(recording.time_s, time_s, rtol=0, atol=3e-7)
        np.testing.assert_array_equal(recording.q_rad, q)
    reordered = [PANDA[k] for k in (1, 0, 2, 3, 4, 5, 6)]
    recording = load_bag(file, joints=ARM, columns=",".join(reordered), topic="/joint_commands")
    assert 0 < len(recording.time_s) < len(time_s)
    assert abs(recording.q_rad[0, 0] - q_rad[0, 1]) < 1e-4


def write_tracker_log(path, hidden=()):
    """Two rests of 2 s at 10 Hz with a motion between them, seen by a tracker except at the samples `hidden`."""
    lines = ["time,q1,q2,x_m,y_m,z_m,rx_deg,ry_deg,rz_deg"]
    for k in range(50):
        q = 10.0 if k < 20 else 40.0 if k >= 30 else 10.0 + 3.0 * (k - 20)
        # Rotations about z on both sides of half a turn: their mean is 180 deg.
        turn = 179.0 if k % 2 else -179.0
        seen = f"{q / 10 + 1e-3 * (-1) ** k:.4f},0.5,0.25,0,0,{turn}"
        lines.append(f"{k / 10:.1f},{q},{2 * q},{',,,,,' if k in hidden else seen}")
    path.write_text("\n".join(lines) + "\n")
    return path


def test_endpoints_over_time_are_averaged_at_each_rest(tmp_path):
    log = write_tracker_log(tmp_path / "log.csv", hidden=(4, 5))
    recording = load_timed_log(log, time="time", joints=("a", "b"), unit="deg")
    assert recording.joints == ("q1", "q2")
    dwells, _ = find_dwells(recording.time_s, recording.q_rad)
    endpoint = endpoints_at_rest(recording, dwells)
    np.testing.assert_allclose(endpoint[:, :3], [[1.0, 0.5, 0.25], [4.0, 0.5, 0.25]], atol=2e-4)
    np.testing.assert_allclose(np.abs(endpoint[:, 5]), np.pi, atol=2e-3)
    by_number = load_timed_log(log, time="1", joints=("a", "b"), unit="deg", columns="2-3")
    np.testing.assert_array_equal(by_number.endpoint, recording.endpoint)


@pytest.mark.parametrize(
    ("rows", "fault"),
    [
        ("t,q1,q2,x_m,y_m,z_m\n0,10,20,1,1\n1,10,20,1,1", "the header has 6 cells"),
        ("q1,q2,t\n10,20\n100,20", "the header has 3 cells"),
        ("0,10\n1,10,20\n2,10,20", "1 columns for an arm of 2 joints"),
    ],
)
def test_rows_shorter_than_the_header_or_the_other_rows_are_refused(tmp_path, rows, fault):
    log = tmp_path / "log.csv"
    log.write_text(rows)
    with pytest.raises(ConfigError, match=fault):
        load_timed_log(log, time="t" if "t" in rows else "1", joints=("a", "b"), unit="deg")


def test_rest_without_a_measurement_is_reported(tmp_path):
    log = write_tracker_log(tmp_path / "log.csv", hidden=range(28, 50))
    recording = load_timed_log(log, time="time", joints=("a", "b"), unit="deg")
    dwells, _ = find_dwells(recording.time_s, recording.q_rad)
    with pytest.raises(ConfigError, match="no measured endpoint at rest 2"):
        endpoints_at_rest(recording, dwells)


def test_invalid_bag_or_option_is_one_problem(tmp_path, monkeypatch):
    _, q_rad = panda_readings()
    time_s, q = recorded_arm(q_rad[:2], decoys=0, seed=1)
    file = write_bag(tmp_path / "run", time_s, q, PANDA, storage="mcap", seed=2)
    (tmp_path / "torn.mcap").write_bytes(file.read_bytes()[:5000])
    (tmp_path / "no.db3").write_text("no database")
    for kwargs, message in (
        ({"topic": "/states"}, "/joint_commands, /joint_states"),
        ({"columns": "panda_joint1,q2"}, "there is no joint 'q2'"),
        ({"joints": ARM[:6]}, "cannot be recognised: finger_joint1, panda_joint1"),
    ):
        with pytest.raises(ConfigError, match=message):
            load_bag(file, **{"joints": ARM, **kwargs})
    for name in ("torn.mcap", "no.db3", "none.mcap"):
        with pytest.raises(ConfigError, match=name) as caught:
            load_bag(tmp_path / name, joints=ARM)
        assert ".;" not in str(caught.value)
    monkeypatch.setitem(sys.modules, "rosbags.rosbag2", None)
    with pytest.raises(ConfigError, match=r"sarcal\[ros\]"):
        load_bag(file, joints=ARM)
