from itertools import combinations

import numpy as np
import pytest

from solver.design.d_optimal import gains, log_det, pose_information
from tests.oracles.loop_oracle import information, paper_truth
from tests.solver.design.conftest import SIGMA, choose_poses, of_noise

TRUTH = paper_truth()


def exhaustive(root: np.ndarray, count: int, fixed: np.ndarray | None = None) -> float:
    """Largest log det over all subsets, by plain determinants."""
    best = -np.inf
    for chosen in combinations(range(len(root)), count):
        rows = root[list(chosen)].reshape(-1, root.shape[-1])
        best = max(best, np.linalg.slogdet(rows.T @ rows + (0 if fixed is None else fixed))[1])
    return float(best)


def value(root: np.ndarray, chosen: tuple[int, ...], fixed: np.ndarray | float = 0.0) -> float:
    rows = root[list(chosen)].reshape(-1, root.shape[-1])
    return log_det(rows.T @ rows + fixed)


def efficiency(first: float, second: float, parameters: int) -> float:
    """D-efficiency of a design of log det `first` against `second`: 0.5 needs twice the poses."""
    return float(np.exp((first - second) / parameters))


@pytest.mark.parametrize("seed", range(6))
def test_exchange_is_near_exhaustive_search(seed):
    root = np.random.default_rng(seed).normal(size=(16, 2, 6))
    best = exhaustive(root, 5)
    assert efficiency(value(root, choose_poses(root, 5)), best, 6) > 0.99


def test_choice_depends_on_captured_poses():
    root = np.random.default_rng(1).normal(size=(15, 2, 6))
    # All but the last two parameters are known.
    fixed = np.diag([1e4] * 4 + [0.0] * 2)
    chosen = choose_poses(root, 3, fixed=fixed)
    assert value(root, chosen, fixed) == pytest.approx(exhaustive(root, 3, fixed), abs=0.03)
    assert set(chosen) != set(choose_poses(root, 3))


def test_gain_is_the_change_of_the_log_determinant():
    rng = np.random.default_rng(2)
    root = rng.normal(size=(40, 3, 5))
    M = np.cov(rng.normal(size=(5, 30)))
    direct = [log_det(M + F.T @ F) - log_det(M) for F in root]
    assert gains(root, M, 5) == pytest.approx(np.array(direct), abs=1e-11)


def with_effects(parameters: int, effects: int, seed: int = 0) -> np.ndarray:
    root = np.random.default_rng(seed).normal(size=(16, 2, parameters + effects))
    # Half of the candidates are more sensitive to the parameters, but confound them with the effects.
    root[:8, :, :parameters] = 3.0 * root[:8, :, parameters : 2 * parameters]
    root[:8, :, parameters : 2 * parameters] *= 30.0
    return root


@pytest.mark.parametrize("seed", range(4))
def test_choice_ignores_information_of_effects(seed):
    P, K = 3, 4
    root = with_effects(P, K, seed)
    log_det_of_parameters = {}
    for chosen in combinations(range(16), 4):
        rows = root[list(chosen)].reshape(-1, P + K)
        joint = np.linalg.inv(rows.T @ rows + np.diag([0.0] * P + [1.0] * K))
        log_det_of_parameters[chosen] = -np.linalg.slogdet(joint[:P, :P])[1]
    chosen = choose_poses(root, 4, parameters=P)
    assert (
        efficiency(
            log_det_of_parameters[tuple(sorted(chosen))], max(log_det_of_parameters.values()), P
        )
        > 0.99
    )
    assert set(chosen) != set(choose_poses(root[..., :P], 4))


def test_choice_is_independent_of_units(pose_data):
    units = np.geomspace(1e-3, 1e3, len(pose_data.parameters))
    assert choose_poses(pose_data.root * units, 8) == choose_poses(pose_data.root, 8)


def test_chosen_poses_have_the_requested_distance(region, pose_data):
    def smallest_gap(chosen: tuple[int, ...]) -> float:
        q = region.q[list(chosen)]
        return np.linalg.norm(q[:, None] - q[None], axis=-1)[~np.eye(12, dtype=bool)].min()

    assert smallest_gap(choose_poses(pose_data.root, 12, q=region.q, apart_rad=0.3)) >= 0.3
    assert smallest_gap(choose_poses(pose_data.root, 12)) < 0.3


def test_only_allowed_poses_are_chosen(pose_data):
    allowed = np.zeros(len(pose_data.root), dtype=bool)
    allowed[::7] = True
    assert set(choose_poses(pose_data.root, 9, allowed=allowed)) <= set(np.flatnonzero(allowed))
    with pytest.raises(ValueError, match="9 poses requested, but there are only 0"):
        choose_poses(pose_data.root, 9, allowed=np.zeros(len(pose_data.root), dtype=bool))


def assert_agrees(information: np.ndarray, expected: np.ndarray, tolerance: float) -> None:
    sigma = np.sqrt(np.diag(expected))
    scale = np.outer(sigma, sigma)
    assert information / scale == pytest.approx(expected / scale, abs=tolerance)


def test_information_agrees_with_the_oracle(region, pose_data):
    poses = [0, 5, 50, 200, 400, 700]
    angles = np.concatenate((region.u[poses], region.q[poses]), axis=1)
    expected = information(TRUTH, angles, pose_data.parameters, SIGMA**2)
    assert_agrees(pose_data.of(poses), expected, 1e-7)


def test_noisy_joints_count_as_unsensed(loop, x, region):
    poses = [0, 5, 50, 200, 400, 700, 900]
    q, sigma = region.q[poses], SIGMA.copy()
    sigma[5:] = 1.0
    data = pose_information(loop, x, q, q, region.u[poses], of_noise(sigma)(q))
    names = [n for n in data.parameters if n not in ("theta_off_6", "theta_off_7")]
    angles = np.concatenate((region.u[poses], region.q[poses]), axis=1)
    expected = information(TRUTH, angles, names, SIGMA**2, unsensed=(6, 7))
    assert_agrees(data.about(names).of(range(len(poses))), expected, 1e-4)


def test_joints_without_noise_are_rejected(loop, x, region):
    q = region.q[:2]
    with pytest.raises(ValueError, match="have no noise"):
        pose_information(loop, x, q, q, region.u[:2], of_noise(np.zeros(7))(q))
