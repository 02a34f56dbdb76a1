"""The packaged arm and what its files state, commands for its plant, and a controller on a bus."""

from collections.abc import Callable, Mapping

import pytest

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand
from hardware.virtual.specimens import SpecimenFiles
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.arm_model import ArmModel
from tests.oracles.virtual_rig import rig

Commands = Callable[[Mapping[int, float]], list[JointCommand]]


def stated(fixture: str, arm: ArmModel | None = None, **other: float) -> SpecimenFiles:
    """What the files of a fixture and an arm, the packaged one, state."""
    spec = load_fixture(fixture)
    return SpecimenFiles(
        arm=load_arm("sarcos_dextrous") if arm is None else arm,
        fixture=spec.fixture,
        **{"tolerance_m": spec.tolerance_m, "tolerance_rad": spec.tolerance_rad, **other},
    )


@pytest.fixture(scope="session")
def sarcos():
    return load_arm("sarcos_dextrous")


@pytest.fixture(scope="session")
def drive():
    """Position mode for the joints in a mapping to their targets (rad), free mode for the rest."""

    def commands(targets: Mapping[int, float]) -> list[JointCommand]:
        return [
            JointCommand(mode=JointMode.POSITION, target_rad=targets[j])
            if j in targets
            else JointCommand(mode=JointMode.FREE, target_rad=0.0)
            for j in range(1, 8)
        ]

    return commands


@pytest.fixture
def arm():
    """A controller with a plant that is simple enough to predict, and a raw peer on its bus."""
    with rig() as made:
        yield made
