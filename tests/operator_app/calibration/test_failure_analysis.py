"""A sensor that reads no change while its joint turned, told from long moves in which the joint stood."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.ball import Ball
from fixtures.hinge import Hinge
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.failure_analysis import explain_unidentifiable, turned_unread
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from operator_app.messages.errors import words
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.errors import PosesDoNotFitError, UnidentifiableDirection, UnidentifiableError
from solver.estimators.paper import estimate_paper
from tests.contracts.planted import ball
from tests.oracles.as_shipped import ARM, HINGE, poses_of, solved
from tests.oracles.shop_floor import session
from tests.oracles.shop_floor_misread import hysteresis


def set_up(kind):
    if kind == "hinge":
        return load_arm("sarcos_dextrous"), load_fixture("hinge").fixture
    return load_arm("franka_panda"), ball(load_arm("franka_panda"))


def moved(arm, fixture, drives):
    """Closed poses at home and after drives have gone by some degrees each; drives stand where told."""
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    home = close_loops(model, x, arm.home_rad[None]).q
    sigma = np.ones(arm.joint_count)
    sigma[[j - 1 for j in drives]] = 0.0
    here = home.copy()
    for _ in range(10):
        for j, degrees in drives.items():
            here[0, j - 1] += np.deg2rad(degrees) / 10.0
        closed = close_loops(model, x, here, sigma_rad=sigma)
        assert closed.closed.all()
        here = closed.q
    return home[0], here[0]


@pytest.mark.parametrize(
    ("kind", "drives"),
    [
        ("ball", {1: 0.0, 5: 0.0, 6: -14.0, 7: 0.0}),
        ("ball", {1: 20.0, 5: -20.0, 6: 25.0, 7: 0.0}),
        ("ball", {1: -25.0, 5: 20.0, 6: -25.0, 7: 0.0}),
        ("hinge", {1: 0.0, 5: -40.0}),
        ("hinge", {1: 25.0, 5: 0.0}),
    ],
)
def test_stationary_drive_is_not_reported_as_turned(kind, drives):
    """Whatever the placement is nominally off by: here 25 mm, as a tape measure leaves it."""
    arm, fixture = set_up(kind)
    before, after = moved(arm, fixture, drives)
    if isinstance(fixture, Ball):
        fixture = replace(fixture, tip_m=(0.055, 0.0, 0.03))
    elif isinstance(fixture, Hinge):
        fixture = replace(fixture, a_0_m=fixture.a_0_m + 0.025)
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    still = [j for j, degrees in drives.items() if degrees == 0.0]
    found = turned_unread(model, x, before, after, still)
    assert found is None or abs(found[1]) < np.deg2rad(2.0), found


@pytest.mark.parametrize(
    ("kind", "drives", "stuck"),
    [
        ("ball", {1: 0.0, 5: 8.0, 6: 4.0, 7: 0.0}, 5),
        ("ball", {1: 3.0, 5: 0.0, 6: 8.0, 7: 0.0}, 6),
        ("hinge", {1: 0.0, 5: 12.0}, 5),
        ("hinge", {1: 8.0, 5: 4.0}, 6),
        ("hinge", {1: 8.0, 5: 4.0}, 3),
        # Far apart: as tangents have it nothing turned.
        ("hinge", {1: 30.0, 5: -25.0}, 4),
        ("hinge", {1: -25.0, 5: 30.0}, 6),
        ("ball", {1: 20.0, 5: -20.0, 6: 25.0, 7: 0.0}, 4),
    ],
)
def test_unread_joint_is_reported_with_its_angle(kind, drives, stuck):
    arm, fixture = set_up(kind)
    before, after = moved(arm, fixture, drives)
    true = after[stuck - 1] - before[stuck - 1]
    after[stuck - 1] = before[stuck - 1]
    if isinstance(fixture, Hinge):
        fixture = replace(fixture, a_0_m=fixture.a_0_m + 0.01)
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    still = [j + 1 for j in np.flatnonzero(np.abs(after - before) < 1e-9)]
    found = turned_unread(model, x, before, after, still)
    assert found[0] == stuck
    assert found[1] == pytest.approx(true, rel=0.3), np.rad2deg((found[1], true))


def test_held_joint_between_ball_poses_is_not_reported_as_turned():
    """Readings of a virtual Panda in a ball: joints 1, 5 and 7 were held while joint 6 went by 12 deg."""
    arm = load_arm("franka_panda")
    ball = Ball(tip_m=(0.06, -0.03, 0.08), ground_m=(0.37053, -0.02121, 0.51028))
    before = np.deg2rad([-0.546, -38.605, -0.228, -127.102, -0.232, 75.992, 45.145])
    after = np.deg2rad([-0.544, -29.708, -0.013, -117.735, -0.232, 64.04, 45.145])
    model = ball.model(arm)
    x = nominal_vector(model.parameters)
    found = turned_unread(model, x, before, after, [5, 7])
    assert found is None or abs(found[1]) < np.deg2rad(2.0), found


def test_remedy_of_a_stuck_sensor_is_not_more_poses():
    said = words(UnidentifiableError((), stuck_joint=3, note="its sensor is stuck"))
    assert "Repair that sensor" in said.remedy
    assert "differ" in words(UnidentifiableError(())).remedy


def why(found, *blind):
    """Said in place of the error that parameters cannot be identified from a session's poses."""
    error = UnidentifiableError((UnidentifiableDirection(parameters=blind, weights=(1.0,)),))
    stated = Experiment(arm=ARM, fixture=HINGE, poses=poses_of(found))
    paper = estimate_paper(stated.loop(), stated.poses.q_rad)
    with pytest.raises(PosesDoNotFitError) as caught:
        raise explain_unidentifiable(error, stated, paper, None)
    return str(caught.value)


def test_hysteresis_is_named_instead_of_unidentifiable_parameters():
    """Said was that s_7 cannot be told from s_0: at the values of the files these poses see every parameter."""
    found = hysteresis(session(41), 6, 4.0)
    assert "the reading of joint 6 does not follow" in why(found, "s_0", "s_7")


@pytest.mark.campaign
def test_open_loops_are_named_instead_of_unidentifiable_parameters():
    """Readings that scatter by 2 degrees: what an estimate that ended nowhere cannot see says nothing."""
    found = session(8001)
    # The third draw is the one that came out as parameters that cannot be seen.
    *_, noise = np.random.default_rng(5).normal(size=(3, *found.readings.shape))
    taken = replace(found, readings=found.readings + np.deg2rad(2.0) * noise)
    assert not solved(taken).accepted
    assert "no parameters close the loops better than 10.53 mm and" in why(taken, "theta_off_1")
