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
HEARTBEAT_TIMEOUT_S = 5.0  # as in the master

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
    initial_counts = [round(a * s) for a, s in zip(plant.angles_rad, plant.scales, strict=True)]
    channel = f"node-canopen-{os.getpid()}"
    bus = open_bus(BusSettings(interface="loopback", channel=channel))
    with VirtualController(
        bus, plant, axes=settings, arm=ARM, validate=parse, heartbeat_timeout_s=HEARTBEAT_TIMEOUT_S
    ) as controller:
        master = subprocess.run(
            ["node", str(MASTER), channel, str(JOINT), str(COUNTS)],
            capture_output=True, text=True, timeout=240, check=False,
        )  # fmt: skip
        assert master.returncode == 0, master.stderr
    bus.shutdown()
    report = json.loads(master.stdout)
    for joint in range(1, 8):
        identity = report["identity"][str(joint)]
        # CiA 402, a servo drive; serial numbers of drives follow the arm's.
        assert identity["deviceType"] & 0x00FFFFFF == 0x00020192
        assert (identity["vendor"], identity["product"]) == (0, 1)
        assert identity["serial"] == 700 + joint
        assert identity["name"].rstrip("\0")
    assert report["identity"]["16"]["product"] == 2
    assert [counts for _, counts, _ in report["first"]] == initial_counts
    assert report["token"] == 127
    # 6041h: ready to switch on, switched on, operation enabled; from one SYNC to the next.
    assert [status & 0x6F for status in report["enabling"]] == [0x21, 0x23, 0x27]
    assert report["mode"] == 8
    _, driven, _ = report["driven"]
    assert driven == pytest.approx(initial_counts[JOINT - 1] + COUNTS, abs=COUNTS / 10 + 1)
    assert report["statusword"] & 0x6F == 0x07  # quick stop active
    assert report["afterwards"][1] == pytest.approx(report["stopped"][1], abs=1)
    assert "Object does not exist" in report["refused"]
    assert controller.drives[JOINT - 1].drive.counts == report["afterwards"][1]
