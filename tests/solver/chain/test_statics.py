"""Gravity torques against pinocchio."""

import numpy as np
import pytest

from solver.chain.kinematics import forward
from solver.chain.statics import STANDARD_GRAVITY_M_PER_S2, LinkMasses, torque_rates
from tests.oracles.pinocchio_chain import PinocchioGravity

LINKS = 7


def random_masses(seed: int):
    rng = np.random.default_rng(seed)
    table = (rng.normal(size=LINKS), 0.3 * rng.normal(size=LINKS), rng.normal(size=LINKS))
    down = rng.normal(size=3)
    masses = LinkMasses(
        mass_kg=rng.uniform(0.2, 4.0, LINKS),
        centre_m=0.2 * rng.normal(size=(LINKS, 3)),
        mass_sd_kg=rng.uniform(0.1, 0.5, LINKS),
        centre_sd_m=rng.uniform(0.01, 0.02, LINKS),
        down=down / np.linalg.norm(down),
        down_sd_rad=0.05,
    )
    return rng.uniform(-3.0, 3.0, size=(6, LINKS)), table, masses


@pytest.mark.parametrize("seed", range(5))
def test_torques_agree_with_pinocchio(seed):
    theta, (s, a, alpha), masses = random_masses(seed)
    rates = torque_rates(forward(theta, s, a, alpha), masses.down)
    torque = np.einsum("...jka,ka->...j", rates, masses.moments)
    oracle = PinocchioGravity(
        masses.mass_kg, masses.centre_m, STANDARD_GRAVITY_M_PER_S2 * masses.down
    )
    for k, angles in enumerate(theta):
        np.testing.assert_allclose(
            torque[k], -oracle.holding_torque(angles, s, a, alpha), rtol=1e-10, atol=1e-10
        )


def test_covariance_of_moments_agrees_with_draws():
    _, _, masses = random_masses(3)
    rng = np.random.default_rng(4)
    count = 200_000
    mass = masses.mass_kg + masses.mass_sd_kg * rng.normal(size=(count, LINKS))
    centre = masses.centre_m + masses.centre_sd_m[:, None] * rng.normal(size=(count, LINKS, 3))
    moments = np.concatenate((mass[..., None], mass[..., None] * centre), axis=-1)
    for link, root in enumerate(masses.moments_sd):
        expected = np.cov(moments[:, link].T)
        # To first order: without the product of both deviations, a few per cent of either.
        np.testing.assert_allclose(root @ root.T, expected, atol=0.06 * np.diagonal(expected).max())


def test_tilts_are_perpendicular_to_down():
    _, _, masses = random_masses(1)
    assert masses.tilted.shape == (2, 3)
    np.testing.assert_allclose(masses.tilted @ masses.down, 0.0, atol=1e-15)
    np.testing.assert_allclose(np.linalg.norm(masses.tilted, axis=1), 0.05)
