"""A master of another language and library, node-canopen, drives the virtual controller over the loopback bus."""

import json
import os
import subprocess
from pathlib import Path

import pytest

from hardware.buses.python_can import BusSettings, open_bus
from hardware.virtual.controller import VirtualController
from tests.oracles.virtual_rig import ARM, TrivialPlant, axes, parse

MASTER = Path(__file__).resolve().parents[1] / "tools" / "node_canopen_master.js"
JOINT, COUNTS = 3, 200
# As the master's own: what the arm does when nobody is heard any more is tested elsewhere.
PATIENCE_S = 5.0

pytestmark = pytest.mark.needs("node")


@pytest.fixture(autouse=True)
def library():
    if subprocess.run(
        ["node", "-e", "require('canopen')"], capture_output=True, check=False
    ).returncode:
        pytest.skip(
            "needs the npm package canopen, version 6.2.1, in a folder that NODE_PATH names"
        )


def test_node_canopen_master_reads_moves_and_stops_arm():
    settings = axes()
    plant = TrivialPlant([axis.scale.counts_per_rad for axis in settings])
    there = [
        round(angle * axis.scale.counts_per_rad)
        for angle, axis in zip(plant.angles_rad, settings, strict=True)
    ]
    channel = f"node-canopen-{os.getpid()}"
    bus = open_bus(BusSettings(interface="loopback", channel=channel))
    with VirtualController(
        bus, plant, axes=settings, arm=ARM, validate=parse, heartbeat_timeout_s=PATIENCE_S
    ) as controller:
        done = subprocess.run(
            ["node", str(MASTER), channel, str(JOINT), str(COUNTS)],
            capture_output=True, text=True, timeout=60, check=False,
        )  # fmt: skip
        assert done.returncode == 0, done.stderr
    bus.shutdown()
    told = json.loads(done.stdout)
    for joint in range(1, 8):
        found = told["identity"][str(joint)]
        # CiA 402, a servo drive; serial numbers of drives follow the arm's.
        assert found["deviceType"] & 0x00FFFFFF == 0x00020192
        assert (found["vendor"], found["product"]) == (0, 1)
        assert found["serial"] == 700 + joint
        assert found["name"].rstrip("\0")
    assert told["identity"]["16"]["product"] == 2
    assert [counts for _, counts, _ in told["first"]] == there
    assert told["token"] == 127
    assert told["blocks"] == "the same"
    # 6041h: ready to switch on, switched on, operation enabled; from one SYNC to the next.
    assert [status & 0x6F for status in told["enabling"]] == [0x21, 0x23, 0x27]
    assert told["mode"] == 8
    _, driven, _ = told["driven"]
    assert driven == pytest.approx(there[JOINT - 1] + COUNTS, abs=COUNTS / 10 + 1)
    assert told["statusword"] & 0x6F == 0x07  # quick stop active
    assert told["afterwards"][1] == pytest.approx(told["stopped"][1], abs=1)
    assert "Object does not exist" in told["refused"]
    assert controller.drives[JOINT - 1].drive.counts == told["afterwards"][1]
