"""Clear paths: none where free joints run away past a fold, by a second implementation of the loop."""

import numpy as np
import pytest

from operator_app.config.procedure_file import load_procedure
from operator_app.planning.live import is_path_clear
from tests.oracles.loop_oracle import Truth, closure, closure_rates, paper_truth, product

STEP_RAD = np.deg2rad(1.0)
FREE = np.array([0, 2, 3, 4, 6, 7])
"""Columns of theta_0 and of the free joints: 1 and 5 drive."""


def close_loop(truth: Truth, angles: np.ndarray) -> np.ndarray:
    """Close the loop with the free joints alone."""
    angles = angles.copy()
    for _ in range(4):
        step = np.linalg.solve(
            closure_rates(truth, angles[None], ())[0][0][:, FREE], closure(truth, angles[None])[0]
        )
        angles[FREE] -= step
    assert np.abs(closure(truth, angles[None])).max() < 1e-7
    return angles


def drive(truth: Truth, angles: np.ndarray, joint: int, by_deg: float) -> tuple[np.ndarray, float]:
    """All joints after a drive moved so far, and the speed of the fastest relative to the drive."""
    fastest = 0.0
    for _ in range(round(abs(np.deg2rad(by_deg)) / STEP_RAD)):
        ahead = angles.copy()
        ahead[joint] += np.sign(by_deg) * STEP_RAD
        closed = close_loop(truth, ahead)
        fastest = max(fastest, float(np.abs(closed - angles)[1:].max() / STEP_RAD))
        angles = closed
    return angles, fastest


@pytest.mark.sample(1)
@pytest.mark.parametrize(
    ("first_deg", "then_deg", "clear"), [(24.0, -10.0, True), (24.0, 12.0, False)]
)
def test_path_with_runaway_free_joints_is_not_clear(first_deg, then_deg, *, clear):
    truth, procedure = paper_truth(), load_procedure("hinge")
    loop = procedure.fixture.fixture.model(procedure.arm)
    start = np.concatenate(([0.0], truth.home))
    T = product(start + truth.theta_off, truth.s, truth.a, truth.alpha)
    start[0] = -np.arctan2(T[1, 0], T[0, 0])
    first, _ = drive(truth, close_loop(truth, start), 1, first_deg)
    second, fastest = drive(truth, first, 5, then_deg)
    assert (fastest < 1.5) if clear else (fastest > 5.0)
    x = truth.values([p.name for p in loop.parameters])
    target = {1: float(second[1]), 5: float(second[5])}
    assert is_path_clear(procedure.arm, loop, x, first[1:], target) is clear
    # A target a degree beyond a joint range is not clear.
    beyond = {1: float(procedure.arm.upper_rad[0]) + 0.02, 5: float(first[5])}
    assert not is_path_clear(procedure.arm, loop, x, first[1:], beyond)
