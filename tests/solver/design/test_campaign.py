from dataclasses import replace

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector
from solver.design.actions import Capture, GoTo, path_watch
from solver.design.campaign import Campaign
from solver.design.interim import implicit_interim
from solver.estimators.implicit import NoiseModel
from tests.oracles.simulated_loops import Simulation
from tests.solver.design.conftest import HOME, SIGMA, ClosedChain, paper_ranges


@pytest.fixture
def task(task):
    return replace(task, candidates=250)


def carry_out(task, x, *, stopped_moves: int):
    """The actions of a campaign of three poses; the first planned moves are stopped half-way.

    The loop is exact.
    """
    campaign = Campaign(task=task, start_rad=HOME, poses=3)
    chain, actions = ClosedChain(task.model, x), []
    while not actions or isinstance(actions[-1], GoTo | Capture):
        action = campaign.propose()
        actions.append(action)
        q = chain.q[0].copy()
        if isinstance(action, Capture):
            campaign.captured(q)
        elif isinstance(action, GoTo):
            share, stopped = 1.0, ""
            if action.trace_rad is not None and stopped_moves:
                share, stopped, stopped_moves = 0.5, "an obstacle", stopped_moves - 1
            targets = {j: q[j - 1] + share * (v - q[j - 1]) for j, v in action.targets_rad.items()}
            campaign.observe(chain.move(targets), stopped)
    return actions


@pytest.mark.campaign
def test_stopped_move_is_reversed_and_avoided(task, x):
    actions = carry_out(task, x, stopped_moves=1)
    reasons = [a.why for a in actions if isinstance(a, GoTo)]
    assert any("(an obstacle)" in reason for reason in reasons)
    assert actions[-1].complete


@pytest.mark.campaign
def test_campaign_fails_after_repeated_stops(task, x):
    actions = carry_out(task, x, stopped_moves=99)
    assert not actions[-1].complete
    assert actions[-1].text.endswith("repeatedly: an obstacle")


def test_observation_without_a_proposal_is_rejected(task):
    campaign = Campaign(task=task, start_rad=HOME, poses=1)
    with pytest.raises(ValueError, match="no move"):
        campaign.observe(HOME)
    campaign.propose()
    with pytest.raises(ValueError, match="no capture"):
        campaign.captured(HOME)


def test_interim_sigmas_include_fixture_compliance(loop, x):
    simulation = Simulation(poses=14, flexure_m=2e-3, flexure_rad=3e-3, wrist_sd=6e-3)
    estimate = implicit_interim(loop, NoiseModel(joint_variance=SIGMA**2))(simulation.readings(3))
    assert estimate.trusted
    deviation = np.abs(estimate.x - nominal_vector(loop.parameters)) / np.sqrt(
        np.diag(estimate.covariance)
    )
    assert deviation.max() < 6.0


def test_path_watch_names_joint_and_reason():
    ranges = paper_ranges()
    trace = HOME + np.linspace(0.0, 0.2, 5)[:, None] * np.array([1.0, 1, 1, 0, 1, 1, 1])
    watch = path_watch(trace, ranges)
    assert watch(trace[2]) is None
    deviating = trace[2].copy()
    deviating[3] += np.deg2rad(7.9)
    assert watch(deviating) is None
    deviating[3] += np.deg2rad(0.2)
    assert watch(deviating) == "joint 4 is 8.1 deg from its predicted angle"
    out_of_range = HOME.copy()
    out_of_range[2] = ranges.upper_rad[2] + 0.01
    assert watch(out_of_range) == "joint 3 came close to the end of its range"


def test_path_watch_allows_leaving_the_end_of_a_range():
    ranges = paper_ranges()
    q = HOME.copy()
    q[5] = ranges.lower_rad[5] - 0.01
    watch = path_watch(None, ranges)
    assert watch(q) is None
    q[5] += 0.005
    assert watch(q) is None
    q[5] -= 0.02
    assert "joint 6" in watch(q)
