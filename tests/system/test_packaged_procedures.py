"""Every packaged procedure on a simulated arm and fixture: accepted, verified, true values recovered."""

import numpy as np
import pytest

from tests.oracles.bench import bench

LONG = [("rigid", 24), ("ball", 24), ("open_loop", 12)]


@pytest.mark.parametrize(
    ("procedure", "poses", "scenario"),
    [
        *(("rigid", 14, "datasheet"), ("ball", 14, "datasheet"), ("open_loop", 8, "datasheet")),
        *(pytest.param(*long, "exact", marks=pytest.mark.campaign) for long in LONG),
        *(pytest.param(*long, "datasheet", marks=pytest.mark.campaign) for long in LONG),
    ],
)
def test_calibration_is_accepted_and_recovers_true_values(tmp_path, procedure, poses, scenario):
    options = {"procedure": procedure, "scenario": scenario, "seed": 1, "poses": poses}
    with bench(tmp_path, **options) as sessions:
        result = sessions.calibrated()
        solution, estimate = result.solution, result.solution.estimate
        assert solution.accepted, solution.reasons
        true = sessions.planted(solution)
        assert np.all(np.abs(estimate.x - true) < 4.0 * estimate.standard_deviation)
        # The true values are far from the nominal ones.
        assert np.abs(true - [p.nominal for p in estimate.parameters]).max() > 0.01
        assert sessions.verified(result.exported.parameters.parent).holds
