"""Parameters that the poses do not determine are dropped, on readings of a real arm with a ball in sockets."""

import numpy as np

from solver.chain.kinematics import DhTable
from solver.chain.parameters import DhKind
from solver.diagnostics.model_selection import drop_unidentifiable
from solver.estimators.paper import estimate_paper
from solver.loops.endpoints import PointClosure
from solver.loops.placements import place
from tests.oracles.panda import A_M, ALPHA_RAD, S_M, panda_readings, scatter_mm
from tests.solver.conftest import entries, tip_position


def test_freeing_all_lengths_and_twists_needs_one_fixed_length():
    """With all lengths unknown the scale is not determined: one arm length is fixed, and named."""
    single = PointClosure(
        table=DhTable(theta_off_rad=np.zeros(7), s_m=S_M, a_m=A_M, alpha_rad=ALPHA_RAD),
        entries=entries([f"{kind.symbol}_{j}" for kind in DhKind for j in range(1, 8)]),
        tip_m=np.array([0.0, 0.0, 0.03]),
        ground_m=np.zeros(3),
    )
    placement, q = panda_readings()
    training = placement <= 2
    model = place(single, placement[training], same_hand=True)
    smaller, dropped = drop_unidentifiable(model, None, q[training])
    assert {"theta_off_1", "s_1", "theta_off_7"} <= set(dropped)
    assert set(dropped) & {"s_3", "s_5", "a_3", "a_4", "a_6"}
    x = estimate_paper(smaller, q[training]).x[smaller.columns(1)]
    centres = tip_position(smaller.models[0], x, q)
    assert scatter_mm(centres[training], placement[training]) <= 0.35
    assert scatter_mm(centres[~training], placement[~training]) < 1.5
