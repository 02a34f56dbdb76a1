"""One arm in several placements: shared and separate parameters, bound poses, equivalents."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector, wrap_angles
from solver.closing import close_loops
from solver.diagnostics.identifiability import identifiability
from solver.estimators.estimate import closure_at_readings
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.loops.closure import nearest_equivalent
from solver.loops.placements import Placements, place
from tests.oracles.loop_oracle import Truth, closed_poses, paper_truth
from tests.solver.conftest import NAMES, loop_of

GROUND = ("theta_off_1", "a_0", "s_0", "alpha_0", "s_1")
TOOL = ("theta_off_7", "a_7", "s_7", "alpha_7")


def second_truth(*, same_hand: bool) -> Truth:
    """The same arm with its hinge elsewhere: another common normal, so another theta_off_1."""
    first = paper_truth()
    names = ("theta_off_1", "a_0", "s_0", "alpha_0", "s_1")
    values = np.add(first.values(names), [0.3, -0.03, 0.02, 0.2, 0.03])
    moved = first.with_values(names, values)
    if not same_hand:
        moved = moved.with_values(TOOL, np.add(moved.values(TOOL), [-0.2, 0.02, -0.01, 0.15]))
    # The reading near the first home at which this loop closes.
    model = loop_of(moved)
    pose = close_loops(model, moved.values(NAMES), first.home[None, :])
    assert pose.closed[0]
    return replace(moved, home=pose.q[0])


def two_placements(
    *, same_hand: bool, unsensed: tuple[int, ...] = ()
) -> tuple[Placements, np.ndarray, np.ndarray]:
    """Model with the paper's nominal values, true parameters, and exact poses of both in random order."""
    rng = np.random.default_rng(0)
    truths = [paper_truth(), second_truth(same_hand=same_hand)]
    q = np.concatenate([closed_poses(t, rng, 30)[:, 1:] for t in truths])
    order = rng.permutation(60)
    model = place(
        loop_of(truths[0], unsensed=unsensed), np.repeat([3, 5], 30)[order], same_hand=same_hand
    )
    x = np.zeros(len(model.parameters))
    for number, truth in zip((5, 3), truths[::-1], strict=True):
        names = [p.name for p in model.models[0].parameters]
        x[model.columns(number)] = truth.values(names)
    return model, x, q[order]


@pytest.mark.sample(1)
@pytest.mark.parametrize("same_hand", [False, True])
def test_two_placements_are_recovered(same_hand):
    model, truth, q = two_placements(same_hand=same_hand)
    estimate = estimate_paper(model, q)
    near = nearest_equivalent(model, estimate.x, truth)
    assert np.abs(wrap_angles(model.parameters, near - truth)).max() < 1e-9
    result = identifiability(model, truth, q)
    assert result.directions == ()
    assert result.scaled_condition_number < 100.0


@pytest.mark.sample(1)
@pytest.mark.parametrize("same_hand", [False, True])
def test_every_equivalent_parameter_set_closes(same_hand):
    model, truth, q = two_placements(same_hand=same_hand)
    equivalents = model.equivalents(truth)
    # 8 per placement; with one tool its 2 are common, and so is the direction of the axis.
    assert len(equivalents) == (2 * 2 * 2 * 2 if same_hand else 8 * 8)
    assert len(np.unique(np.round(equivalents, 9), axis=0)) == len(equivalents)
    for x in equivalents:
        assert np.abs(model.reduced(x, q).residual).max() < 1e-10
        near = nearest_equivalent(model, x, truth)
        assert np.abs(wrap_angles(model.parameters, near - truth)).max() < 1e-12


def test_nearest_equivalent_of_seven_placements():
    single = loop_of(paper_truth())
    number = np.repeat(np.arange(1, 8), 2)
    model = place(single, number)
    reference = nominal_vector(model.parameters)
    rng = np.random.default_rng(1)
    x = reference.copy()
    for k in range(1, 8):
        choices = single.equivalents(x[model.columns(k)])
        x[model.columns(k)] = choices[rng.integers(len(choices))]
    near = nearest_equivalent(model, x, reference)
    assert np.abs(wrap_angles(model.parameters, near - reference)).max() < 1e-12


def test_selected_poses_keep_their_placements():
    model, truth, q = two_placements(same_hand=False)
    picked = np.random.default_rng(2).permutation(60)[:25]
    every, part = model.reduced(truth, q), model.at_poses(picked).reduced(truth, q[picked])
    np.testing.assert_array_equal(part.residual, every.residual[picked])
    mask = np.isin(np.arange(60), picked)
    masked = model.at_poses(mask).reduced(truth, q[mask])
    np.testing.assert_array_equal(masked.residual, every.residual[mask])
    with pytest.raises(ValueError, match="25 poses for a model bound to 60"):
        model.reduced(truth, q[picked])


def test_unsensed_wrist_readings_are_not_used():
    model, truth, q = two_placements(same_hand=False, unsensed=(6, 7))
    wrong_readings = q + np.array([0, 0, 0, 0, 0, 0.02, -0.01])
    noise = NoiseModel(joint_variance=np.full(7, 1e-10))
    estimate = estimate_implicit(model, wrong_readings, noise, x0=truth)
    near = nearest_equivalent(model, estimate.x, truth)
    assert np.abs(wrap_angles(model.parameters, near - truth)).max() < 1e-8
    assert np.abs(closure_at_readings(model, truth, wrong_readings).residual).max() < 1e-9


def test_entries_are_fixed_in_one_placement_or_all():
    model, truth, q = two_placements(same_hand=False)
    smaller = model.without(("s_0[3]", "theta_off_4"))
    assert {p.name for p in model.parameters} - {p.name for p in smaller.parameters} == {
        "s_0[3]",
        "theta_off_4",
    }
    remaining = [
        k for k, p in enumerate(model.parameters) if p.name in {p.name for p in smaller.parameters}
    ]
    np.testing.assert_allclose(
        smaller.reduced(truth[remaining], q).residual, model.reduced(truth, q).residual
    )
