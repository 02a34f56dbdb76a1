"""Advice on placements of a fixture: feasibility, ranking, and files that reproduce them."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.base import CheckKind, SetupCheck, Severity
from fixtures.hinge import moved_hinge
from operator_app.config.fixture_file import HingePlacement
from operator_app.config.quantities import in_si
from operator_app.errors import SessionError
from operator_app.planning.advice import advise, assess_placement
from operator_app.report.results.plan import advice_json, advice_text
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from tests.oracles.as_shipped import ARM, HINGE


def test_good_placement_is_feasible():
    report = assess_placement(moved_hinge(ARM, HINGE))
    assert report.feasible
    assert report.plan.manifold.motion.degrees == 2
    assert report.plan.design.scaled_condition_number < 20.0
    assert report.plan.ranked[0].drives == (1, 5)
    assert report.plan.ranked[0].reach > 0.75
    reach_rad = report.plan.reach_rad
    assert np.all(reach_rad[:, 0] >= ARM.lower_rad)
    assert np.all(reach_rad[:, 1] <= ARM.upper_rad)
    assert np.ptp(reach_rad, axis=1).min() > np.deg2rad(20.0)
    assert set(report.sigma) >= {"theta_off_1", "a_0", "alpha_7"}


def test_refused_check_makes_a_placement_infeasible():
    report = assess_placement(moved_hinge(ARM, HINGE), poses=5, candidates=150)
    refused = SetupCheck(
        kind=CheckKind.AXIS_ANGLE, joint=7, severity=Severity.REFUSED, text="parallel"
    )
    assert report.feasible
    assert not replace(report, checks=(*report.checks, refused)).feasible


def test_placement_with_few_reachable_poses_is_infeasible():
    home = moved_hinge(ARM, HINGE).arm
    narrow = replace(
        home,
        joints=tuple(
            replace(j, lower_rad=q - 0.06, upper_rad=q + 0.06)
            for j, q in zip(home.joints, home.home_rad, strict=True)
        ),
    )
    assert assess_placement(moved_hinge(narrow, HINGE), poses=12) is None


@pytest.mark.campaign
def test_search_ranks_by_the_requested_parameter():
    placements = advise(ARM, HINGE, tries=3, best=6, parameters=("s_1",))
    assert [p.gain for p in placements] == sorted(p.gain for p in placements)
    current = next(p for p in placements if p.text == "as it is")
    assert current.gain == pytest.approx(1.0)
    for placement in placements:
        expected = placement.sigma["s_1"] / current.sigma["s_1"]
        assert placement.gain == pytest.approx(expected)
    assert placements[0].gain < 1.0
    assert "s_1 known to" in placements[0].text


@pytest.mark.campaign
def test_search_is_deterministic_and_refuses_unknown_parameters():
    first, second = (advise(ARM, HINGE, tries=1, poses=5) for _ in range(2))
    assert [p.text for p in first] == [p.text for p in second]
    with pytest.raises(SessionError, match="a_9"):
        advise(ARM, HINGE, tries=0, poses=5, parameters=("a_9",))


def test_printed_placement_closes_the_planned_loop():
    """With the offsets of the first and last joint."""
    mounted = moved_hinge(ARM, HINGE, tilt_rad=(0.3, -0.2), shift_m=(0.03, 0.02))
    report = assess_placement(mounted, poses=5, candidates=150)
    parameters = {p.name: p for p in mounted.hinge.model(mounted.arm).parameters}
    printed = advice_json((report,), parameters)[0]["placement"]
    fixture = replace(HINGE, **in_si(HingePlacement(**printed).model_dump()))
    loop = fixture.model(ARM)
    pose = close_loops(loop, nominal_vector(loop.parameters), mounted.arm.home_rad[None, :])
    assert pose.q[0] == pytest.approx(mounted.arm.home_rad, abs=1e-9)
    words = advice_text((report,), parameters, ARM.joint_count)
    for name in ("theta_off_1", "theta_off_7"):
        offset = np.rad2deg(mounted.hinge.model(ARM).table.theta_off_rad[int(name[-1])])
        assert f"{name} {offset:.1f}" in " ".join(words.split())
