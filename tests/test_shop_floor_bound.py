"""The bound of tests/oracles/shop_floor_bound, compared with another oracle and with added error sources."""

from dataclasses import replace

import numpy as np
import pytest

from tests.oracles import shop_floor_bound
from tests.oracles.loop_oracle import cramer_rao
from tests.oracles.shop_floor import PARAMETERS, RVDTS, Sizes, session
from tests.oracles.shop_floor_bound import _equations, bound, covariance
from tests.oracles.shop_floor_chain import (
    FOLLOW,
    LOWER_DEG,
    UPPER_DEG,
    Loop,
    frames,
    nominal_chain,
    nominal_chart,
    rotation_about_z,
)
from tests.oracles.shop_floor_load import Load, Masses

COUNT = 2.0 * np.pi / 400_000
LSB = np.deg2rad(120.0) / 4096


@pytest.mark.campaign
def test_bound_with_noise_alone_agrees_with_cramer_rao_oracle():
    sizes = replace(Sizes.only(), linearity=0.0, gain=0.0)
    simulated = session(4, sizes)
    chain = simulated.specimen.chain
    angles = simulated.angles - chain.theta_off
    variance = np.repeat([COUNT**2 / 12.0, LSB**2 * (4.0 + 1.0 / 12.0) / 32.0], [5, 2])
    expected = np.sqrt(np.diagonal(cramer_rao(chain, angles, PARAMETERS, variance)))
    assert bound(simulated, sizes) == pytest.approx(expected, rel=1e-5)


def test_load_columns_agree_with_loads_of_the_simulator(monkeypatch):
    """Deflection and sag of five loads by `Load`, compared with columns of the bound."""
    monkeypatch.setattr(shop_floor_bound, "DRAWS", 5)
    shop_floor_bound._every_load.cache_clear()
    angles = nominal_chart().angles[::20]
    m, T = len(angles), frames(nominal_chain(), angles)
    B, rows = np.tile(np.eye(6, 7), (m, 1, 1)), np.tile(np.eye(6), (m, 1, 1))
    sizes = replace(Sizes.everything(), sag_rad=2.0, give_rad=3.0, give_m=5.0)
    columns = shop_floor_bound._loads(rows, B, angles, sizes)
    sag, deflection = columns[..., :35].reshape(m, 6, 7, 5), columns[..., 35:]
    rotation = rotation_about_z(angles[:, 0])[:, :3, :3]
    for k in range(5):
        load = Load.drawn(
            nominal_chain(), nominal_chart().angles, np.random.default_rng([6, k]),
            sag_rad=1.0, give_rad=np.sqrt(0.91), give_m=np.sqrt(0.91),
        )  # fmt: skip
        twist = 2.0 * (load.sag * load.torque(T))[:, 1:] / np.sqrt(5.0)
        assert np.einsum("mjj->mj", sag[:, :, :6, k]) == pytest.approx(twist[:, :6], rel=1e-9)
        table, hand = load.give(T, angles)
        for part, size in ((slice(0, 3), 3.0), (slice(3, 6), 5.0)):
            expected = (rotation @ table[:, part, None])[..., 0] + hand[:, part]
            assert deflection[:, part, k] == pytest.approx(size * expected / np.sqrt(5.0), rel=1e-9)
    shop_floor_bound._every_load.cache_clear()


def test_play_has_the_second_moments_of_the_simulator():
    """Moments over arms, of which each has loads of its own."""
    angles = nominal_chart().angles[::40]
    m = len(angles)
    columns = shop_floor_bound._play(np.tile(np.eye(7), (m, 1, 1)), angles, Sizes.everything())
    moments = np.einsum("ajk,bjk->jab", columns, columns) / Sizes().backlash_rad ** 2
    side = np.sign(np.diff(angles, axis=0, prepend=angles[:1]))[:, 1:]
    expected = 0.5 * np.einsum("aj,bj->jab", side, side)
    T, rng = frames(nominal_chain(), angles), np.random.default_rng(3)
    for _ in range(400):
        down = np.array([-1.0, 0.0, 0.0]) + 0.05 * rng.normal(size=3)
        one = np.sign(Masses.drawn(nominal_chain(), rng).torque(T, down))[:, 1:]
        expected += 0.5 * np.einsum("aj,bj->jab", one, one) / 400
    assert np.abs(moments - expected).max() < 0.12
    assert np.sqrt(np.mean((moments - expected) ** 2)) < 0.03


@pytest.mark.campaign
def test_gain_adds_a_line_of_the_stated_size():
    """The bound with RVDT gains alone, compared with noise and a line for each RVDT."""
    simulated = session(4)
    bare = replace(Sizes.only(), linearity=0.0, gain=0.0)
    without_gain, with_gain = (
        covariance(simulated, replace(bare, gain=gain)) for gain in (0.0, 0.005)
    )
    chain = simulated.specimen.chain
    angles = (Loop(chain=chain).closed(simulated.angles, free=FOLLOW)[0] - chain.theta_off)[:, 1:]
    hard, V, B = _equations(simulated, bare)
    for j in RVDTS:
        middle = np.deg2rad(0.5 * (LOWER_DEG + UPPER_DEG)[j - 1])
        line = (B[:, :, j - 1] * (0.005 * (angles[:, j - 1] - middle))[:, None]).ravel()
        V = V + np.outer(line, line)
    assert with_gain == pytest.approx(np.linalg.inv(hard.T @ np.linalg.solve(V, hard)), rel=1e-6)
    # Joint 6 moves off the middle of its scale: a gain there is like an offset.
    assert with_gain[5, 5] > 2.0 * without_gain[5, 5]


@pytest.mark.sample(1)
@pytest.mark.parametrize("source", ["lengths", "twists", "encoders", "backlash"])
def test_added_error_source_increases_the_bound(source):
    simulated = session(4)
    bare, more = (bound(simulated, sizes) for sizes in (Sizes.only(), Sizes.only(source)))
    assert np.all(more >= bare * (1.0 - 1e-9))
    assert np.any(more > 2.0 * bare)
    twice = bound(simulated, Sizes.only(source, times=2.0))
    assert np.all(twice >= more * (1.0 - 1e-9))
    assert np.all(twice <= 2.0 * more * (1.0 + 1e-9))
