"""The solver's models of the paper's closed loop and arm, and the oracle's true parameters."""

from collections.abc import Sequence
from pathlib import Path

import numpy as np
import pytest

from solver.chain.arm_model import ArmModel, Joint
from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhEntry
from solver.chain.sensors import Encoder, Rvdt
from solver.loops.dh import DhLoop
from solver.loops.endpoints import PointClosure
from tests.oracles.loop_oracle import Truth, paper_truth
from tests.oracles.shop_floor import PARAMETERS as NAMES


def entries(names: Sequence[str]) -> tuple[DhEntry, ...]:
    """D-H entries by name."""
    return tuple(DhEntry.parse(name) for name in names)


def tip_position(model: PointClosure, x: np.ndarray, q: np.ndarray) -> np.ndarray:
    """Centre of the ball in the base frame for every pose (..., m, 3), m."""
    return model.reduced(x, q).residual + model.own_values(x)[..., 3:]


def loop_of(
    truth: Truth, *, names: tuple[str, ...] = NAMES, unsensed: tuple[int, ...] = ()
) -> DhLoop:
    """Build the solver's model of the oracle's loop, with the truth as nominal values."""
    unsensed_offsets = {f"theta_off_{j}" for j in unsensed}
    return DhLoop(
        table=DhTable(
            theta_off_rad=truth.theta_off, s_m=truth.s, a_m=truth.a, alpha_rad=truth.alpha
        ),
        entries=entries([n for n in names if n not in unsensed_offsets]),
        hinge=True,
        unsensed_joints=unsensed,
    )


def paper_arm(truth: Truth) -> ArmModel:
    """The arm of the paper: 400,000-count encoders on joints 1 to 5, RVDTs on 6 and 7."""
    encoder = Encoder(counts_per_rev=400_000)
    rvdt = Rvdt(bits=12, full_scale_rad=np.deg2rad(120.0), linearity=0.02, noise_lsb=2.0)
    return ArmModel(
        name="sarcos_dextrous",
        table=DhTable(
            theta_off_rad=truth.theta_off[1:],
            s_m=truth.s[1:],
            a_m=truth.a[1:],
            alpha_rad=truth.alpha[1:],
        ),
        joints=tuple(
            Joint(
                name=f"joint {j}",
                lower_rad=truth.home[j - 1] - np.deg2rad(75.0),
                upper_rad=truth.home[j - 1] + np.deg2rad(75.0),
                sensor=encoder if j <= 5 else rvdt,
                max_speed_rad_per_s=3.0,
                max_torque_nm=100.0,
            )
            for j in range(1, 8)
        ),
        free=entries([f"theta_off_{j}" for j in range(1, 8)]),
        home_rad=truth.home,
        length_tolerance_m=np.zeros(7),
        twist_tolerance_rad=np.zeros(7),
    )


@pytest.fixture(scope="session")
def truth():
    return paper_truth()


def read_poses(name: str) -> np.ndarray:
    """Joint angles (m, 7), rad, of an oracle pose set of the hinge."""
    file = Path(__file__).parents[1] / "data" / "hinge" / name
    return np.deg2rad(np.loadtxt(file, delimiter=",", skiprows=1)[:, 2:9])
