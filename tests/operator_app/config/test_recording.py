"""ROS 2 bags of both storages, written by the library's writer: joints by name in any order."""

import sys

import numpy as np
import pytest

from operator_app.config.errors import ConfigError
from operator_app.config.recording import is_bag, load_bag
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
