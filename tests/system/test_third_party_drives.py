"""An arm with third-party drives: refused, probed, and calibrated with the drafted profile."""

import math
import os
from contextlib import closing
from dataclasses import replace
from pathlib import Path

import pytest

from hardware.arm import JointMode
from hardware.buses.python_can import BusSettings, open_bus
from hardware.virtual.axis import arm_axes
from hardware.virtual.scenarios import scenario
from operator_app.commands.run import RunResult, run
from operator_app.config.arm_file import load_arm
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, Rig, begin, open_session
from operator_app.session.workflow.session import Session
from tests.oracles.fast_arm import fast_arm
from tests.oracles.foreign_arm import Axis, ForeignArm, Physics
from tests.oracles.parameter_documents import VALUES

pytestmark = pytest.mark.real_time

NODES = (21, 22, 24, 25, 26, 28, 29)
MODES = {8: JointMode.POSITION, 10: JointMode.FREE}


def closed_chain() -> Physics:
    """Return the closed chain of the virtual arm as the plant of third-party drives."""
    arm_file = load_arm("sarcos_dextrous")
    exact = scenario("exact")
    plant = exact.build(arm_file)
    scales = [axis.scale.counts_per_rad for axis in arm_axes(exact.arm(arm_file))]

    def step(axes: list[Axis]) -> None:
        commands = [
            (
                MODES[axis.mode] if axis.status == 0x27 else None,
                axis.direction * axis.target / scale,
            )
            for axis, scale in zip(axes, scales, strict=True)
        ]
        for axis, counts in zip(axes, plant.step(commands).position_counts, strict=True):
            axis.counts = axis.direction * counts

    return step


@pytest.mark.campaign
def test_third_party_arm_is_refused_then_calibrated_with_drafted_profile(
    tmp_path, run_command, monkeypatch
):
    monkeypatch.chdir(tmp_path)
    settings = BusSettings(interface="loopback", channel=f"foreign-{os.getpid()}")
    bus = ["-i", "loopback", "-c", settings.channel]
    step, axes = closed_chain(), [Axis(counts=0) for _ in NODES]
    axes[4].direction = -1
    step(axes)
    with closing(ForeignArm(open_bus(settings), NODES, axes, step)):
        unknown = run_command(3, "probe", *bus).out
        assert "node 21: a drive that is not in the bus profile sarcos" in unknown
        refused = run_command(3, "run", "hinge", *bus).err
        assert "no answer from nodes 1, 2, 3, 4, 5, 6, 7, 16" in refused

        assert "joint 3 = node 24" in run_command(0, "probe", *bus, "--draft", "acme.yaml").out
        profile = Path("acme.yaml").read_text()
        assert profile.startswith("# yaml-language-server: $schema=sarcal-profile.schema.json\n")
        assert Path("sarcal-profile.schema.json").is_file()
        run_command(0, "probe", *bus, "--profile", "acme.yaml")
        run_command(2, "probe", *bus, "--draft", "acme.yaml")
        assert Path("acme.yaml").read_text() == profile
        assert "{joint: 5, node: 26}" in profile
        reversed_joint = "{joint: 5, node: 26, direction: -1}"
        Path("acme.yaml").write_text(profile.replace("{joint: 5, node: 26}", reversed_joint))

        result, session = calibrate(settings)
    assert result.solution.accepted, result.solution.reasons
    assert result.exported.receipt is None, "this arm has no parameter store"
    estimate = result.solution.estimate
    for parameter, value, sd in zip(
        estimate.parameters, estimate.x, estimate.standard_deviation, strict=True
    ):
        if parameter.name.startswith("theta_off"):
            assert sd < math.radians(0.5)
            true_rad = math.radians(VALUES[parameter.name])
            assert value == pytest.approx(true_rad, abs=4 * sd), parameter.name
    assert session.state.serial_number.startswith("50021-50022-")


def calibrate(settings: BusSettings) -> tuple[RunResult, Session]:
    """Run as `sarcal run` does, but with SYNCs as fast as the arm answers."""
    choices = Choices(
        poses=14,
        scenario="exact",
        interface="loopback",
        channel=settings.channel,
        profile="acme.yaml",
    )
    opening = begin("hinge", choices, root=Path("sessions"))
    procedure = replace(opening.effective_procedure, upload=False)
    timeouts = {"patience_s": 10.0, "answers_s": 5.0, "sdo_timeout_s": 5.0}
    arm = fast_arm(procedure.arm, settings, procedure.profile, **timeouts)
    rig = Rig(arm=arm, opening=replace(opening, procedure=procedure), simulated=False)
    session = open_session(rig)
    try:
        return run(session, Listener()), session
    finally:
        session.close("done")
