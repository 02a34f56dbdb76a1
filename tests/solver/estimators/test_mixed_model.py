"""The mixed model against dense matrices: likelihood, covariance, budget, scores, poses held out."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector
from solver.diagnostics.hypothesis_tests import leave_one_out_chi2
from solver.estimators.effects import LinearModel, System
from solver.estimators.error_model import ErrorModel, stated_errors
from solver.estimators.linear_fit import LinearFit
from solver.estimators.shapes import pose_process
from tests.oracles.loop_oracle import Truth, paper_truth
from tests.oracles.shop_floor import LENGTHS
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of, paper_arm
from tests.solver.estimators.test_load_effects import basis

POSES = 12
SOFT = (*LENGTHS[:3], "alpha_2", "alpha_3")
TOLERANCE = {n: 2e-3 if n.startswith("alpha") else 5e-4 for n in SOFT}


def everything_stated(truth: Truth, q: np.ndarray) -> ErrorModel:
    arm = paper_arm(truth)
    joints = tuple(replace(j, backlash_rad=1e-4, sag_rad=2e-4) for j in arm.joints)
    errors = stated_errors(replace(arm, joints=joints), samples=np.full(len(q), 4))
    return replace(
        errors,
        endpoint_variance=np.repeat([1e-8, 4e-9], 3),
        accuracy_rad=np.array([2e-4] * 5 + [0.0] * 2),
        give_rad=3e-4,
        give_m=2e-4,
        tolerance=TOLERANCE,
        discrepancy=True,
        loads=basis(loop_of(truth), q, stated_deflection=(0.0, 0.0)),
    )


@pytest.fixture(scope="module")
def design():
    truth = paper_truth()
    model = loop_of(truth, names=(*NAMES, *SOFT))
    q = Simulation(poses=POSES).readings(0)
    return LinearModel(model, q, everything_stated(truth, q))


def system_of(design: LinearModel, w: np.ndarray) -> System:
    """Equations at the nominal values, the misclosures `w` (m, 5) in place of theirs."""
    x = nominal_vector(design.model.parameters)
    error = design.model.loop(x, design.q, design.model.initial_unsensed(x, design.q))
    # An orthonormal complement of the hinge's column, by another road than the solver's.
    E = np.stack([np.linalg.svd(N)[0][:, 1:] for N in error.jac_u])
    Et = np.swapaxes(E, -1, -2)
    return System(w=w, A=Et @ error.jac_x, B=Et @ error.jac_q, E=E, angle=design.q)


@pytest.fixture(scope="module")
def system(design):
    return system_of(design, np.random.default_rng(1).normal(size=(POSES, 5)) * 1e-3)


def variances(design: LinearModel) -> np.ndarray:
    rng = np.random.default_rng(2)
    return design.stated_variances() * rng.uniform(1.0, 3.0, len(design.components))


class Dense:
    """Everything as N x N matrices: noise blocks and effects added up, P by inversion."""

    def __init__(self, design: LinearModel, system: System, v: np.ndarray) -> None:
        m, r = system.w.shape
        self.w = system.w.reshape(-1)
        A = system.A.reshape(m * r, -1)
        self.A = A[:, design.flat_index]
        self.noise = np.zeros((m * r, m * r))
        S, F = np.split(design.noise_variance(v), [system.B.shape[-1]], axis=1)
        for i in range(m):
            here = slice(i * r, i * r + r)
            self.noise[here, here] = (system.B[i] * S[i]) @ system.B[i].T
            self.noise[here, here] += (system.E[i].T * F[i]) @ system.E[i]
        Z = [A[:, design.prior_index] * design.prior_sd]
        shapes = design.along_joints.at(system.angle, slice(0, m))
        for k, j in enumerate(design.along_joints.joint_of):
            Z.append((system.B[:, :, j] * shapes[:, k, None]).reshape(m * r, -1))
        phi = design.deflection_basis.phi
        for rows, _ in design.deflecting_rows:
            for row in range(rows.start, rows.stop):
                Z.append((system.E[:, row, :, None] * phi[:, None, :]).reshape(m * r, -1))
        self.Z = np.concatenate(Z, axis=1)
        self.size = design.group_variances(v)
        self.V = self.noise + (self.Z * self.size) @ self.Z.T
        W = np.linalg.inv(self.V)
        self.M = self.A.T @ W @ self.A
        self.P = W - W @ self.A @ np.linalg.solve(self.M, self.A.T @ W)

    @property
    def log_likelihood(self) -> float:
        log_det = np.linalg.slogdet(self.V)[1] + np.linalg.slogdet(self.M)[1]
        return float(-0.5 * (log_det + self.w @ self.P @ self.w))


def test_the_fit_agrees_with_dense_matrices(design, system):
    v = variances(design)
    fit, dense = LinearFit(design, system, v), Dense(design, system, v)
    P, w = dense.P, dense.w
    assert fit.chi2 == pytest.approx(w @ P @ w, rel=1e-8)
    assert fit.log_likelihood == pytest.approx(dense.log_likelihood, rel=1e-9)
    W = np.linalg.inv(dense.V)
    step = -np.linalg.solve(dense.M, dense.A.T @ W @ w)
    assert fit.change[design.flat_index] == pytest.approx(step, rel=1e-5, abs=1e-9)
    assert fit.b == pytest.approx(-dense.size * (dense.Z.T @ P @ w), rel=1e-5, abs=1e-10)
    flat = design.flat_index
    assert fit.covariance[np.ix_(flat, flat)] == pytest.approx(
        np.linalg.inv(dense.M), rel=1e-5, abs=1e-14
    )
    soft = dense.Z[:, : len(SOFT)]
    size = np.diag(dense.size[: len(SOFT)])
    of_soft = (size - size @ soft.T @ P @ soft @ size) * np.outer(design.prior_sd, design.prior_sd)
    where = design.prior_index
    assert fit.covariance[np.ix_(where, where)] == pytest.approx(of_soft, rel=1e-5, abs=1e-14)


def test_repeatability_and_budget_add_up(design, system):
    v = variances(design)
    fit, dense = LinearFit(design, system, v), Dense(design, system, v)
    gain = np.linalg.solve(dense.M, dense.A.T @ np.linalg.inv(dense.V))
    flat = design.flat_index
    assert fit.repeatability[np.ix_(flat, flat)] == pytest.approx(
        gain @ dense.noise @ gain.T, rel=1e-4, abs=1e-15
    )
    budget = fit.budget()
    assert set(budget) == {
        *("rvdt_noise_6", "rvdt_noise_7", "rvdt_curve_6", "rvdt_curve_7", "encoder_accuracy"),
        *("lengths", "twists", "fixture_give", "joint_play", "sag", "discrepancy", "counts"),
        "instrument",
    }
    assert all((share >= 0.0).all() for share in budget.values())
    assert sum(budget.values()) == pytest.approx(np.diagonal(fit.covariance), rel=1e-6)
    lengths = dense.Z[:, :3] * np.sqrt(dense.size[:3])
    assert budget["lengths"][flat] == pytest.approx(((gain @ lengths) ** 2).sum(-1), rel=1e-4)
    by_pose = gain.reshape(len(flat), POSES, 5).swapaxes(0, 1)
    counts = np.einsum("mj,mpj->p", design.errors.joint_variance, (by_pose @ system.B) ** 2)
    assert budget["counts"][flat] == pytest.approx(counts, rel=1e-4)
    measured = ((by_pose @ np.swapaxes(system.E, -1, -2)) ** 2).sum(
        0
    ) @ design.errors.endpoint_variance
    assert budget["instrument"][flat] == pytest.approx(measured, rel=1e-4)


def test_the_score_of_added_columns_is_right(design, system):
    fit = LinearFit(design, system, variances(design))
    dense = Dense(design, system, fit.v)
    G = np.random.default_rng(3).normal(size=(POSES, 5, 4))
    flat = G.reshape(-1, 4)
    s, information = fit.score(G)
    assert s == pytest.approx(flat.T @ dense.P @ dense.w, rel=1e-6)
    assert information == pytest.approx(flat.T @ dense.P @ flat, rel=1e-6)
    # A column that is fitted already explains nothing more.
    own, _ = fit.score(system.A[..., design.flat_index[:2]])
    size = np.abs(dense.A[:, :2].T @ np.linalg.inv(dense.V) @ dense.w)
    assert np.all(np.abs(own) < 1e-6 * size)


def assert_held_out_poses_are_predicted(fit: LinearFit, dense: Dense, out: np.ndarray) -> None:
    """Compare with generalised least squares on the rest, and its prediction."""
    rows = (out[:, None] * 5 + np.arange(5)).reshape(-1)
    rest = np.setdiff1d(np.arange(len(dense.w)), rows)
    V, A, w = dense.V, dense.A, dense.w
    inner = np.linalg.inv(V[np.ix_(rest, rest)])
    M = A[rest].T @ inner @ A[rest]
    x = -np.linalg.solve(M, A[rest].T @ inner @ w[rest])
    back = V[np.ix_(rows, rest)] @ inner
    predicted = -A[rows] @ x + back @ (w[rest] + A[rest] @ x)
    left = A[rows] - back @ A[rest]
    covariance = V[np.ix_(rows, rows)] - back @ V[np.ix_(rest, rows)]
    covariance = covariance + left @ np.linalg.solve(M, left.T)
    difference = w[rows] - predicted
    ((chi2, dof),) = fit.held_out_chi2(out)
    assert dof == len(rows)
    assert chi2 == pytest.approx(difference @ np.linalg.solve(covariance, difference), rel=1e-6)


def test_held_out_poses_are_predicted_by_the_others(design, system):
    fit = LinearFit(design, system, variances(design))
    assert_held_out_poses_are_predicted(fit, Dense(design, system, fit.v), np.array([2, 7]))
    (every,) = fit.parts()
    single = leave_one_out_chi2(fit.orthonormal(every), fit.residual(every))
    alone = fit.held_out_chi2(*np.arange(POSES)[:, None])
    assert single[0] == pytest.approx([chi2 for chi2, _ in alone], rel=1e-6)
    assert np.all(single[1] == 5)


def test_more_held_out_equations_than_columns_are_handled():
    poses, w = 30, np.random.default_rng(3).normal(size=(30, 5)) * 1e-4
    exact = ErrorModel(joint_variance=np.full((poses, 7), 1e-8))
    design = LinearModel(loop_of(paper_truth()), Simulation(poses=poses).readings(0), exact)
    system, v, out = system_of(design, w), np.zeros(0), np.arange(3, 3 + 12)
    assert 5 * len(out) > design.width
    fit, dense = LinearFit(design, system, v), Dense(design, system, v)
    assert_held_out_poses_are_predicted(fit, dense, out)


def test_the_score_is_the_gradient_of_the_likelihood(design, system):
    v = variances(design)
    result = LinearFit(design, system, v).derivatives
    for k, name in enumerate(c.name for c in design.components):
        h = 1e-4 * v[k] * np.eye(len(v))[k]
        up, down = (Dense(design, system, v + s * h).log_likelihood for s in (1.0, -1.0))
        assert result.score[k] * v[k] == pytest.approx((up - down) / 2e-4, rel=1e-3, abs=1e-4), name


def test_information_of_effects_and_cross_terms_is_right(design, system):
    v = variances(design)
    result = LinearFit(design, system, v).derivatives
    dense = Dense(design, system, v)
    names = [c.name for c in design.components]
    lengths, twists = dense.Z[:, :3], dense.Z[:, 3:5]
    parts = {"lengths": lengths @ lengths.T, "twists": twists @ twists.T}
    for one, A in parts.items():
        for other, B in parts.items():
            expected = 0.5 * np.trace(dense.P @ A @ dense.P @ B)
            value = result.information[names.index(one), names.index(other)]
            assert value == pytest.approx(expected, rel=1e-5)
    play = Dense(design, system, v + 1e-6 * np.eye(len(v))[names.index("joint_play")])
    rate = (play.V - dense.V) / 1e-6
    expected = 0.5 * np.trace(dense.P @ rate @ dense.P @ parts["lengths"])
    value = result.information[names.index("joint_play"), names.index("lengths")]
    assert value == pytest.approx(expected, rel=0.05)


def test_smooth_columns_span_their_process():
    q = Simulation(poses=40).readings(0)
    few, many = (pose_process(q, columns) for columns in (10, 100))
    assert few.phi.shape == (40, 10)
    assert np.all(few.missed >= 0.0)
    assert np.allclose(many.missed, 0.0, atol=1e-6)
    assert few.missed.mean() < 0.25 * (many.phi**2).sum(-1).mean()
    # Poses of another placement say nothing of this one.
    group = np.repeat([1, 2], 20)
    apart = pose_process(q, 100, group=group)
    assert np.allclose(apart.phi[:20] @ apart.phi[20:].T, 0.0, atol=1e-9)


def test_every_source_starts_at_its_stated_size_and_may_shrink(design):
    # Smooth or on one side all of it, and 0.4 of it new in every pose besides.
    starts = {c.name: c.start for c in design.components}
    assert starts["fixture_m"] == pytest.approx(0.4**2 * 2e-4**2)
    assert starts["fixture_rad"] == pytest.approx(0.4**2 * 3e-4**2)
    assert starts["joint_play"] == pytest.approx(0.4**2)
    v = design.start_variances()
    begins = {(g.source, g.variance(v)) for g in design.groups if not g.source.startswith("rvdt")}
    exact = {pair for pair in begins if pair[0] != "fixture_give"}
    assert exact == {
        (source, 1.0) for source in ("lengths", "twists", "encoder_accuracy", "joint_play", "sag")
    }
    gives = sorted(variance for source, variance in begins if source == "fixture_give")
    assert gives == pytest.approx([2e-4**2, 3e-4**2], rel=1e-3)
    shrinking = [c for c in design.components if c.scaled and c.name != "unmodelled"]
    assert all(c.floor < 2e-3 * c.start for c in shrinking)


def test_a_nan_fit_is_not_a_perfect_fit(design, system):
    v = variances(design)
    v[0] = np.nan
    try:
        fit = LinearFit(design, system, v)
    except np.linalg.LinAlgError:
        return
    assert np.isnan(fit.chi2)
