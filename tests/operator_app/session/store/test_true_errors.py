"""The distance from the truth, against truths that are the estimate itself but for one planted entry."""

import math

import pytest

from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.tool_accuracy import TrueErrors
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.planning.simulated import simulated_poses
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from operator_app.session.store.true_errors import with_truth
from solver.chain.parameters import DhEntry, DhKind


def test_true_errors_list_the_wrong_entry():
    arm, fixture = load_arm("sarcos_dextrous"), load_fixture("hinge")
    made = simulated_poses(arm, fixture, poses=30, seed=5)
    solution = calibrate(arm, fixture.fixture, made.poses)
    estimate, rows = solution.estimate, arm.table.stacked()
    exact = {
        DhEntry(kind=kind, row=row).name: float(rows[kind, row - 1])
        for kind in DhKind
        for row in range(1, arm.joint_count + 1)
    }
    exact |= dict(zip((p.name for p in estimate.parameters), estimate.x.tolist(), strict=True))
    sigma = dict(
        zip(
            (p.name for p in estimate.parameters), estimate.standard_deviation.tolist(), strict=True
        )
    )

    def found(**off: float) -> TrueErrors:
        values = exact | {name: exact[name] + by for name, by in off.items()}
        truth = with_truth(solution, arm, lambda placement: values if placement == 1 else {}).truth
        assert truth is not None
        return truth

    same = found()
    assert (same.inside_95, same.of) == (14, 14)
    assert same.tool_rms_m < 1e-12
    assert 1e-4 < same.predicted_rms_m < 2e-3
    # The last link's length moves every tool by as much; a turn of the whole arm none.
    assert found(s_7=0.01).tool_rms_m == pytest.approx(0.01)
    assert found(theta_off_1=0.01).tool_rms_m < 1e-12
    assert found(theta_off_4=1.5 * sigma["theta_off_4"]).inside_95 == 14
    assert found(theta_off_4=4.0 * sigma["theta_off_4"]).inside_95 == 13
    assert found(theta_off_4=2.0 * math.pi).inside_95 == 14

    facts = facts_of(with_truth(solution, arm, lambda _: exact))
    assert facts.json["truth"]["inside_95"] == facts.json["truth"]["of"] == 14
    assert set(facts.json["truth"]) == {"inside_95", "of", "tool_mm_rms", "predicted_mm_rms"}
    assert "entries within their 95 % intervals 14 14" in " ".join(facts_text(facts).split())
    assert "truth" not in facts_of(solution).json
