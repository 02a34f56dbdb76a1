from dataclasses import replace

import numpy as np
import pytest

from fixtures.base import CheckKind, SetupCheck, Severity
from fixtures.hinge import Hinge, moved_hinge
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.errors import SessionError
from operator_app.planning.advice import advise, assess_placement
from solver.chain.arm_model import ArmModel


@pytest.fixture(scope="module")
def arm() -> ArmModel:
    return load_arm("sarcos_dextrous")


@pytest.fixture(scope="module")
def hinge() -> Hinge:
    fixture = load_fixture("hinge").fixture
    assert isinstance(fixture, Hinge)
    return fixture


def test_a_good_placement_is_judged_good(arm, hinge) -> None:
    report = assess_placement(moved_hinge(arm, hinge))
    assert report.feasible
    assert report.mobility == 2
    assert report.scaled_condition_number < 20.0
    assert report.drives[0].drives == (1, 5)
    assert np.all(report.reach_rad[:, 0] >= arm.lower_rad)
    assert np.all(report.reach_rad[:, 1] <= arm.upper_rad)
    assert np.ptp(report.reach_rad, axis=1).min() > np.deg2rad(20.0)
    assert set(report.sigma) >= {"theta_off_1", "a_0", "alpha_7"}


def test_a_refused_check_makes_it_unusable(arm, hinge) -> None:
    report = assess_placement(moved_hinge(arm, hinge), poses=5, candidates=150)
    refused = SetupCheck(
        kind=CheckKind.AXIS_ANGLE, joint=7, severity=Severity.REFUSED, text="parallel"
    )
    assert report.feasible
    assert not replace(report, checks=(*report.checks, refused)).feasible


def test_where_too_few_poses_can_be_reached_it_says_so(arm, hinge) -> None:
    home = moved_hinge(arm, hinge).arm
    narrow = replace(
        home,
        joints=tuple(
            replace(j, lower_rad=q - 0.06, upper_rad=q + 0.06)
            for j, q in zip(home.joints, home.home_rad, strict=True)
        ),
    )
    report = assess_placement(moved_hinge(narrow, hinge), poses=12)
    assert not report.feasible
    assert "no plan can be made" in report.text


@pytest.mark.campaign
def test_search_ranks_by_what_is_asked(arm, hinge) -> None:
    found = advise(arm, hinge, tries=3, best=6, parameters=("s_1",))
    assert [p.gain for p in found] == sorted(p.gain for p in found)
    here = next(p for p in found if p.text == "as it is")
    assert here.gain == pytest.approx(1.0)
    for placement in found:
        expected = placement.report.sigma["s_1"] / here.report.sigma["s_1"]
        assert placement.gain == pytest.approx(expected)
    assert found[0].gain < 1.0
    assert "s_1 known to" in found[0].text


@pytest.mark.campaign
def test_search_is_deterministic_and_knows_its_parameters(arm, hinge) -> None:
    first, again = (advise(arm, hinge, tries=1, poses=5) for _ in range(2))
    assert [p.text for p in first] == [p.text for p in again]
    with pytest.raises(SessionError, match="a_9"):
        advise(arm, hinge, tries=0, poses=5, parameters=("a_9",))
