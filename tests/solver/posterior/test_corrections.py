"""Corrections as data: applied by the function in the manual, and their effect on the tool's position."""

from dataclasses import replace

import numpy as np
import pytest
import sarcal

from operator_app.manual.pages import Manual, files_on
from operator_app.report.facts import facts_of


@pytest.fixture(scope="module")
def poses():
    return sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=0).poses


@pytest.fixture(scope="module")
def result(poses):
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=poses)


def test_function_of_the_manual_gives_the_same_corrected_readings(poses, result):
    namespace = {}
    exec(files_on(Manual().page("corrections"))["corrections.py"], namespace)  # noqa: S102
    corrected = namespace["corrected"]
    solution = result._subject.solution
    rows = solution.corrections.rows.copy()
    rows[4, 1] = 0.05  # beta_2
    corrections = replace(solution.corrections, rows=rows)
    data = facts_of(replace(solution, corrections=corrections)).json
    kinds = {c["kind"] for c in data["corrections"]}
    assert kinds == {"harmonic", "linearity", "gravity", "offset"}
    rng = np.random.default_rng(0)
    for q in poses.q_rad[:5] + 0.1 * rng.normal(size=(5, 7)):
        expected = corrected(np.rad2deg(q).tolist(), data["corrections"], data["corrections_dh"])
        by_solver = np.rad2deg(q + corrections.at(q))
        np.testing.assert_allclose(expected, by_solver, rtol=0.0, atol=1e-9)
    assert max(abs(np.rad2deg(corrections.at(q)))) > 0.05


def test_effect_of_corrections_is_within_the_best_table_sigma(poses, result):
    by_table, with_corrections = (
        result.fk(poses.q_rad, corrections=c)[:, :3, 3] for c in (False, True)
    )
    distance = np.linalg.norm(by_table - with_corrections, axis=1)
    assert 1e-5 < np.sqrt(np.mean(distance**2)) < 2.0 * result._subject.solution.best.left_m
