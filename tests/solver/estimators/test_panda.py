"""A real arm with a ball in sockets, against an independent re-solve of the same data."""

import numpy as np

from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhKind
from solver.diagnostics.identifiability import identifiability
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.estimators.estimate import Estimate
from solver.estimators.implicit import NoiseModel
from solver.estimators.paper import estimate_paper
from solver.loops.placements import Placements, place
from solver.loops.point import PointClosure
from tests.oracles.panda import TRAINING, panda_columns, panda_readings, scatter_mm
from tests.solver.conftest import entries, tip_position

OFFSETS = tuple(f"theta_off_{j}" for j in range(1, 8))
EVERYTHING = tuple(f"{kind.symbol}_{j}" for kind in DhKind for j in range(1, 8))
NOISE = NoiseModel(joint_variance=np.full(7, 1e-4**2))
"""Alike for all joints; the figures compared here do not depend on its size."""


def loop(names: tuple[str, ...]) -> PointClosure:
    s, a, alpha = panda_columns()
    return PointClosure(
        table=DhTable(theta_off_rad=np.zeros(7), s_m=s, a_m=a, alpha_rad=alpha),
        entries=entries(names),
        tip_m=np.array([0.0, 0.0, 0.03]),
        ground_m=np.zeros(3),
    )


def training(names: tuple[str, ...]) -> tuple[Placements, np.ndarray]:
    placement, q = panda_readings()
    here = np.isin(placement, TRAINING)
    return place(loop(names), placement[here], same_hand=True), q[here]


def scatters(model: Placements, estimate: Estimate) -> tuple[float, float]:
    """Train and test figures of the README, mm; the test poses were never fitted."""
    placement, q = panda_readings()
    single, x = model.models[0], estimate.x[model.columns(TRAINING[0])]
    assert isinstance(single, PointClosure)
    centres = tip_position(single, x, q)
    here = np.isin(placement, TRAINING)
    return scatter_mm(centres[here], placement[here]), scatter_mm(centres[~here], placement[~here])


def test_parameters_hidden_by_a_ball_are_named_and_dropped():
    model, q = training((*OFFSETS, "s_1"))
    found = estimate_paper(model, q)
    directions = identifiability(model, found.x, q).directions
    heads = [set(d.parameters) for d in directions]
    assert len(directions) == 3
    for hidden, places in (
        ("theta_off_1", "ground_"),
        ("s_1", "ground_z"),
        ("theta_off_7", "tip_"),
    ):
        (group,) = [group for group in heads if hidden in group]
        assert any(name.startswith(places) for name in group)
    smaller, dropped = drop_unidentifiable(model, found.x, q)
    assert set(dropped) == {"theta_off_1", "s_1", "theta_off_7"}
    assert [p.name for p in smaller.parameters[:5]] == list(OFFSETS[1:6])
    # Holding what cannot be seen takes nothing from the fit.
    again = estimate_paper(smaller, q)
    np.testing.assert_allclose(
        np.linalg.norm(again.residual), np.linalg.norm(found.residual), rtol=1e-6
    )


def test_freeing_all_lengths_and_twists_needs_one_fixed_length():
    """With all lengths unknown the scale cannot be seen: some arm length is held, and named."""
    model, q = training(EVERYTHING)
    smaller, dropped = drop_unidentifiable(model, None, q)
    assert {"theta_off_1", "s_1", "theta_off_7"} <= set(dropped)
    assert set(dropped) & {"s_3", "s_5", "a_3", "a_4", "a_6"}
    found = estimate_paper(smaller, q)
    train, test = scatters(smaller, found)
    assert train <= 0.35
    assert test < 1.5
