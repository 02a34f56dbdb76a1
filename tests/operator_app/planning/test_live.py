"""A way past a fold is not clear; where free joints run away, a second implementation of the loop says."""

import numpy as np
import pytest

from operator_app.config.procedure_file import load_procedure
from operator_app.planning.live import is_path_clear
from tests.oracles.loop_oracle import Truth, closure, closure_rates, paper_truth, product

STEP_RAD = np.deg2rad(1.0)
FREE = np.array([0, 2, 3, 4, 6, 7])
"""Columns of theta_0 and of the joints that do not drive: 1 and 5 do."""


def settled(truth: Truth, angles: np.ndarray) -> np.ndarray:
    """Close the loop with the free joints alone."""
    angles = angles.copy()
    for _ in range(4):
        step = np.linalg.solve(
            closure_rates(truth, angles[None], ())[0][0][:, FREE], closure(truth, angles[None])[0]
        )
        angles[FREE] -= step
    assert np.abs(closure(truth, angles[None])).max() < 1e-7
    return angles


def driven(truth: Truth, angles: np.ndarray, joint: int, by_deg: float) -> tuple[np.ndarray, float]:
    """Where all joints are after a drive went so far, and the fastest one's motion over the drive's."""
    fastest = 0.0
    for _ in range(round(abs(np.deg2rad(by_deg)) / STEP_RAD)):
        ahead = angles.copy()
        ahead[joint] += np.sign(by_deg) * STEP_RAD
        found = settled(truth, ahead)
        fastest = max(fastest, float(np.abs(found - angles)[1:].max() / STEP_RAD))
        angles = found
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
    here, _ = driven(truth, settled(truth, start), 1, first_deg)
    there, fastest = driven(truth, here, 5, then_deg)
    # Drives go at 20 deg/s: the fastest would go at more than 100, or at 30.
    assert (fastest < 1.5) if clear else (fastest > 5.0)
    x = truth.values([p.name for p in loop.parameters])
    target = {1: float(there[1]), 5: float(there[5])}
    assert is_path_clear(procedure.arm, loop, x, here[1:], target) is clear
    # A degree beyond a range is no place to go, however smooth the way.
    beyond = {1: float(procedure.arm.upper_rad[0]) + 0.02, 5: float(here[5])}
    assert not is_path_clear(procedure.arm, loop, x, here[1:], beyond)
