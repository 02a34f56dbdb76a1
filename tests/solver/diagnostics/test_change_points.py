"""Steps at any pose: named at the right pose with the right size, and rarely where there is none."""

import numpy as np
import pytest

from solver.diagnostics.change_points import step_threshold, steps
from solver.diagnostics.fault_models import Candidate, Cause
from solver.diagnostics.limits import STEP_EDGE_POSES
from solver.diagnostics.whitened_residuals import WhitenedResiduals
from tests.oracles.fit_residuals import fit_residuals

POSES, ROWS, UNKNOWNS = 40, 5, 14


RNG = np.random.default_rng(1)
A, G = RNG.normal(size=(POSES, ROWS, UNKNOWNS)), RNG.normal(size=(POSES, ROWS, 4))


def fitted(A: np.ndarray, w: np.ndarray) -> WhitenedResiduals:
    return fit_residuals(w, A, np.broadcast_to(np.eye(ROWS), (len(w), ROWS, ROWS)))


def suspect(subject: str, columns: np.ndarray) -> Candidate:
    return Candidate(
        cause=Cause.SLIPPED,
        subject=subject,
        columns=columns,
        expected_size=np.ones(columns.shape[-1]),
    )


SUSPECTS = (suspect("one", G[..., :1]), suspect("three", G[..., 1:]))


@pytest.mark.parametrize("pose", [STEP_EDGE_POSES, 17, POSES - STEP_EDGE_POSES])
def test_a_step_is_found_with_position_and_size(pose):
    w = np.random.default_rng(pose).normal(size=(POSES, ROWS))
    w[pose:] += 12.0 * G[pose:, :, 0]
    result, other = steps(fitted(A, w), SUSPECTS)
    assert (result.suspect.subject, result.pose) == ("one", pose)
    assert result.chi2 > result.threshold
    assert abs(result.size[0] - 12.0) < 4.0 * result.size[0] / np.sqrt(result.chi2)
    assert other.suspect.subject == "three"


def test_joint_evaluation_of_steps_equals_single_fits():
    """A second way: least squares with and without each step's columns."""
    w = np.random.default_rng(9).normal(size=(POSES, ROWS))
    J, y = A.reshape(-1, UNKNOWNS), w.reshape(-1)
    without = float(np.linalg.lstsq(J, y)[1][0])
    gains = []
    for pose in range(STEP_EDGE_POSES, POSES - STEP_EDGE_POSES + 1):
        late = G[..., 1:].copy()
        late[:pose] = 0.0
        with_step = np.concatenate((J, late.reshape(-1, 3)), axis=1)
        gains.append(without - float(np.linalg.lstsq(with_step, y)[1][0]))
    result = {step.suspect.subject: step for step in steps(fitted(A, w), SUSPECTS)}["three"]
    assert result.pose == STEP_EDGE_POSES + int(np.argmax(gains))
    assert result.chi2 == pytest.approx(max(gains), rel=1e-9)


def test_effects_already_in_the_fit_are_no_step():
    everywhere = np.repeat(np.eye(POSES)[:, None, :], ROWS, axis=1) * G[..., :1]
    w = np.random.default_rng(2).normal(size=(POSES, ROWS))
    left = fitted(A, w).with_columns(everywhere)
    assert steps(left, SUSPECTS[:1]) == ()


@pytest.mark.sample(1)
@pytest.mark.parametrize(("poses", "dof"), [(12, 1), (40, 1), (40, 5), (150, 3)])
def test_the_threshold_has_its_stated_false_alarm_rate(poses, dof):
    rng = np.random.default_rng([poses, dof])
    A = rng.normal(size=(poses, ROWS, 4))
    G = rng.normal(size=(poses, ROWS, dof))
    runs, level = 1500, 0.03
    alarms, suspects = 0, (suspect("any", G),)
    for _ in range(runs):
        left = fitted(A, rng.normal(size=(poses, ROWS)))
        alarms += steps(left, suspects)[0].chi2 > step_threshold(poses, dof, level)
    # At most the stated rate, within chance, and not much less.
    assert 0.2 * level * runs < alarms < level * runs + 3.0 * np.sqrt(level * runs)


def test_more_poses_and_unknowns_raise_the_threshold():
    assert step_threshold(20, 1, 1e-3) < step_threshold(200, 1, 1e-3) < step_threshold(200, 5, 1e-3)
    assert step_threshold(40, 1, 1e-2) < step_threshold(40, 1, 1e-4)
