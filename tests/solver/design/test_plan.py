from dataclasses import replace

import numpy as np
import pytest

from solver.closing import close_loops, reduced_equations
from solver.design.plan import MOST_UNCERTAIN_RAD, make_plan, prediction_sigma
from solver.design.stop_rule import standard_deviations
from tests.oracles.loop_oracle import closed_poses, cramer_rao, paper_truth
from tests.solver.conftest import NAMES
from tests.solver.design.conftest import HOME, SIGMA, information_of_captured_poses

WITHOUT_WRIST = [k for k, name in enumerate(NAMES) if name not in ("theta_off_6", "theta_off_7")]


@pytest.fixture(scope="module")
def quick(task):
    return replace(task, candidates=500)


@pytest.fixture(scope="module")
def plan(task, x):
    return make_plan(task, x, HOME, 20)


def test_twenty_planned_poses_are_well_conditioned(plan):
    assert plan.design.scaled_condition_number < 18.0
    assert plan.design.rank == 14
    assert len(set(plan.visits)) == 20
    assert plan.manifold.size > 2500


def test_planned_poses_are_in_range_and_reachable(plan, task):
    assert task.ranges.clearance(plan.poses_rad).min() >= np.deg2rad(3.0) - 1e-9
    assert plan.allowed[list(plan.visits)].all()
    assert plan.manifold.motion.leverage((1, 5))[list(plan.visits)].min() >= task.pose_leverage


@pytest.mark.campaign
def test_twelve_planned_poses_beat_sixty_random_ones(task, x):
    """Cramer-Rao bounds of the second implementation, random poses as the data sets have them."""
    truth = paper_truth()
    plan = make_plan(task, x, HOME, 12)
    u = plan.manifold.u[list(plan.visits)]
    planned = cramer_rao(truth, np.concatenate((u, plan.poses_rad), axis=1), NAMES, SIGMA**2)
    random = closed_poses(truth, np.random.default_rng(1), 60)
    unplanned = cramer_rao(truth, random, NAMES, SIGMA**2)
    ratio = np.sqrt(np.diag(planned) / np.diag(unplanned))[WITHOUT_WRIST]
    assert ratio.mean() < 0.85
    assert plan.predicted_sigma == pytest.approx(np.sqrt(np.diag(planned)), rel=1e-3)


@pytest.mark.campaign
def test_plan_includes_captured_poses(task, x, plan):
    first = plan.poses_rad[:10]
    more = make_plan(task, x, HOME, 10, captured=first)
    assert more.predicted_sigma == pytest.approx(plan.predicted_sigma, rel=0.15)
    again = information_of_captured_poses(task, x, np.concatenate((first, more.poses_rad)))
    assert standard_deviations(again, len(again)) == pytest.approx(more.predicted_sigma, rel=1e-4)


def test_poses_with_uncertain_prediction_are_not_planned(loop, x, quick):
    few = closed_poses(paper_truth(), np.random.default_rng(2), 5, spread_deg=8.0, box_deg=10.0)
    covariance = np.linalg.inv(information_of_captured_poses(quick, x, few[:, 1:])) * 4.0
    plan = make_plan(quick, x, HOME, 6, covariance=covariance)
    without_covariance = make_plan(quick, x, HOME, 6)
    assert plan.allowed.sum() < 0.9 * without_covariance.allowed.sum()
    at_poses = loop.loop(x, plan.poses_rad, plan.manifold.u[list(plan.visits)])
    reduced = reduced_equations(at_poses)
    sigma = prediction_sigma(reduced.A, reduced.B, covariance, (1, 5))
    assert sigma.max() <= MOST_UNCERTAIN_RAD


def test_prediction_sigma_agrees_with_random_parameters(loop, x, region):
    """Draw parameters, fix the drives, close the loop: the scatter of the free joints."""
    rng = np.random.default_rng(4)
    covariance = np.diag(np.full(14, 1e-4) ** 2)
    pose = 40
    q = region.q[pose : pose + 1]
    free = np.ones(7)
    free[[0, 4]] = 0.0
    displacement = []
    for _ in range(200):
        drawn = x + rng.multivariate_normal(np.zeros(14), covariance)
        displacement.append(close_loops(loop, drawn, q, sigma_rad=free).q[0] - q[0])
    reduced = reduced_equations(loop.loop(x, q, region.u[pose : pose + 1]))
    expected = prediction_sigma(reduced.A, reduced.B, covariance, (1, 5))[0]
    assert np.std(displacement, axis=0).max() == pytest.approx(expected, rel=0.2)


def test_plan_avoids_the_place_of_a_stopped_move(quick, x, plan):
    stopped_at = plan.poses_rad[3]
    other_plan = make_plan(quick, x, HOME, 8, avoid_rad=[stopped_at])
    assert np.linalg.norm(other_plan.poses_rad - stopped_at, axis=-1).min() > 0.15
