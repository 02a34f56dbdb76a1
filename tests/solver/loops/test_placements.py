"""One arm in several placements: what is shared, what is not, and that nothing is mixed up."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.parameters import DhEntry, nominal_vector, wrap_angles
from solver.closing import close_loops
from solver.diagnostics.identifiability import identifiability
from solver.estimators.estimate import closure_at_readings
from solver.estimators.implicit import NoiseModel, estimate_implicit
from solver.estimators.paper import estimate_paper
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop
from solver.loops.placements import Placements, place
from tests.oracles.loop_oracle import Truth, closed_poses, paper_truth
from tests.solver.conftest import NAMES, loop_of

GROUND = ("theta_off_1", "a_0", "s_0", "alpha_0", "s_1")
HAND = ("theta_off_7", "a_7", "s_7", "alpha_7")
INNER = tuple(f"theta_off_{j}" for j in range(2, 7))


def second_truth(*, same_hand: bool) -> Truth:
    """The same arm in a hinge put elsewhere: another common normal, so another theta_off_1."""
    first = paper_truth()
    names = ("theta_off_1", "a_0", "s_0", "alpha_0", "s_1")
    values = np.add(first.values(names), [0.3, -0.03, 0.02, 0.2, 0.03])
    moved = first.with_values(names, values)
    if not same_hand:
        moved = moved.with_values(HAND, np.add(moved.values(HAND), [-0.2, 0.02, -0.01, 0.15]))
    # Its own home: the reading at which this loop closes, near the old one.
    model = loop_of(moved)
    pose = close_loops(model, moved.values(NAMES), first.home[None, :])
    assert pose.closed[0]
    return replace(moved, home=pose.q[0])


def two_placements(
    *, same_hand: bool, unsensed: tuple[int, ...] = ()
) -> tuple[Placements, np.ndarray, np.ndarray]:
    """Model with the paper's values as nominal in both, true parameters, interleaved exact poses."""
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
def test_what_belongs_to_the_fixture_carries_its_placement(same_hand):
    model, _, _ = two_placements(same_hand=same_hand)
    own = GROUND if same_hand else GROUND + HAND
    shared = INNER + (HAND if same_hand else ())
    names = [p.name for p in model.parameters]
    assert set(names) == {*shared, *(f"{name}[{k}]" for name in own for k in (3, 5))}
    assert set(model.ground_side) == {f"{name}[{k}]" for name in GROUND for k in (3, 5)}
    assert set(model.hand_side) == (
        set(HAND) if same_hand else {f"{name}[{k}]" for name in HAND for k in (3, 5)}
    )


@pytest.mark.sample(1)
@pytest.mark.parametrize("same_hand", [False, True])
def test_two_hinges_of_one_arm_are_recovered(same_hand):
    model, truth, q = two_placements(same_hand=same_hand)
    found = estimate_paper(model, q)
    near = nearest_equivalent(model, found.x, truth)
    assert np.abs(wrap_angles(model.parameters, near - truth)).max() < 1e-9
    judged = identifiability(model, truth, q)
    assert judged.directions == ()
    assert judged.scaled_condition_number < 100.0


def test_a_second_placement_tells_more_about_the_arm():
    """Thirty poses each: the shared offsets are known better than from one placement alone."""
    model, truth, q = two_placements(same_hand=False)
    noise = NoiseModel(joint_variance=np.full(7, 1e-8))
    both = estimate_implicit(model, q, noise, x0=truth)
    poses = model.poses_of(3)
    alone = estimate_implicit(model.models[0], q[poses], noise, x0=truth[model.columns(3)])
    for name in INNER:
        k, j = ([p.name for p in e.parameters].index(name) for e in (both, alone))
        assert both.standard_deviation[k] < alone.standard_deviation[j]


@pytest.mark.sample(1)
@pytest.mark.parametrize("same_hand", [False, True])
def test_every_combination_of_descriptions_closes(same_hand):
    model, truth, q = two_placements(same_hand=same_hand)
    found = model.equivalents(truth)
    # 8 a placement; with one hand its 2 are common, and so is which way the axis points.
    assert len(found) == (2 * 2 * 2 * 2 if same_hand else 8 * 8)
    assert len(np.unique(np.round(found, 9), axis=0)) == len(found)
    for x in found:
        assert np.abs(model.reduced(x, q).residual).max() < 1e-10
        near = nearest_equivalent(model, x, truth)
        assert np.abs(wrap_angles(model.parameters, near - truth)).max() < 1e-12


def test_many_placements_find_the_nearest_description_too():
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


def test_a_selection_of_poses_keeps_its_placements():
    model, truth, q = two_placements(same_hand=False)
    picked = np.random.default_rng(2).permutation(60)[:25]
    whole, part = model.reduced(truth, q), model.at_poses(picked).reduced(truth, q[picked])
    np.testing.assert_array_equal(part.residual, whole.residual[picked])
    mask = np.isin(np.arange(60), picked)
    masked = model.at_poses(mask).reduced(truth, q[mask])
    np.testing.assert_array_equal(masked.residual, whole.residual[mask])
    with pytest.raises(ValueError, match="25 poses for a model bound to 60"):
        model.reduced(truth, q[picked])


def test_unsensed_wrists_of_both_placements():
    model, truth, q = two_placements(same_hand=False, unsensed=(6, 7))
    lied = q + np.array([0, 0, 0, 0, 0, 0.02, -0.01])
    noise = NoiseModel(joint_variance=np.full(7, 1e-10))
    found = estimate_implicit(model, lied, noise, x0=truth)
    near = nearest_equivalent(model, found.x, truth)
    assert np.abs(wrap_angles(model.parameters, near - truth)).max() < 1e-8
    at_readings = closure_at_readings(model, truth, lied)
    assert np.abs(at_readings.residual).max() < 1e-9


def test_one_entry_may_be_held_in_one_placement_or_in_all():
    model, truth, q = two_placements(same_hand=False)
    one = model.without(("s_0[3]", "theta_off_4"))
    assert {p.name for p in model.parameters} - {p.name for p in one.parameters} == {
        "s_0[3]",
        "theta_off_4",
    }
    kept = [k for k, p in enumerate(model.parameters) if p.name in {p.name for p in one.parameters}]
    np.testing.assert_allclose(
        one.reduced(truth[kept], q).residual, model.reduced(truth, q).residual
    )


def test_what_does_not_belong_together_is_refused():
    single = loop_of(paper_truth())
    other = DhLoop(table=single.table, entries=(DhEntry.parse("theta_off_2"),), hinge=True)
    with pytest.raises(ValueError, match="same arm"):
        place([single, other], np.array([1, 2]))
    with pytest.raises(ValueError, match="ascending"):
        Placements(
            numbers=(2, 1), models=(single, single), placement=np.array([1, 2]), same_hand=False
        )
    with pytest.raises(ValueError, match="no model"):
        Placements(numbers=(1,), models=(single,), placement=np.array([1, 2]), same_hand=False)
