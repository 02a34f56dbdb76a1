"""An arm set up in a way of its own: refused, probed, and calibrated with the profile that was drafted."""

from __future__ import annotations

import json
import math
from pathlib import Path

import pytest

from hardware.arm import JointMode
from hardware.buses import BusSettings, open_bus
from hardware.virtual.axis import arm_axes
from hardware.virtual.port import JointCommand
from hardware.virtual.scenarios import scenario
from operator_app.cli import main
from operator_app.config.arm_file import load_arm
from operator_app.config.resources import resolve
from oracles.foreign_arm import Axis, Physics, foreign_arm

NODES = (21, 22, 24, 25, 26, 28, 29)
BACKWARDS = 5
MODES = {8: JointMode.POSITION, 10: JointMode.FREE}


def plant() -> Physics:
    """The closed chain of the virtual arm behind drives that are not ours; one of them counts backwards."""
    arm = scenario("exact").arm(load_arm("sarcos_dextrous"))
    body = scenario("exact").build(load_arm("sarcos_dextrous"))
    per_rad = [axis.scale.counts_per_rad for axis in arm_axes(arm)]

    def step(axes: list[Axis]) -> None:
        reading = body.step(
            [
                JointCommand(
                    mode=MODES[axis.mode] if axis.status == 0x27 else None,
                    target_rad=axis.direction * axis.target / scale,
                )
                for axis, scale in zip(axes, per_rad, strict=True)
            ]
        )
        for axis, counts in zip(axes, reading.position_counts, strict=True):
            axis.counts = axis.direction * counts

    return step


@pytest.mark.timeout(400)
def test_a_foreign_arm_is_refused_then_probed_then_calibrated(
    tmp_path: Path, capsys: pytest.CaptureFixture[str], monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    channel = f"foreign-{tmp_path.name}-{id(tmp_path)}"
    bus = ["-i", "loopback", "-c", channel]
    quick = resolve("procedure", "hinge").data.decode()
    quick = quick.replace("poses: 40", "poses: 16").replace(
        "speed_deg_per_s: 20", "speed_deg_per_s: 60"
    )
    Path("quick.yaml").write_text(quick.replace("samples_per_pose: 32", "samples_per_pose: 6"))
    run = ["run", "quick.yaml", *bus, "--scenario", "exact", "--json"]
    step, axes = plant(), [Axis(counts=0) for _ in NODES]
    axes[BACKWARDS - 1].direction = -1
    step(axes)
    arm_bus = open_bus(BusSettings(interface="loopback", channel=channel))
    with foreign_arm(arm_bus, NODES, axes, step):
        assert main(["probe", *bus]) == 3
        assert (
            "node 21: a drive that the bus profile sarcos does not name" in capsys.readouterr().out
        )
        assert main(run) == 3
        assert "no answer from nodes 1, 2, 3, 4, 5, 6, 7, 16" in capsys.readouterr().err

        assert main(["probe", *bus, "--draft", "acme.yaml"]) == 0
        assert "joint 3 = node 24" in capsys.readouterr().out
        drafted = Path("acme.yaml").read_text()
        assert main(["probe", *bus, "--profile", "acme.yaml"]) == 0
        assert main(["probe", *bus, "--draft", "acme.yaml"]) == 2
        Path("acme.yaml").write_text(
            drafted.replace("{joint: 5, node: 26}", "{joint: 5, node: 26, direction: -1}")
        )
        capsys.readouterr()

        code = main([*run, "--profile", "acme.yaml"])
        told = capsys.readouterr()
    assert code == 0, told.err
    found = json.loads(told.out)
    assert found["verdict"].startswith("accepted")
    assert found["session"]["uploaded"] is False
    assert found["rank"] == len(found["parameters"])
    true_offset_deg = math.degrees(0.0)
    assert isinstance(true_offset_deg, float)
