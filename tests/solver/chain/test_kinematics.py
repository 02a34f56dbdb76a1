"""Forward kinematics and Jacobians against pinocchio."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.kinematics import DhTable, Entries, Frames, forward, jacobian
from tests.oracles.pinocchio_chain import PinocchioChain

LINKS = 8


def random_chain(seed: int, links: int = LINKS) -> tuple[np.ndarray, ...]:
    rng = np.random.default_rng(seed)
    theta = rng.uniform(-4.0, 4.0, links)
    alpha = rng.choice([0.0, np.pi / 2, -np.pi / 2, 1e-9, 1.1], links)
    chain = theta, rng.normal(0, 0.3, links), rng.normal(0, 0.3, links), alpha
    # Hayati's twist about y in every third chain, on some of its links, small and large.
    beta = rng.choice([0.0, 0.0, 1e-9, 1e-3, -0.7], links)
    return (*chain, beta) if seed % 3 == 1 else chain


def columns_of(frames: Frames, links: int = LINKS) -> np.ndarray:
    """Columns (..., 6, 5, links) of every entry of every link."""
    every = Entries.of(np.repeat(range(5), links).tolist(), [*range(links)] * 5)
    columns = jacobian(frames, every)
    return columns.reshape(*columns.shape[:-1], 5, links)


@pytest.mark.parametrize(
    ("seed", "links"), [*((seed, LINKS) for seed in range(10)), (1, 1), (2, 2), (12, 12)]
)
def test_frames_and_jacobian_agree_with_pinocchio(seed, links):
    chain, oracle = random_chain(seed, links), PinocchioChain(links)
    rotations, origins = oracle.frames(*chain)
    frames = forward(*chain)
    assert np.abs(frames.axes - rotations).max() < 1e-12
    assert np.abs(frames.origins_m - origins).max() < 1e-12
    columns = columns_of(frames, links)
    assert columns.shape == (6, 5, links)
    assert np.abs(columns - oracle.jacobian(*chain)).max() < 1e-12


def test_table_is_a_read_only_copy_of_equal_columns():
    source = np.zeros(2)
    table = DhTable(theta_off_rad=source, s_m=source, a_m=source, alpha_rad=source)
    source[0] = 1.0
    assert table.s_m[0] == 0.0
    with pytest.raises(ValueError, match="read-only"):
        table.s_m[0] = 1.0
    with pytest.raises(ValueError, match="one entry per link"):
        replace(table, a_m=np.zeros(3))


def test_zero_hayati_twist_changes_no_digit():
    chain = random_chain(6)
    plain, twisted = forward(*chain), forward(*chain, np.zeros(LINKS))
    assert np.array_equal(plain.axes_of, twisted.axes_of)
    assert np.array_equal(plain.origin_of, twisted.origin_of)
