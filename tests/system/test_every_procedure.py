"""Every packaged procedure on a specimen of its arm and fixture: accepted, verified, and what was planted."""

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
def test_it_is_accepted_and_finds_what_was_planted(tmp_path, procedure, poses, scenario):
    with bench(tmp_path, procedure=procedure, scenario=scenario, seed=1, poses=poses) as made:
        result = made.calibrated()
        solution = result.solution
        assert solution.accepted, solution.reasons
        assert result.exported is not None
        off = np.abs(solution.estimate.x - made.planted(solution))
        assert np.all(off < 4.0 * solution.estimate.standard_deviation)
        # Not for want of trying: what was planted is far from what the files state.
        nominal = np.array([p.nominal for p in solution.estimate.parameters])
        assert np.abs(made.planted(solution) - nominal).max() > 0.01
        assert made.verified(result.exported.folder).holds
