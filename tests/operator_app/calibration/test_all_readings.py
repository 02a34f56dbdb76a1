"""What all readings of a session do, or one joint's over the session: scatter and drift, by name."""

import re
from dataclasses import replace

import numpy as np
import pytest

from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.shop_floor import session


@pytest.mark.sample(1)
@pytest.mark.parametrize("degrees", [0.1, 0.2, 0.3])
def test_readings_of_all_joints_that_scatter_blame_no_single_joint(degrees):
    """Said was that one encoder errs by 0.9 deg, that an RVDT is bent, or that the hinge is a ball."""
    found = session(61)
    noise = np.random.default_rng(61).normal(size=found.readings.shape)
    said = outcome(replace(found, readings=found.readings + np.deg2rad(degrees) * noise))
    assert not said.accepted
    assert said.causes[0] == "SCATTER", said.said
    assert "WRONG_FIXTURE" not in said.causes
    size = re.search(r"scatter by about ([0-9.]+) deg", said.said)
    assert size is not None, said.said
    assert float(size[1]) == pytest.approx(degrees, rel=0.1)


@pytest.mark.sample(1)
@pytest.mark.parametrize(("seed", "joint", "degrees"), [(62, 7, 0.1), (63, 1, 0.3), (64, 2, 0.1)])
def test_a_reading_that_drifts_is_said_to_drift(seed, joint, degrees):
    """Not to have shifted at once, nor to err once a turn."""
    found = session(seed)
    read = found.readings.copy()
    read[:, joint - 1] += np.deg2rad(degrees) * np.linspace(0.0, 1.0, len(read))
    said = outcome(replace(found, readings=read))
    assert said.causes[0] == f"DRIFT_JOINT_{joint}", said.said
