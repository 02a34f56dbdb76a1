"""Shapes of play, sag and deflection: stated variances are reproduced, and columns equal the effects."""

from dataclasses import replace

import numpy as np
import pytest

from solver.chain.parameters import nominal_vector
from solver.estimators.effects import Linearisation, LinearModel, State
from solver.estimators.layout import Layout
from solver.estimators.variance_components import settle
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.simulated_loops import Simulation
from tests.solver.conftest import NAMES, loop_of
from tests.solver.estimators.test_load_effects import GIVE, MASSES, basis
from tests.solver.estimators.test_mixed_model import POSES, SOFT, everything_stated, system_of


@pytest.fixture(scope="module")
def model():
    return loop_of(paper_truth(), names=(*NAMES, *SOFT))


@pytest.fixture(scope="module")
def q():
    return Simulation(poses=POSES).readings(0)


@pytest.fixture(scope="module")
def errors(model, q):
    loads = basis(model, q)
    side = np.sign(np.random.default_rng(0).normal(size=q.shape))
    return replace(everything_stated(paper_truth(), q), loads=loads, approach=side)


def joint_variance_by_source(design: Layout, source: str) -> np.ndarray:
    """Variance of every joint by the columns of play or sag, in squares of the stated size."""
    shapes, stated = {
        "joint_play": (design.play, design.backlash), "sag": (design.sags, design.sag)
    }[source]  # fmt: skip
    assert shapes.joints.tolist() == list(range(7))
    return (shapes.expected**2 + (shapes.columns**2).sum(-1) + shapes.missed) / stated**2


def test_the_stated_variance_is_reproduced(model, q, errors):
    design = LinearModel(model, q, errors)
    starts = {c.name: c.start for c in design.components}
    assert joint_variance_by_source(design, "sag").mean(0) == pytest.approx(np.ones(7), rel=1e-6)
    play = joint_variance_by_source(design, "joint_play")
    np.testing.assert_allclose(play, 1.0)
    assert starts["joint_play"] == pytest.approx(0.4**2)
    total = design.smooth_deflection_variance(design.start_variances())
    noise = design.noise_variance(design.start_variances()).mean(0)[-6:]
    for rows, stated in ((slice(0, 3), GIVE[0]), (slice(3, 6), GIVE[1])):
        share = (total[rows] + noise[rows]).mean() / stated**2
        assert 1.0 < share < 1.4


def test_play_follows_the_load_with_probability_one_half(model, q, errors):
    """Second moments of joints, half of them displaced by the load and half by their approach."""
    design = LinearModel(model, q, errors)
    rng = np.random.default_rng(1)
    follows = rng.random(20_000) < 0.5
    leads = rng.choice((-1.0, 1.0), size=20_000)
    load, came = design.errors.loads.joints.side[:, 1], design.errors.approach[:, 1]
    drawn = np.where(follows[:, None], load, leads[:, None] * came)
    size = design.backlash[1]
    assert design.play.expected[:, 1] / size == pytest.approx(drawn.mean(0), abs=0.02)
    spread = np.cov(drawn.T)
    columns = design.play.columns[:, 1] / size
    assert columns @ columns.T == pytest.approx(spread, abs=0.04)


def test_expected_effects_are_subtracted_from_the_readings(model, q, errors):
    """Readings with the expected error close at the truth without an effect."""
    design = LinearModel(model, q, errors)
    e = design.effects_at(np.zeros(design.width - design.flat_count), q)[0]
    assert np.abs(e).max() > 1e-5
    x = nominal_vector(model.parameters)
    u = model.initial_unsensed(x, q)
    state = State(x=x, e=np.zeros_like(q), u=u, closed_q=q, closed_u=u)
    plain = LinearModel(model, q, replace(errors, loads=None, approach=None))
    assert not plain.expected.any()
    here = Linearisation(design, state).at_poses(slice(None))
    there = Linearisation(plain, state).at_poses(slice(None))
    np.testing.assert_allclose(
        here.w - there.w, (here.B @ e[..., None])[..., 0], rtol=1e-9, atol=1e-15
    )


def test_columns_equal_the_effects_on_joints_and_fixture(model, q, errors):
    design = LinearModel(model, q, errors)
    system = system_of(design, np.zeros((POSES, 5)))
    unscaled = np.ones(design.width - design.flat_count)
    part = design.whiten(system, design.start_variances(), unscaled, slice(None))
    b = np.random.default_rng(3).normal(size=design.width - design.flat_count)
    b[: len(design.prior_index)] = 0.0
    shift, deflection = design.effects_at(b, q)
    shift = shift - design.effects_at(0.0 * b, q)[0]
    expected = part.L_inverse @ (
        system.B @ shift[..., None] + np.swapaxes(system.E, -1, -2) @ deflection[..., None]
    )
    np.testing.assert_allclose(
        part.M[..., design.flat_count :] @ b, expected[..., 0], rtol=1e-9, atol=1e-9
    )


def test_exact_masses_leave_only_the_smooth_function(model, q, errors):
    sure = replace(MASSES, mass_sd_kg=np.zeros(7), centre_sd_m=np.zeros(7), down_sd_rad=0.0)
    design = LinearModel(model, q, replace(errors, loads=basis(model, q, sure)))
    assert design.loaded is None
    v = design.start_variances()
    stated = [g.variance(v) for g in design.groups if g.source == "fixture_give"]
    assert sorted(stated) == pytest.approx([GIVE[1] ** 2, GIVE[0] ** 2], rel=1e-3)


def test_without_a_sign_second_moments_are_equal(model, q, errors):
    signed, free = (LinearModel(model, q, replace(errors, signed=s)) for s in (True, False))
    assert signed.expected.any()
    assert not free.expected.any()
    for one, other, sizes in (
        (signed.sags, free.sags, signed.sag), (signed.play, free.play, signed.backlash),
    ):  # fmt: skip
        for j, size in enumerate(sizes):
            both = [s.columns[:, j] @ s.columns[:, j].T for s in (one, other)]
            both[0] = both[0] + np.outer(one.expected[:, j], one.expected[:, j])
            np.testing.assert_allclose(both[0] / size**2, both[1] / size**2, atol=1e-12)
        np.testing.assert_allclose(one.missed / sizes**2, other.missed / sizes**2, atol=1e-12)


@pytest.mark.parametrize(("share", "signed"), [(1.0, True), (0.0, False), (-1.0, False)])
def test_the_readings_decide_the_sign_of_gravity(model, errors, share, signed):
    """Readings with a share of the expected sag and play; those of an exact arm have none."""
    q = Simulation(poses=POSES, wrist_sd=1e-7, encoder_sd=1e-7).readings(0)
    expected = LinearModel(model, q, errors).expected
    result, _ = settle(model, q - share * expected, errors)
    assert result.fit.design.errors.signed is signed
