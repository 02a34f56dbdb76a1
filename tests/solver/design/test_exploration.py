from dataclasses import replace

import numpy as np
import pytest

from solver.chain.kinematics import DhTable
from solver.chain.parameters import nominal_vector
from solver.closing import close_loops
from solver.design.exploration import RAY_STEP_RAD, Explorer
from solver.design.motion import Ranges
from tests.solver.design.conftest import DRIVES, HOME, ClosedChain, paper_ranges


def explore(explorer: Explorer, chain: ClosedChain, limit: int = 500):
    """All readings, and those of proposed captures; no drive moves farther than a step, except back."""
    readings, captured = [chain.q[0].copy()], []
    for _ in range(limit):
        if not (proposed := explorer.propose()):
            break
        step, *capture = proposed
        step_rad = [target - readings[-1][j - 1] for j, target in step.targets_rad.items()]
        assert "back" in step.why or np.abs(step_rad).max() <= RAY_STEP_RAD + 1e-9
        q = chain.move(dict(step.targets_rad))
        explorer.observe(q)
        readings.append(q)
        captured += [q] * len(capture)
    return np.array(readings[1:]), np.array(captured)


def test_exploration_stays_in_range_and_returns_home(loop, x):
    ranges = paper_ranges()
    explorer = Explorer(start_rad=HOME, drives=DRIVES, ranges=ranges)
    readings, captured = explore(explorer, ClosedChain(loop, x))
    assert not explorer.failure
    assert explorer.propose() == ()
    assert ranges.clearance(readings).min() > np.deg2rad(3.0)
    assert readings[-1] == pytest.approx(HOME, abs=1e-4)
    assert len(captured) >= 8
    spans = np.ptp(captured, axis=0)
    assert spans[[0, 4]].min() > np.deg2rad(25.0)
    assert spans.min() > np.deg2rad(5.0)


def test_ray_ends_before_a_narrow_range(loop, x):
    """Joint 7 has a range of +-12 deg; the explorer knows only its readings."""
    wide = paper_ranges()
    lower, upper = wide.lower_rad.copy(), wide.upper_rad.copy()
    lower[6], upper[6] = HOME[6] - np.deg2rad(12.0), HOME[6] + np.deg2rad(12.0)
    narrow = Ranges(lower_rad=lower, upper_rad=upper)
    explorer = Explorer(start_rad=HOME, drives=DRIVES, ranges=narrow)
    readings, _ = explore(explorer, ClosedChain(loop, x))
    assert narrow.clearance(readings).min() > 0.0
    assert any("joint 7" in ray.ended for ray in explorer.rays)


def test_ray_ends_before_a_singularity_two_steps_away(loop):
    """A hinge tilted by 7 deg: joint 2 moves 1.8, then 2.1 times as far as joint 1; the loop opens in the third step.

    The virtual arm tripped there with excess torque: the mean rate over the step, 2.4, was within its limit.
    """
    table = loop.table.stacked().copy()
    table[0, 1:] = np.deg2rad([0.8787, -120.0, -20.0, -10.0, 30.0, 120.0, 85.1972])
    table[1:4, 0] = 0.102222, 0.245211, -0.743580
    table[1, 1] = 0.198779
    table[1:4, 7] = 0.080925, -0.059452, 1.825203
    tilted = replace(loop, table=DhTable.from_stacked(table))
    home = np.deg2rad([42.3937, 243.4333, 142.4172, -117.1043, -189.0265, -217.2961, 45.7875])
    chain = ClosedChain(tilted, nominal_vector(tilted.parameters), home=home)
    explorer = Explorer(start_rad=chain.q[0].copy(), drives=DRIVES, ranges=paper_ranges())
    _, captured = explore(explorer, chain)
    assert any("singularity" in ray.ended for ray in explorer.rays)
    assert len(captured) >= 8


def test_stopped_move_ends_the_ray_and_returns(loop, x):
    explorer = Explorer(start_rad=HOME, drives=DRIVES, ranges=paper_ranges())
    chain = ClosedChain(loop, x)
    while len(proposed := explorer.propose()) == 1:
        explorer.observe(chain.move(dict(proposed[0].targets_rad)))
    step = proposed[0]
    explorer.observe(chain.move(dict(step.targets_rad)), stopped="joint 3 needs too much torque")
    (return_move,) = explorer.propose()
    assert return_move.targets_rad == pytest.approx({1: HOME[0], 5: HOME[4]})
    assert "torque" in return_move.why
    explorer.observe(chain.move(dict(return_move.targets_rad)))
    assert "joint 3 needs too much torque" in [ray.ended for ray in explorer.rays]
    assert explorer.propose()


def test_exploration_fails_when_the_arm_does_not_return():
    explorer = Explorer(start_rad=HOME, drives=DRIVES, ranges=paper_ranges())
    (step,) = explorer.propose()
    away = HOME.copy()
    away[0] = step.targets_rad[1]
    explorer.observe(away)
    for _ in range(3):
        explorer.propose()
        explorer.observe(away, stopped="blocked")
    assert explorer.propose() == ()
    assert "does not return to the start" in explorer.failure


def test_one_drive_gives_enough_poses_to_calibrate(loop, x):
    """A rigid mount leaves one degree of freedom and two rays."""
    offsets = np.array(loop.table.theta_off_rad)
    offsets[0] = close_loops(loop, x, HOME[None, :]).u[0, 0]
    rigid = replace(loop, table=replace(loop.table, theta_off_rad=offsets), hinge=False)
    explorer = Explorer(start_rad=HOME, drives=(2,), ranges=paper_ranges())
    readings, captured = explore(explorer, ClosedChain(rigid, x, (2,)))
    assert not explorer.failure
    assert readings[-1] == pytest.approx(HOME, abs=1e-4)
    assert len(captured) >= 5
    assert np.abs(np.diff(np.sort(captured[:, 1]))).min() > np.deg2rad(2.0), "no pose twice"
