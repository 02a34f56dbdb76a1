"""An encoder whose counts per turn are not the file's: found by a test of its own, named with its size."""

import re
from dataclasses import replace

import pytest

from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.shop_floor import session


@pytest.mark.sample(2)
@pytest.mark.parametrize(("joint", "percent"), [(2, 5.0), (5, -5.0), (3, 1.0), (4, 1.0), (5, 1.0)])
def test_an_encoder_of_another_scale_is_named(joint, percent):
    """Joint 2 by 5 % sagged, joint 4 by 1 % was ACCEPTED without a word, 7 sigma wrong."""
    found = session(61)
    read = found.readings.copy()
    read[:, joint - 1] *= 1.0 + 0.01 * percent
    said = outcome(replace(found, readings=read))
    codes = [code for code in said.causes if not code.startswith("RANGE")]
    assert codes[0] == f"SCALE_{joint}", said.said
    size = re.search(rf"joint {joint}'s encoder is off by about (\S+) %", said.said)
    assert size is not None, said.said
    assert float(size[1]) == pytest.approx(percent, rel=0.25)
