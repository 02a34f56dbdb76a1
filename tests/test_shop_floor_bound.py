"""The bound of tests/oracles/shop_floor_bound, against another oracle's and against sources added."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from oracles.loop_oracle import Truth, cramer_rao
from tests.oracles.shop_floor import PARAMETERS, Sizes, session
from tests.oracles.shop_floor_bound import bound

COUNT = 2.0 * np.pi / 400_000
LSB = np.deg2rad(120.0) / 4096


def test_with_noise_alone_it_is_the_other_oracles():
    sizes = replace(Sizes.only(), linearity=0.0)
    taken = session(4, sizes)
    chain = taken.specimen.chain
    truth = Truth(
        theta_off=chain.theta_off, s=chain.s, a=chain.a, alpha=chain.alpha, home=np.zeros(7)
    )
    angles = taken.angles - chain.theta_off
    variance = np.repeat([COUNT**2 / 12.0, LSB**2 * (4.0 + 1.0 / 12.0) / 32.0], [5, 2])
    other = np.sqrt(np.diagonal(cramer_rao(truth, angles, PARAMETERS, variance)))
    assert bound(taken, sizes) == pytest.approx(other, rel=1e-5)


@pytest.mark.parametrize("source", ["lengths", "twists", "encoders", "backlash"])
def test_a_source_more_is_never_less(source):
    taken = session(4)
    bare, more = (bound(taken, sizes) for sizes in (Sizes.only(), Sizes.only(source)))
    assert np.all(more >= bare * (1.0 - 1e-9))
    assert np.any(more > 2.0 * bare)
    twice = bound(taken, Sizes.only(source, times=2.0))
    assert np.all(twice >= more * (1.0 - 1e-9))
    assert np.all(twice <= 2.0 * more * (1.0 + 1e-9))
