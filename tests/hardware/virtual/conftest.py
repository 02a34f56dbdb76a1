"""The packaged arm, what its files state, commands for its plant, and a controller on a bus."""

from collections.abc import Mapping

import pytest
from canopen import SdoAbortedError

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand
from hardware.virtual.plant import Plant
from operator_app.config.arm_file import load_arm
from solver.arrays import FloatArray
from tests.oracles.virtual_rig import Rig, rig

SARCOS = load_arm("sarcos_dextrous")
BLOCKED = [(None, 0.0)] * 7
"""Commands with all valves closed."""
NODES = (*range(1, 8), 16)


def commands(targets_rad: Mapping[int, float]) -> list[JointCommand]:
    """Position mode for the joints with a target, free mode for the others."""
    return [
        (JointMode.POSITION, targets_rad[j]) if j in targets_rad else (JointMode.FREE, 0.0)
        for j in range(1, 8)
    ]


def sensed_rad(plant: Plant) -> FloatArray:
    """Angles of the joints, as error-free sensors read them."""
    return plant.true_angles_rad[1:] - plant.truth.offsets_rad


def write_to_supervisor(arm: Rig, index: int, data: bytes) -> int | None:
    """Write an object of the supervisor; return the abort code, None if it was accepted."""
    try:
        arm.peer.write(16, index, 0, data)
    except SdoAbortedError as abort:
        return abort.code
    return None


def wait_for_heartbeats(arm: Rig, state: int | None = None) -> None:
    """Wait for a heartbeat (with this NMT state) of every node, in their order."""
    for node in NODES:
        arm.peer.wait_for(
            lambda number, data, node=node: (
                number == 0x700 + node and (state is None or data == bytes([state]))
            )
        )


@pytest.fixture
def arm():
    """A controller with a plant that is simple enough to predict, and a raw peer on its bus."""
    with rig() as running:
        yield running
