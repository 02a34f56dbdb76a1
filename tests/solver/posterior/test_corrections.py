"""Corrections as data: the same by plain Python, and nearer to the truth than a table can be."""

import numpy as np
import pytest
import sarcal

from tests.solver.posterior.reference_corrections import corrected


@pytest.fixture(scope="module")
def made():
    return sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=0)


@pytest.fixture(scope="module")
def result(made):
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=made.poses)


@pytest.fixture(scope="module")
def solution(result):
    return result._subject.solution


def test_thirty_lines_without_a_library_give_the_same_readings(made, result, solution):
    data = result.to_json()
    kinds = {c["kind"] for c in data["corrections"]}
    assert kinds == {"harmonic", "linearity", "gravity", "offset"}
    rng = np.random.default_rng(0)
    for q in made.poses.q_rad[:5] + 0.1 * rng.normal(size=(5, 7)):
        plain = corrected(np.rad2deg(q).tolist(), data["corrections"], data["corrections_dh"])
        ours = np.rad2deg(q + solution.corrections.at(q))
        np.testing.assert_allclose(plain, ours, rtol=0.0, atol=1e-9)
    assert max(abs(np.rad2deg(solution.corrections.at(q)))) > 0.05


def test_the_whole_model_has_the_tool_where_parameters_and_corrections_have_it(
    made, result, solution
):
    q = made.poses.q_rad
    by_table, whole = (result.fk(q, corrections=c)[:, :3, 3] for c in (False, True))
    apart = np.linalg.norm(by_table - whole, axis=1)
    # What no table holds is in the table's own sigma.
    assert 1e-5 < np.sqrt(np.mean(apart**2)) < 2.0 * solution.best.left_m
