"""An encoder's spread within a pose is looked at: an arm that moved while it was sampled is said to have."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.shop_floor_outcome import ACCEPTED, WARNED, outcome
from tests.oracles.shop_floor import session


@pytest.mark.parametrize("poses", [slice(None), slice(4, 6)])
def test_an_encoder_that_moved_while_it_was_read_is_named(poses):
    """1 deg in all poses, and in two: ACCEPTED without a word before."""
    found = session(61)
    spread = found.spread.copy()
    spread[poses, 2] = np.deg2rad(1.0)
    said = outcome(replace(found, spread=spread))
    assert said.verdict == WARNED
    assert said.causes == ("UNSTEADY_3",)
    assert "UNSTEADY_3" in said.warnings
    assert "spread by up to 1.000 deg within pose" in said.said


def test_a_spread_as_of_its_sensor_is_nothing():
    assert outcome(session(61)).verdict == ACCEPTED
