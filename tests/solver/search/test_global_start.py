"""Global search without an initial guess: solution, alternatives, reproducibility."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.kinematics import DhTable
from solver.chain.parameters import wrap_angle, wrap_angles
from solver.errors import TooFewPosesError
from solver.estimators.least_squares import solve_damped
from solver.estimators.paper import closure_problem
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop
from solver.loops.endpoints import BASE, TIP, MeasuredClosure, PointClosure
from solver.loops.placements import place
from solver.search.global_start import CLOSED, global_start
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.shop_floor_chain import Loop, nominal_chain
from tests.oracles.shop_floor_parallel import mount_hinge
from tests.oracles.wild_loops import random_hinge_problem, with_sensor_errors
from tests.solver.conftest import NAMES, entries


def model_without_initial_guess() -> DhLoop:
    truth = paper_truth()
    inner = np.array([0.0, 0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    alpha = truth.alpha * np.array([0.0, 1.0, 1.0, 1.0, 1.0, 1.0, 1.0, 0.0])
    return DhLoop(
        table=DhTable(
            theta_off_rad=np.zeros(8), s_m=truth.s * inner, a_m=np.zeros(8), alpha_rad=alpha
        ),
        entries=entries(NAMES),
        hinge=True,
    )


def distance_to_minimum(model: DhLoop, x: np.ndarray, start: np.ndarray, q: np.ndarray) -> float:
    """Largest difference of `x` from the minimum that is reached from `start`."""
    minimum = nearest_equivalent(model, solve_damped(closure_problem(model, q), start).x, x)
    return float(np.abs(wrap_angles(model.parameters, minimum - x)).max())


@pytest.mark.sample(1)
@pytest.mark.parametrize("seed", range(1, 6))
def test_offsets_and_hinge_are_recovered(seed):
    problem = random_hinge_problem(seed)
    solution = global_start(model_without_initial_guess(), problem.q, starts=300)
    assert solution.best.rms < 1e-12
    error = wrap_angle(solution.x[1:6] - problem.offsets[1:6])
    assert np.abs(error).max() < 1e-9
    assert not solution.best.flipped
    assert solution.alternatives == ()
    assert 10 < solution.best.starts <= solution.starts


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [100, 101])
def test_search_with_sensor_errors_ends_in_the_minimum_at_the_truth(seed):
    problem = random_hinge_problem(seed)
    q = with_sensor_errors(problem.q, seed)
    model = model_without_initial_guess()
    solution = global_start(model, q, starts=300)
    exact = global_start(model, problem.q, starts=300).x
    assert distance_to_minimum(model, solution.x, exact, q) < 1e-6


def test_constant_elbow_angle_gives_two_solutions():
    problem = random_hinge_problem(3, still=(4,))
    solution = global_start(model_without_initial_guess(), problem.q)
    assert len(solution.alternatives) == 1
    assert solution.best.rms < CLOSED
    solutions = [solution.best, *solution.alternatives]
    elbow = problem.q[0, 3]
    bends = [float(wrap_angle(b.x[3] + elbow)) for b in solutions]
    assert bends[0] == pytest.approx(-bends[1], abs=1e-8)
    assert min(abs(b - float(wrap_angle(problem.offsets[3] + elbow))) for b in bends) < 1e-8


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [1, 2])
def test_poses_with_a_reversed_hinge_are_excluded(seed):
    problem = random_hinge_problem(seed, upside_down=4)
    q = np.roll(problem.q, 10, axis=0)
    solution = global_start(model_without_initial_guess(), q, starts=300)
    assert solution.set_aside == (6, 7, 8, 9)
    assert solution.best.rms < 1e-12
    assert np.abs(wrap_angle(solution.x[1:6] - problem.offsets[1:6])).max() < 1e-9


def test_search_is_reproducible_and_independent_of_pose_order():
    problem = random_hinge_problem(6)
    first = global_start(model_without_initial_guess(), problem.q, starts=60)
    again = global_start(model_without_initial_guess(), problem.q, starts=60)
    np.testing.assert_array_equal(first.x, again.x)
    assert first.best.starts == again.best.starts
    reordered = global_start(model_without_initial_guess(), problem.q[::-1], starts=60)
    np.testing.assert_allclose(reordered.x, first.x, rtol=0, atol=1e-11)
    assert reordered.best.starts == first.best.starts


def test_unsensed_joints_start_from_their_readings():
    problem = random_hinge_problem(7)
    model = model_without_initial_guess()
    wrist_offsets = ("theta_off_6", "theta_off_7")
    unsensed = replace(
        model,
        entries=tuple(e for e in model.entries if e.name not in wrist_offsets),
        unsensed_joints=(6, 7),
    )
    solution = global_start(unsensed, problem.q, starts=100)
    expected = dict(zip(NAMES, global_start(model, problem.q, starts=100).x, strict=True))
    np.testing.assert_array_equal(solution.x, [expected[p.name] for p in unsensed.parameters])


def ball_in_socket(offsets: np.ndarray, home: np.ndarray) -> tuple[PointClosure, np.ndarray]:
    """A ball on the paper's arm, and readings (40, 7) with the ball in its socket."""
    chain, home = mount_hinge(nominal_chain(), home)
    theta = home + np.random.default_rng(9).uniform(-0.8, 0.8, (40, 8))
    theta, closes = Loop(chain=chain, rows=(3, 4, 5)).closed(theta, free=tuple(range(1, 8)))
    assert closes.all()
    # What is beyond the last joint and below the first is searched for.
    s, a, alpha = (np.concatenate(([0.0], c[2:7], [0.0])) for c in (chain.s, chain.a, chain.alpha))
    alpha[0] = chain.alpha[1]
    model = PointClosure(
        table=DhTable(theta_off_rad=np.zeros(7), s_m=s, a_m=a, alpha_rad=alpha),
        entries=entries([f"theta_off_{j}" for j in range(2, 7)]),
        tip_m=np.zeros(3),
        ground_m=np.zeros(3),
    )
    return model, theta[:, 1:] - offsets


def test_two_placements_of_a_ball_are_recovered():
    offsets = np.random.default_rng(8).uniform(-np.pi, np.pi, 7)
    homes = np.deg2rad([[20, 50, -30, 80, 40, -60, 10], [-60, 80, 10, 60, -70, 40, 90]])
    (model, first), (_, second) = (ball_in_socket(offsets, home) for home in homes)
    placements = place(model, np.repeat([1, 2], [40, 15]), same_hand=True)
    q = np.concatenate((first, second[:15]))
    solution = global_start(placements, q, starts=300)
    assert solution.best.rms < 1e-12
    assert np.abs(wrap_angle(solution.x[:5] - offsets[1:6])).max() < 1e-9


def test_measured_endpoint_parameters_are_searched_together():
    truth = paper_truth()
    rng = np.random.default_rng(10)
    table = DhTable(
        theta_off_rad=np.zeros(7), s_m=truth.s[1:], a_m=truth.a[1:], alpha_rad=truth.alpha[1:]
    )
    model = MeasuredClosure(
        table=table,
        entries=entries([f"theta_off_{j}" for j in range(2, 7)]),
        base_m=np.zeros(3),
        base_rotation=np.eye(3),
        tip_m=np.zeros(3),
        tip_rotation=np.eye(3),
        own=BASE + TIP,
        full_pose=False,
    )
    q = rng.uniform(-1.2, 1.2, (25, 7))
    x = np.concatenate(
        (rng.uniform(-np.pi, np.pi, 5), [0.5, 0.2, -0.1, 0.1, -0.2, 0.3, 0.02, 0.05, 0.08])
    )
    model = model.with_endpoints(model.predicted(x, q)[0])
    solution = global_start(model, q, starts=200)
    assert solution.best.rms < 1e-11
    assert np.abs(wrap_angles(model.parameters, solution.x - x)).max() < 1e-8


def test_progress_callback_cancels_the_search():
    def progress(iteration: int, cost: float) -> None:
        if iteration == 3:
            raise InterruptedError

    with pytest.raises(InterruptedError):
        global_start(
            model_without_initial_guess(), random_hinge_problem(0).q, starts=20, progress=progress
        )


def test_too_few_poses_are_rejected():
    with pytest.raises(TooFewPosesError):
        global_start(model_without_initial_guess(), random_hinge_problem(0).q[:2])
