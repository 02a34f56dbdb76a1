"""The packaged arm, what its files state, commands for its plant, and a controller on a bus."""

from collections.abc import Callable, Mapping

import pytest
from canopen import SdoAbortedError

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand
from hardware.virtual.specimens import SpecimenFiles
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.arm_model import ArmModel
from tests.oracles.virtual_rig import Rig, rig

Commands = Callable[[Mapping[int, float]], list[JointCommand]]
NODES = (*range(1, 8), 16)


def specimen_files(fixture: str, arm: ArmModel | None = None, **other: float) -> SpecimenFiles:
    """What the files of a fixture and an arm (default: the packaged one) state."""
    spec = load_fixture(fixture)
    return SpecimenFiles(
        arm=load_arm("sarcos_dextrous") if arm is None else arm,
        fixture=spec.fixture,
        **{"tolerance_m": spec.tolerance_m, "tolerance_rad": spec.tolerance_rad, **other},
    )


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


@pytest.fixture(scope="session")
def sarcos():
    return load_arm("sarcos_dextrous")


@pytest.fixture(scope="session")
def commands():
    """Position mode for the joints in a mapping to their targets (rad), free mode for the rest."""

    def make_commands(targets: Mapping[int, float]) -> list[JointCommand]:
        return [
            JointCommand(mode=JointMode.POSITION, target_rad=targets[j])
            if j in targets
            else JointCommand(mode=JointMode.FREE, target_rad=0.0)
            for j in range(1, 8)
        ]

    return make_commands


@pytest.fixture
def arm():
    """A controller with a plant that is simple enough to predict, and a raw peer on its bus."""
    with rig() as running:
        yield running
