"""Errors against the true values, which equal the estimate except for one planted entry."""

import math

import pytest

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.tool_accuracy import TrueErrors
from operator_app.config.fixture_file import load_fixture
from operator_app.planning.simulated import simulated_poses
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from operator_app.session.store.true_errors import with_truth
from solver.chain.parameters import DhEntry, DhKind
from tests.oracles.as_shipped import ARM, HINGE


def test_true_errors_list_the_wrong_entry():
    simulation = simulated_poses(ARM, load_fixture("hinge"), poses=30, seed=5)
    solution = calibrate(ARM, HINGE, simulation.poses)
    estimate, rows = solution.estimate, ARM.table.stacked()
    exact = {
        DhEntry(kind=kind, row=row).name: float(rows[kind, row - 1])
        for kind in DhKind
        for row in range(1, ARM.joint_count + 1)
    }
    exact |= {p.name: estimate.value(p.name) for p in estimate.parameters}
    sigma = estimate.sd_by_name["theta_off_4"]

    def true_errors(**off: float) -> TrueErrors:
        values = exact | {name: exact[name] + by for name, by in off.items()}
        return with_truth(solution, ARM, lambda placement: values if placement == 1 else {}).truth

    same = true_errors()
    assert (same.inside_95, same.of) == (14, 14)
    assert same.tool_rms_m < 1e-12
    assert 1e-4 < same.predicted_rms_m < 2e-3
    # The last link's length moves every tool by as much; a turn of the whole arm none.
    assert true_errors(s_7=0.01).tool_rms_m == pytest.approx(0.01)
    assert true_errors(theta_off_1=0.01).tool_rms_m < 1e-12
    for error, inside in ((1.5 * sigma, 14), (4.0 * sigma, 13), (2.0 * math.pi, 14)):
        assert true_errors(theta_off_4=error).inside_95 == inside

    facts = facts_of(with_truth(solution, ARM, lambda _: exact))
    assert facts.json["truth"]["inside_95"] == facts.json["truth"]["of"] == 14
    assert set(facts.json["truth"]) == {"inside_95", "of", "tool_mm_rms", "predicted_mm_rms"}
    assert "entries within their 95 % intervals 14 14" in " ".join(facts_text(facts).split())
    assert "truth" not in facts_of(solution).json
