"""Requirements on every fixture of `planted`."""

import numpy as np
import pytest

from fixtures.base import Severity
from fixtures.setup_checks import mobility, setup_checks
from solver.chain.parameters import nominal_vector, wrap_angles
from solver.chain.sensors import Encoder
from solver.diagnostics.identifiability import identifiability
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.loops.closure import ClosureModel
from solver.loops.endpoints import MeasuredClosure
from solver.loops.placements import place
from tests.contracts.planted import ARMS, FIXTURES, Case, case, closed_poses, observed, perturbed

SIGMA_RAD = Encoder(counts_per_rev=400_000).sigma_rad


@pytest.fixture(params=[(kind, arm) for kind in sorted(FIXTURES) for arm in ARMS], ids="-".join)
def planted(request):
    return case(*request.param)


def freedoms(model: ClosureModel) -> int:
    if isinstance(model, MeasuredClosure):
        return model.joint_count
    return model.joint_count - model.equations_per_pose


def differences(function, point: np.ndarray, step: float = 1e-6) -> np.ndarray:
    """Central differences by the last axis of `point`, as the last axis of the result."""
    columns = []
    for k in range(point.shape[-1]):
        h = np.zeros(point.shape[-1])
        h[k] = step
        columns.append((function(point + h) - function(point - h)) / (2.0 * step))
    return np.stack(columns, axis=-1)


@pytest.mark.sample(32)
@pytest.mark.parametrize("offset_rad", [0.5, 1e-3, 1e-9, 0.0])
@pytest.mark.parametrize("unsensed", [(), (2,), (6, 7)])
def test_jacobians_are_the_derivatives(planted, offset_rad, unsensed):
    model = FIXTURES[planted.kind](planted.arm).model(planted.arm, unsensed_joints=unsensed)
    rng = np.random.default_rng(5)
    x = perturbed(model, seed=6)
    q = planted.q[:4]
    model = observed(model, x, q)
    q = q + offset_rad * rng.uniform(-1.0, 1.0, q.shape)
    u = model.initial_unsensed(x, q)
    error = model.loop(x, q, u)
    jacobians = [
        (error.jac_x, differences(lambda y: model.loop(y, q, u).residual, x)),
        (error.jac_q, differences(lambda y: model.loop(x, y, u).residual, q)),
    ]
    if u.shape[-1]:
        jacobians.append((error.jac_u, differences(lambda y: model.loop(x, q, y).residual, u)))
    for jacobian, expected in jacobians:
        assert jacobian.shape == expected.shape
        np.testing.assert_allclose(jacobian, expected, rtol=1e-6, atol=2e-8)
    if not unsensed:
        expected = differences(lambda y: model.reduced(y, q).residual, x)
        np.testing.assert_allclose(model.reduced(x, q).jac_x, expected, rtol=1e-5, atol=1e-7)


def test_shapes_and_parameter_names_are_consistent(planted):
    model, x, q = planted.model, planted.truth, planted.q
    names = [p.name for p in model.parameters]
    assert len(set(names)) == len(names) == len(x)
    assert {*model.ground_side} <= set(names)
    assert {*model.hand_side} <= set(names)
    assert not {*model.ground_side} & {*model.hand_side}
    assert model.joint_count == planted.arm.joint_count == q.shape[1]
    u = model.initial_unsensed(x, q)
    error, reduced = model.loop(x, q, u), model.reduced(x, q)
    m, k = error.residual.shape
    assert m == len(q)
    assert error.jac_u.shape == (m, k, u.shape[-1])
    assert reduced.residual.shape == (m, model.equations_per_pose)
    assert k - u.shape[-1] == model.equations_per_pose
    assert not reduced.flipped.any()


def test_stacked_starts_match_single_calls(planted):
    model, q = planted.model, planted.q
    starts = np.stack([perturbed(model, seed) for seed in range(3)])
    together = model.reduced(starts, q)
    for k, x in enumerate(starts):
        alone = model.reduced(x, q)
        np.testing.assert_allclose(together.residual[k], alone.residual, rtol=0, atol=1e-14)
        np.testing.assert_allclose(together.jac_x[k], alone.jac_x, rtol=0, atol=1e-14)


@pytest.mark.parametrize("estimator", ["paper", "implicit"])
def test_planted_truth_is_recovered(planted, estimator):
    if estimator == "paper":
        estimate = estimate_paper(planted.model, planted.q)
    else:
        estimate = estimate_implicit(planted.model, planted.q, noise(planted))
    assert estimate.converged
    assert np.abs(error_of(estimate.x, planted)).max() < 1e-9
    assert np.abs(estimate.residual).max() < 1e-10


def noise(planted: Case) -> NoiseModel:
    return NoiseModel(joint_variance=np.full(planted.q.shape[1], SIGMA_RAD**2))


def error_of(x: np.ndarray, planted: Case) -> np.ndarray:
    return wrap_angles(planted.model.parameters, x - planted.truth)


def test_sensor_noise_gives_expected_chi2_and_sigmas_in_any_pose_order(planted):
    rng = np.random.default_rng(7)
    q = planted.q + SIGMA_RAD * rng.normal(size=planted.q.shape)
    first = estimate_implicit(planted.model, q, noise(planted))
    assert first.converged
    # For 3 to 5 equations per pose and 30 poses, 0.5 and 1.6 are four standard deviations away.
    assert 0.5 < first.chi2_per_dof < 1.6
    assert np.abs(error_of(first.x, planted) / first.standard_deviation).max() < 5.0
    order = rng.permutation(len(q))
    second = estimate_implicit(planted.model.at_poses(order), q[order], noise(planted))
    # Relative to the parameter or, if that is small, to a radian or a metre.
    scale = np.maximum(np.abs(first.x), 1.0)
    assert np.abs((second.x - first.x) / scale).max() < 1e-12
    assert second.chi2 == pytest.approx(first.chi2, rel=1e-8)
    np.testing.assert_allclose(second.pose_chi2, first.pose_chi2[order], rtol=1e-6, atol=1e-9)


def test_equivalent_parameters_close_same_loops(planted):
    equivalents = planted.model.equivalents(planted.truth)
    np.testing.assert_array_equal(equivalents[0], planted.truth)
    for x in equivalents:
        reduced = planted.model.reduced(x, planted.q)
        assert np.abs(reduced.residual).max() < 1e-10
        assert not reduced.flipped.any()


def test_constrained_joint_is_reported_unidentifiable(planted):
    full = FIXTURES[planted.kind](planted.arm).model(planted.arm)
    x = nominal_vector(full.parameters)
    if freedoms(full) < 2:
        # Constraining a joint would leave no motion; the elbow does not move anyway.
        constrained = 4
        q = closed_poses(full, x, planted.arm, seed=9)
        q = q[np.abs(q[:, 3] - np.median(q[:, 3])) < 1e-3]
        assert len(q) > 8
    else:
        constrained = 3
        q = closed_poses(full, x, planted.arm, seed=9, constrained=constrained)
    model = observed(full, x, q)
    result = identifiability(model, x, q)
    directions = [d for d in result.directions if f"theta_off_{constrained}" in d.parameters]
    assert directions, [str(d) for d in result.directions]
    assert any(f"joint {constrained} does not move" in d.reason for d in directions)
    assert result.rank < len(x)
    smaller, dropped = drop_unidentifiable(model, x, q)
    assert f"theta_off_{constrained}" in dropped
    assert not identifiability(smaller, nominal_vector(smaller.parameters), q).directions


def test_fixing_a_parameter_removes_its_column_only(planted):
    model, q = planted.model, planted.q
    x = nominal_vector(model.parameters)
    for k, parameter in enumerate(model.parameters):
        smaller = model.without((parameter.name,))
        assert [p.name for p in smaller.parameters] == [
            p.name for p in model.parameters if p.name != parameter.name
        ]
        free = np.delete(np.arange(len(x)), k)
        np.testing.assert_array_equal(
            smaller.reduced(x[free], q).jac_x, model.reduced(x, q).jac_x[..., free]
        )


def test_readings_of_unsensed_joints_are_ignored(planted):
    fixture = FIXTURES[planted.kind](planted.arm)
    model = fixture.model(planted.arm, unsensed_joints=(6, 7))
    x = perturbed(model, seed=10)
    model = observed(model, x, planted.q)
    u = model.initial_unsensed(x, planted.q)
    wrong = planted.q.copy()
    wrong[:, [5, 6]] += 1.0
    error = model.loop(x, planted.q, u)
    np.testing.assert_array_equal(model.loop(x, wrong, u).residual, error.residual)
    assert np.all(error.jac_q[..., [5, 6]] == 0.0)
    names, offsets = {p.name for p in model.parameters}, {"theta_off_6", "theta_off_7"}
    assert not names & offsets
    assert {p.name for p in model.with_all_joints_sensed().parameters} == names | offsets
    with pytest.raises(ValueError, match="unsensed"):
        model.reduced(x, planted.q)


def test_mobility_and_setup_checks(planted):
    fixture = FIXTURES[planted.kind](planted.arm)
    model = fixture.model(planted.arm)
    x = nominal_vector(model.parameters)
    pose = closed_poses(model, x, planted.arm, seed=11, count=5)[0]
    checks = setup_checks(fixture, planted.arm, pose)
    codes = [check.code for check in checks]
    assert len(set(codes)) == len(codes)
    assert all(check.remedy for check in checks if check.severity is not Severity.OK)
    check = next(check for check in checks if check.code == "MOBILITY")
    if not isinstance(model, MeasuredClosure):
        assert mobility(model, x, pose).degrees == freedoms(model)
    assert check.severity is Severity.OK
    assert str(freedoms(model)) in check.text
    refused = {check.code for check in checks if check.severity is Severity.REFUSED}
    # The elbow of a spherical arm is the only joint that cannot move with the flange bolted down.
    assert refused == (
        {"IMMOBILE_4"} if (planted.kind, planted.arm.name) == ("rigid", "sarcos") else set()
    )


def test_hidden_parameters_are_those_dropped_as_unidentifiable(planted):
    """The set-up check and the Jacobian agree without sharing code."""
    fixture = FIXTURES[planted.kind](planted.arm)
    model = fixture.model(planted.arm)
    x = nominal_vector(model.parameters)
    hidden = {
        check.code.removeprefix("HIDDEN_")
        for check in fixture.placement_checks(planted.arm, model, x)
        if check.code.startswith("HIDDEN_")
    }
    q = closed_poses(model, x, planted.arm, seed=12)
    _, dropped = drop_unidentifiable(observed(model, x, q), x, q)
    assert hidden == set(dropped) - {"theta_off_4"}


def test_placements_equal_stacked_single_loops(planted):
    fixture = FIXTURES[planted.kind](planted.arm)
    q = planted.q[:7]
    number = np.array([1, 2, 2, 1, 2, 1, 1])
    single = fixture.model(planted.arm)
    values = [perturbed(single, 13), perturbed(single, 14)]
    single = observed(single, values[0], q)
    for same_hand in (False, True):
        stacked = place(single, number, same_hand=same_hand)
        own = {*single.ground_side} | (set() if same_hand else {*single.hand_side})
        names = [p.name for p in stacked.parameters]
        assert set(names) == {p.name for p in single.parameters if p.name not in own} | {
            f"{name}[{k}]" for name in own for k in (1, 2)
        }
        x = np.zeros(len(names))
        for k in (2, 1):  # shared parameters get the first placement's values
            x[stacked.columns(k)] = values[k - 1]
        together = stacked.reduced(x, q)
        for k in (1, 2):
            own_poses, columns = number == k, stacked.columns(k)
            alone = single.at_poses(np.flatnonzero(own_poses)).reduced(x[columns], q[own_poses])
            np.testing.assert_array_equal(together.residual[own_poses], alone.residual)
            np.testing.assert_array_equal(together.jac_x[own_poses][..., columns], alone.jac_x)
        assert place(single.at_poses(np.arange(3)), np.full(3, 4)).parameters == single.parameters
