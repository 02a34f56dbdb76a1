"""The Sarcos arm as an arm file would describe it, commands for its plant, and a controller on a bus."""

from collections.abc import Callable, Iterator, Mapping

import numpy as np
import pytest

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand
from hardware.virtual.specimens import SpecimenFiles
from hardware.virtual.true_loop import PAPER_HOME_RAD
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.arm_model import ArmModel, Joint
from solver.chain.kinematics import DhTable
from solver.chain.sensors import Encoder, Rvdt
from tests.oracles.virtual_rig import Rig, rig

Commands = Callable[[Mapping[int, float]], list[JointCommand]]

RANGES_DEG = (
    (-35.0, 115.0),
    (170.0, 320.0),
    (68.0, 218.0),
    (-190.0, -40.0),
    (-265.0, -115.0),
    (-275.625, -155.625),
    (-15.0, 105.0),
)


def stated(fixture: str, arm: ArmModel | None = None, **other: float) -> SpecimenFiles:
    """What the files of a fixture and an arm, the packaged one, state."""
    spec = load_fixture(fixture)
    return SpecimenFiles(
        arm=load_arm("sarcos_dextrous") if arm is None else arm,
        fixture=spec.fixture,
        **{"tolerance_m": spec.tolerance_m, "tolerance_rad": spec.tolerance_rad, **other},
    )


@pytest.fixture(scope="session")
def sarcos() -> ArmModel:
    encoder = Encoder(counts_per_rev=400_000)
    rvdt = Rvdt(bits=12, full_scale_rad=float(np.deg2rad(120.0)), linearity=0.02, noise_lsb=2.0)
    return ArmModel(
        name="sarcos_dextrous",
        table=DhTable(
            theta_off_rad=np.zeros(7),
            s_m=np.array([0.0, 0.0, 0.355, 0.0, 0.320, 0.0, 0.0]),
            a_m=np.zeros(7),
            alpha_rad=np.deg2rad([90.0, -90.0, 90.0, -90.0, 90.0, -90.0, 0.0]),
        ),
        joints=tuple(
            Joint(
                name=f"joint {j}",
                lower_rad=float(np.deg2rad(low)),
                upper_rad=float(np.deg2rad(high)),
                sensor=encoder if j <= 5 else rvdt,
                max_speed_rad_per_s=float(np.pi),
                max_torque_nm=100.0,
            )
            for j, (low, high) in enumerate(RANGES_DEG, start=1)
        ),
        free=(),
        home_rad=PAPER_HOME_RAD,
    )


@pytest.fixture(scope="session")
def drive() -> Commands:
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
def arm() -> Iterator[Rig]:
    """A controller with a plant that is simple enough to predict, and a raw peer on its bus."""
    with rig() as made:
        yield made
