"""Calibration from nothing: the right loop is found, a second one is told, nothing depends on luck."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.kinematics import DhTable
from solver.chain.parameters import entries, wrap_angle, wrap_angles
from solver.errors import TooFewPosesError
from solver.estimators.least_squares import solve_damped
from solver.estimators.paper import closure_problem
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop
from solver.loops.open_arm import BASE, TIP_POINT, MeasuredClosure
from solver.loops.placements import place
from solver.loops.point import PointClosure
from solver.search.global_start import CLOSED, global_start
from tests.oracles.loop_oracle import paper_truth, product
from tests.oracles.wild_loops import wild_problem, with_sensors
from tests.solver.conftest import NAMES, loop_of, read_poses


def nothing_known() -> DhLoop:
    """The arm's lengths and twists; every unknown nominally zero."""
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


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    "seed", [0, 1, *(pytest.param(s, marks=pytest.mark.campaign) for s in range(2, 5))]
)
def test_offsets_anywhere_and_hinge_unknown(seed):
    problem = wild_problem(seed)
    found = global_start(nothing_known(), problem.q, starts=300)
    assert found.best.rms < 1e-12
    off = wrap_angle(found.x[1:6] - problem.offsets[1:6])
    assert np.abs(off).max() < 1e-9
    assert not found.best.flipped
    assert found.alternatives == ()
    assert 10 < found.best.starts <= found.starts


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [100, 101])
def test_real_sensors_do_not_mislead_the_search(seed):
    problem = wild_problem(seed)
    q = with_sensors(problem.q, seed)
    model = nothing_known()
    found = global_start(model, q, starts=300)
    exact = global_start(model, problem.q, starts=300).x
    # The same minimum as from the true parameters.
    from_truth = nearest_equivalent(
        model, solve_damped(closure_problem(model, q), exact).x, found.x
    )
    assert np.abs(wrap_angles(model.parameters, from_truth - found.x)).max() < 1e-6


def test_the_paper_arm_from_nothing(hinge_data, truth):
    q = read_poses(hinge_data / "hinge_exact.csv")
    found = global_start(nothing_known(), q)
    model = loop_of(truth)
    x = nearest_equivalent(model, found.x, truth.values(NAMES))
    off = wrap_angles(model.parameters, x - truth.values(NAMES))
    assert np.abs(off).max() < 1e-8


def test_an_elbow_that_stands_still_may_be_bent_either_way():
    problem = wild_problem(3, still=(4,))
    found = global_start(nothing_known(), problem.q, starts=300)
    assert len(found.alternatives) == 1
    assert found.best.rms < CLOSED
    solutions = [found.best, *found.alternatives]
    elbow = problem.q[0, 3]
    bends = [float(wrap_angle(b.x[3] + elbow)) for b in solutions]
    assert bends[0] == pytest.approx(-bends[1], abs=1e-8)
    assert min(abs(b - float(wrap_angle(problem.offsets[3] + elbow))) for b in bends) < 1e-8


@pytest.mark.campaign
@pytest.mark.parametrize("seed", [1, 2])
def test_a_hand_put_on_the_other_way_round_is_set_aside(seed):
    problem = wild_problem(seed, upside_down=4)
    q = np.roll(problem.q, 10, axis=0)
    found = global_start(nothing_known(), q, starts=300)
    assert found.set_aside == (6, 7, 8, 9)
    assert found.best.rms < 1e-12
    assert np.abs(wrap_angle(found.x[1:6] - problem.offsets[1:6])).max() < 1e-9


def test_the_same_seed_gives_the_same_result_and_order_does_not_matter():
    problem = wild_problem(6)
    first = global_start(nothing_known(), problem.q, starts=60, seed=4)
    again = global_start(nothing_known(), problem.q, starts=60, seed=4)
    np.testing.assert_array_equal(first.x, again.x)
    assert first.best.starts == again.best.starts
    other = global_start(nothing_known(), problem.q[::-1], starts=60, seed=4)
    np.testing.assert_allclose(other.x, first.x, rtol=0, atol=1e-11)
    assert other.best.starts == first.best.starts


def test_an_unsensed_wrist_may_start_from_its_readings():
    problem = wild_problem(7)
    model = nothing_known()
    lost = ("theta_off_6", "theta_off_7")
    unsensed = replace(
        model, entries=tuple(e for e in model.entries if e.name not in lost), unsensed_joints=(6, 7)
    )
    found = global_start(unsensed, problem.q, starts=100)
    whole = dict(zip(NAMES, global_start(model, problem.q, starts=100).x, strict=True))
    np.testing.assert_array_equal(found.x, [whole[p.name] for p in unsensed.parameters])


def ball(offsets: np.ndarray, home: np.ndarray) -> tuple[PointClosure, np.ndarray]:
    """A ball on the paper's arm, and 40 poses that hold it, by Newton's method."""
    truth = paper_truth()
    s, a, alpha = truth.s[1:].copy(), truth.a[1:].copy(), truth.alpha[1:].copy()
    rng = np.random.default_rng(9)
    tip = np.array([0.03, -0.05, 0.1, 1.0])
    ground = (product(home, s, a, alpha) @ tip)[:3]
    theta = home + rng.uniform(-0.8, 0.8, (40, 7))
    h = 1e-30
    for _ in range(40):
        place_now = (product(theta, s, a, alpha) @ tip)[:, :3]
        J = np.stack(
            [
                (product(theta + 1j * h * np.eye(7)[j], s, a, alpha) @ tip)[:, :3].imag / h
                for j in range(7)
            ],
            axis=-1,
        )
        step = (np.linalg.pinv(J) @ (place_now - ground)[..., None])[..., 0]
        theta -= step * np.minimum(1.0, 0.3 / np.abs(step).max(-1, keepdims=True).clip(1e-300))
    assert np.abs((product(theta, s, a, alpha) @ tip)[:, :3] - ground).max() < 1e-12
    model = PointClosure(
        table=DhTable(theta_off_rad=np.zeros(7), s_m=s, a_m=a, alpha_rad=alpha),
        entries=entries([f"theta_off_{j}" for j in range(2, 7)]),
        tip_m=np.zeros(3),
        ground_m=np.zeros(3),
    )
    return model, theta - offsets


def test_a_ball_from_nothing():
    rng = np.random.default_rng(8)
    offsets = rng.uniform(-np.pi, np.pi, 7)
    model, q = ball(offsets, np.deg2rad([20.0, 50.0, -30.0, 80.0, 40.0, -60.0, 10.0]))
    found = global_start(model, q, starts=400)
    assert found.best.rms < 1e-12
    assert np.abs(wrap_angle(found.x[:5] - offsets[1:6])).max() < 1e-9
    assert found.alternatives == ()


def test_placements_from_nothing():
    rng = np.random.default_rng(8)
    offsets = rng.uniform(-np.pi, np.pi, 7)
    homes = np.deg2rad([[20, 50, -30, 80, 40, -60, 10], [-60, 80, 10, 60, -70, 40, 90]])
    (model, first), (_, second) = (ball(offsets, home) for home in homes)
    whole = place(model, np.repeat([1, 2], [40, 15]), same_hand=True)
    q = np.concatenate((first, second[:15]))
    found = global_start(whole, q, starts=300)
    assert found.best.rms < 1e-12
    assert np.abs(wrap_angle(found.x[:5] - offsets[1:6])).max() < 1e-9


def test_a_fixture_that_cannot_be_projected_out_is_searched_whole():
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
        own=BASE + TIP_POINT,
        full_pose=False,
    )
    q = rng.uniform(-1.2, 1.2, (25, 7))
    x = np.concatenate(
        (rng.uniform(-np.pi, np.pi, 5), [0.5, 0.2, -0.1, 0.1, -0.2, 0.3, 0.02, 0.05, 0.08])
    )
    model = model.with_endpoints(model.predicted(x, q)[0])
    found = global_start(model, q, starts=200)
    assert found.best.rms < 1e-11
    assert np.abs(wrap_angles(model.parameters, found.x - x)).max() < 1e-8


def test_progress_may_cancel():
    class Cancelled(Exception):
        pass

    def progress(iteration: int, cost: float) -> None:
        if iteration == 3:
            raise Cancelled

    with pytest.raises(Cancelled):
        global_start(nothing_known(), wild_problem(0).q, starts=20, progress=progress)


def test_what_is_no_problem_is_refused():
    q = wild_problem(0).q
    with pytest.raises(TooFewPosesError):
        global_start(nothing_known(), q[:2])
    with pytest.raises(ValueError, match="start"):
        global_start(nothing_known(), q, starts=0)
