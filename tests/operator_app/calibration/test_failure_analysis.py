"""Errors that explain an unidentifiable calibration: a sensor that does not follow its joint."""

from dataclasses import replace

import numpy as np
import pytest

from fixtures.ball import Ball
from operator_app.calibration.experiment import Experiment
from operator_app.calibration.failure_analysis import explain_unidentifiable, turned_unread
from operator_app.config.arm_file import load_arm
from operator_app.config.fixture_file import load_fixture
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.errors import PosesDoNotFitError, UnidentifiableDirection, UnidentifiableError
from solver.estimators.paper import estimate_paper
from tests.contracts.planted import ball
from tests.oracles.as_shipped import ARM, HINGE, poses_of, solved
from tests.oracles.shop_floor import session
from tests.oracles.shop_floor_misread import hysteresis


def closed_poses(arm, fixture, drives):
    """Closed poses at home and after drives moved by some degrees each; drives are exact."""
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    home = close_loops(model, x, arm.home_rad[None]).q
    sigma = np.ones(arm.joint_count)
    sigma[[j - 1 for j in drives]] = 0.0
    q = home.copy()
    for _ in range(10):
        for j, degrees in drives.items():
            q[0, j - 1] += np.deg2rad(degrees) / 10.0
        closed = close_loops(model, x, q, sigma_rad=sigma)
        assert closed.closed.all()
        q = closed.q
    return home[0], q[0]


def turned_joint(kind, drives, stuck=None):
    """The joint reported as turned, and the true angle of a stuck one, with a misplaced nominal fixture."""
    arm = load_arm("sarcos_dextrous" if kind == "hinge" else "franka_panda")
    fixture = load_fixture("hinge").fixture if kind == "hinge" else ball(arm)
    before, after = closed_poses(arm, fixture, drives)
    angle_rad = 0.0
    if stuck:
        angle_rad = after[stuck - 1] - before[stuck - 1]
        after[stuck - 1] = before[stuck - 1]
    if kind == "hinge":
        fixture = replace(fixture, a_0_m=fixture.a_0_m + (0.01 if stuck else 0.025))
    elif not stuck:
        fixture = replace(fixture, tip_m=(0.055, 0.0, 0.03))
    model = fixture.model(arm)
    x = nominal_vector(model.parameters)
    still = [j + 1 for j in np.flatnonzero(np.abs(after - before) < 1e-9)]
    return turned_unread(model, x, before, after, still), angle_rad


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
    turned, _ = turned_joint(kind, drives)
    assert turned is None or abs(turned[1]) < np.deg2rad(2.0), turned


@pytest.mark.parametrize(
    ("kind", "drives", "stuck"),
    [
        ("ball", {1: 0.0, 5: 8.0, 6: 4.0, 7: 0.0}, 5),
        ("ball", {1: 3.0, 5: 0.0, 6: 8.0, 7: 0.0}, 6),
        ("hinge", {1: 0.0, 5: 12.0}, 5),
        ("hinge", {1: 8.0, 5: 4.0}, 6),
        ("hinge", {1: 8.0, 5: 4.0}, 3),
        # Far apart: tangents would show no turn.
        ("hinge", {1: 30.0, 5: -25.0}, 4),
        ("hinge", {1: -25.0, 5: 30.0}, 6),
        ("ball", {1: 20.0, 5: -20.0, 6: 25.0, 7: 0.0}, 4),
    ],
)
def test_unread_joint_is_reported_with_its_angle(kind, drives, stuck):
    turned, angle_rad = turned_joint(kind, drives, stuck)
    assert turned == (stuck, pytest.approx(angle_rad, rel=0.3))


def test_held_joint_between_ball_poses_is_not_reported_as_turned():
    """Readings of a virtual Panda in a ball: joints 1, 5 and 7 were held while joint 6 moved by 12 deg."""
    arm = load_arm("franka_panda")
    ball = Ball(tip_m=(0.06, -0.03, 0.08), ground_m=(0.37053, -0.02121, 0.51028))
    before = np.deg2rad([-0.546, -38.605, -0.228, -127.102, -0.232, 75.992, 45.145])
    after = np.deg2rad([-0.544, -29.708, -0.013, -117.735, -0.232, 64.04, 45.145])
    model = ball.model(arm)
    x = nominal_vector(model.parameters)
    turned = turned_unread(model, x, before, after, [5, 7])
    assert turned is None or abs(turned[1]) < np.deg2rad(2.0), turned


def explanation_for(taken, *blind):
    unidentifiable = UnidentifiableError(
        (UnidentifiableDirection(parameters=blind, weights=(1.0,)),)
    )
    experiment = Experiment(arm=ARM, fixture=HINGE, poses=poses_of(taken))
    paper = estimate_paper(experiment.loop(), experiment.poses.q_rad)
    with pytest.raises(PosesDoNotFitError) as error:
        raise explain_unidentifiable(unidentifiable, experiment, paper, ())
    return str(error.value)


def test_hysteresis_is_named_instead_of_unidentifiable_parameters():
    taken = hysteresis(session(41), 6, 4.0)
    assert "the reading of joint 6 does not follow" in explanation_for(taken, "s_0", "s_7")


@pytest.mark.campaign
def test_open_loops_are_named_instead_of_unidentifiable_parameters():
    """Readings scatter by 2 degrees."""
    sound = session(8001)
    # The third draw gave unidentifiable parameters.
    *_, noise = np.random.default_rng(5).normal(size=(3, *sound.readings.shape))
    taken = replace(sound, readings=sound.readings + np.deg2rad(2.0) * noise)
    assert not solved(taken).accepted
    assert "no parameters close the loops better than 10.53 mm and" in explanation_for(
        taken, "theta_off_1"
    )
