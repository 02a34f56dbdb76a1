"""Deflection under load: static equilibrium by central differences, covariances by draws."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector
from solver.chain.rotations import rotation_about_z
from solver.chain.statics import LinkMasses
from solver.closing import left_null_space
from solver.estimators.compliance import (
    WISHART_DOF,
    FixtureLoads,
    compliance_sizes,
    covariance,
    variance,
)
from solver.estimators.load_effects import LoadBasis, driven_sets, load_basis, wrench_of
from solver.loops.dh import DhLoop
from solver.loops.endpoints import PointClosure
from solver.loops.placements import place
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.pinocchio_chain import PinocchioGravity
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import loop_of, paper_arm

POSES = 12
GIVE = (3e-4, 2e-4)
MASSES = LinkMasses(
    mass_kg=np.array([2.0, 1.0, 4.0, 1.0, 2.5, 0.5, 1.5]),
    centre_m=np.array([[0, 0, 0.0]] * 2 + [[0, 0, 0.18], [0, 0, 0], [0, 0, 0.16], [0, 0, 0], [0.05, 0, 0]]),
    mass_sd_kg=0.2 * np.array([2.0, 1.0, 4.0, 1.0, 2.5, 0.5, 1.5]),
    centre_sd_m=np.full(7, 0.015),
    down=np.array([-1.0, 0.0, 0.0]),
    down_sd_rad=0.05,
)  # fmt: skip


@pytest.fixture(scope="module")
def model():
    return loop_of(paper_truth())


@pytest.fixture(scope="module")
def q():
    return Simulation(poses=POSES).readings(0)


def basis(model, q, masses=MASSES, **options) -> LoadBasis:
    x = nominal_vector(model.parameters)
    u = model.initial_unsensed(x, q)
    return load_basis(model, x, q, u, masses, **{"stated_deflection": GIVE, **options})


def falling_torque(model: DhLoop, q: np.ndarray, masses: LinkMasses) -> np.ndarray:
    """Torques (m, 7) with which the links would fall, by pinocchio."""
    offsets, s, a, alpha, _ = model.arm_rows()
    oracle = PinocchioGravity(masses.mass_kg, masses.centre_m, 9.81 * masses.down)
    return -np.array([oracle.holding_torque(p + offsets, s, a, alpha) for p in q])


def test_free_joints_are_in_equilibrium_without_hinge_moment(model, q):
    """Virtual work by central differences of the closure: no Jacobian of the subject is used."""
    x = nominal_vector(model.parameters)
    u = model.initial_unsensed(x, q)
    rng = np.random.default_rng(0)
    torque = rng.normal(size=(POSES, 7, 2))
    error = model.loop(x, q, u)
    free = [1, 2, 3, 5, 6]
    F = wrench_of(
        error.jac_q[..., free], left_null_space(error.jac_u), torque[:, free], friction_m=1e-6
    )
    assert F.shape == (POSES, 6, 2)
    for j in free:
        step = 1e-6 * np.eye(7)[j]
        rate = (model.loop(x, q + step, u).residual - model.loop(x, q - step, u).residual) / 2e-6
        work = np.einsum("mk,mkc->mc", rate, F) + torque[:, j]
        assert np.abs(work).max() < 1e-4 * np.abs(torque).max()
    about = model.loop(x, q, u + 1e-6).residual - model.loop(x, q, u - 1e-6).residual
    assert np.abs(np.einsum("mk,mkc->mc", about / 2e-6, F)).max() < 1e-6 * np.abs(F).max()


def test_friction_keeps_the_wrench_finite_at_a_singularity(model, q):
    x = nominal_vector(model.parameters)
    error = model.loop(x, q, model.initial_unsensed(x, q))
    folded = error.jac_q[..., [1, 2, 3, 5, 6]].copy()
    folded[..., 4] = folded[..., 3]
    torque = np.zeros((POSES, 5, 1))
    torque[:, 3], torque[:, 4] = 1.0, -1.0
    F = wrench_of(folded, left_null_space(error.jac_u), torque, friction_m=0.1)
    assert np.abs(F).max() < 1e-9 / 0.1 + 1.0 / 0.1


def test_the_number_of_driven_joints_is_the_mobility():
    assert all(len(set(s)) == 2 and max(s) < 7 for s in driven_sets(7, 5))
    assert len(driven_sets(7, 5)) == len(set(driven_sets(7, 5))) > 5
    assert driven_sets(7, 7) == [()]
    assert {len(s) for s in driven_sets(7, 3)} == {4}


def test_displacements_have_the_covariance_of_wishart_compliances():
    rng = np.random.default_rng(1)
    m, a, count = 2, 3, 40_000
    s = compliance_sizes((2.0, 3.0), rotations=3)
    wrench = rng.normal(size=(m, 6, a))
    angle = np.array([0.3, -0.8])
    turn = np.zeros((m, 6, 6))
    turn[:, :3, :3] = turn[:, 3:, 3:] = rotation_about_z(angle)
    pulled = FixtureLoads(pull=wrench * s[:, None], halves=((0.7, turn),))
    root = rng.normal(size=(count, 6, int(WISHART_DOF)))
    M = root @ np.swapaxes(root, -1, -2) / WISHART_DOF
    z = rng.normal(size=(count, a))
    own = np.einsum("mki,mka,na->nmi", turn, wrench, z)
    moved = np.einsum("i,nij,j,nmj->nmi", s, M, s, own)
    drawn = 0.7 * np.einsum("mij,nmj->nmi", turn, moved).reshape(count, -1)
    expected = drawn.T @ drawn / count
    result = covariance(pulled, pulled, s)
    scale = np.sqrt(np.outer(np.diagonal(expected), np.diagonal(expected)))
    assert np.abs((result - expected) / scale).max() < 0.05
    assert variance(pulled, s).reshape(-1) == pytest.approx(np.diagonal(result), rel=1e-10)


@pytest.mark.parametrize(
    "stated_deflection", [(1.0, 1.0), (5e-4, 1e-4), (1e-4, 8e-4), (0.0, 2e-4), (2e-4, 0.0)]
)
def test_compliance_sizes_reproduce_the_stated_deflection(stated_deflection):
    wrench = np.random.default_rng(2).normal(size=(400, 6, 5))
    for rows in (slice(0, 3), slice(3, 6)):
        wrench[:, rows] /= np.sqrt((wrench[:, rows] ** 2).sum((1, 2)).mean())
    s = compliance_sizes(stated_deflection, rotations=3)
    size = variance(FixtureLoads(pull=wrench * s[:, None], halves=((1.0, None),)), s).mean(0)
    assert size[:3].mean() == pytest.approx(stated_deflection[0] ** 2, rel=1e-9)
    assert size[3:].mean() == pytest.approx(stated_deflection[1] ** 2, rel=1e-9)


def test_columns_and_missed_variance_add_up_to_the_stated(model, q):
    few, many = basis(model, q, deflection_columns=5), basis(model, q, deflection_columns=60)
    for result in (few, many):
        total = (result.deflection_at() ** 2).sum(-1) + result.deflection_missed
        assert total[:, :3].mean() == pytest.approx(1.0, rel=1e-6)
        assert total[:, 3:].mean() == pytest.approx(1.0, rel=1e-6)
        twist = (
            result.joints.expected**2 + (result.joints.columns**2).sum(-1) + result.joints.missed
        )
        assert twist.mean(0) == pytest.approx(np.ones(7), rel=1e-9)
    assert many.deflection_missed.max() < 0.02 < few.deflection_missed.mean()


def test_other_masses_within_tolerance_lie_in_the_columns(model, q):
    rng = np.random.default_rng(4)
    result = basis(model, q)
    for _ in range(10):
        other = replace(
            MASSES,
            mass_kg=MASSES.mass_kg + MASSES.mass_sd_kg * rng.normal(size=7),
            centre_m=MASSES.centre_m + 0.015 * rng.normal(size=(7, 3)),
        )
        torque = falling_torque(model, q, other)
        for j in range(7):
            shape = torque[:, j] / np.sqrt((torque[:, j] ** 2).mean())
            left = (
                shape
                - result.joints.columns[:, j]
                @ np.linalg.lstsq(result.joints.columns[:, j], shape)[0]
            )
            assert np.sqrt((left**2).mean()) < 0.15


def test_expected_sag_is_that_of_half_normal_compliances(model, q):
    """Joints twist in the direction in which the links would fall."""
    result = basis(model, q)
    falling = falling_torque(model, q, MASSES)
    mean = np.abs(np.random.default_rng(5).normal(size=100_000)).mean()
    for j in range(4):
        shape = falling[:, j] / np.sqrt((falling[:, j] ** 2).mean())
        # Uncertain masses take a share of the mean square: less of it is expected, never more.
        along = (result.joints.expected[:, j] @ shape) / (shape @ shape)
        assert 0.85 * mean < along < 1.01 * mean
        left = result.joints.expected[:, j] - along * shape
        assert np.sqrt((left**2).mean()) < 0.1


def test_play_follows_a_certain_load_and_is_unknown_otherwise(model, q):
    result = basis(model, q)
    sure = replace(MASSES, mass_sd_kg=np.zeros(7), centre_sd_m=np.zeros(7), down_sd_rad=0.0)
    falling = np.sign(falling_torque(model, q, MASSES))
    np.testing.assert_array_equal(basis(model, q, sure).joints.side, falling)
    assert np.all(np.abs(result.joints.side) <= 1.0)
    # The hand's roll about its own axis hardly has a lever, the shoulder has a large one.
    assert np.abs(result.joints.side[:, 1]).min() > 0.9
    assert np.abs(result.joints.side[:, 6]).mean() < np.abs(result.joints.side[:, 1]).mean()


def test_gravity_along_an_axis_causes_no_torque(model, q):
    along = replace(MASSES, down=np.array([0.0, 0.0, -1.0]), down_sd_rad=0.0)
    result = basis(model, q, along)
    assert (
        np.abs(result.joints.columns[:, 0]).max()
        == np.abs(result.joints.expected[:, 0]).max()
        == 0.0
    )
    assert np.all(result.joints.missed[:, 0] == 1.0)
    np.testing.assert_allclose(result.joints.side[:, 0], 0.0, atol=1e-6)


def test_placements_deflect_independently(model, q):
    number = np.repeat([1, 2], POSES // 2)
    both = place(model, number)
    result = basis(both, q, deflection_columns=10)
    assert result.deflection_at().shape == (POSES, 6, 20)
    apart = np.einsum(
        "aic,bjc->aibj", result.deflection_at()[number == 1], result.deflection_at()[number == 2]
    )
    assert not apart.any()
    alone = basis(model, q[number == 2], deflection_columns=10)
    np.testing.assert_allclose(result.deflection_at()[number == 2][..., 10:], alone.deflection_at())
    picked = result.at_poses(np.flatnonzero(number == 2))
    np.testing.assert_array_equal(picked.deflection_at(), result.deflection_at()[number == 2])
    np.testing.assert_array_equal(picked.joints.side, result.joints.side[number == 2])


def test_a_ball_deflects_along_three_components(q):
    ball = PointClosure(
        table=paper_arm(paper_truth()).table,
        entries=(),
        tip_m=np.array([0.0, 0.0, 0.05]),
        ground_m=np.array([0.3, 0.1, 0.2]),
    )
    result = basis(ball, q, stated_deflection=(0.0, 2e-4))
    assert result.deflection_at().shape[:2] == (POSES, 3)
    total = (result.deflection_at() ** 2).sum(-1) + result.deflection_missed
    assert total.mean() == pytest.approx(1.0, rel=1e-6)


def test_an_unsensed_wrist_changes_no_load(q):
    """Its readings are not used; gravity and equilibrium are the same."""
    whole, blind = (loop_of(paper_truth(), unsensed=u) for u in ((), (6, 7)))
    one, two = basis(whole, q), basis(blind, q)
    np.testing.assert_allclose(one.joints.columns, two.joints.columns, atol=1e-9)
    np.testing.assert_allclose(
        np.einsum("aic,bjc->aibj", one.deflection_at(), one.deflection_at()),
        np.einsum("aic,bjc->aibj", two.deflection_at(), two.deflection_at()),
        atol=1e-6,
    )
