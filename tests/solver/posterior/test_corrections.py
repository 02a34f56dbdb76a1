"""Corrections as data: applied by a second implementation, and their effect on the tool's position."""

import numpy as np
import pytest
import sarcal

from tests.oracles.loop_oracle import product


@pytest.fixture(scope="module")
def poses():
    return sarcal.simulate(arm="sarcos_dextrous", fixture="hinge", poses=40, seed=0).poses


@pytest.fixture(scope="module")
def result(poses):
    return sarcal.calibrate(arm="sarcos_dextrous", fixture="hinge", poses=poses)


def corrected(q_deg, corrections, dh):
    """Readings (n,), deg, with every correction of `sarcal solve --json` added; `dh` are its rows."""
    columns = ("theta_off_deg", "s_m", "a_m", "alpha_deg")
    off, s, a, alpha = np.array([[row[c] for c in columns] for row in dh]).T
    table = np.deg2rad(q_deg + off), s, a, np.deg2rad(alpha)
    T = [product(*(column[:k] for column in table)) for k in range(len(dh) + 1)]
    out = np.array(q_deg)
    for c in corrections:
        j, k = c["joint"] - 1, np.array(c["coefficients"])
        q = np.deg2rad(q_deg[j])
        match c["kind"]:
            case "harmonic":
                out[j] += k @ [np.sin(q), np.cos(q), np.sin(2 * q), np.cos(2 * q)]
            case "linearity":
                u = np.clip((q_deg[j] - c["middle_deg"]) / c["half_scale_deg"], -1.2, 1.2)
                out[j] += np.polynomial.polynomial.polyval(u, k)
            case "gravity":
                for link, (mass, *moments) in enumerate(k.reshape(-1, 4)[j:], j):
                    z, x = T[link][:3, 2], T[link + 1][:3, 0]
                    lever = mass * (T[link] - T[j])[:3, 3] + moments @ np.stack(
                        (x, np.cross(z, x), z)
                    )
                    out[j] += T[j][:3, 2] @ np.cross(lever, 9.80665 * np.array(c["down"]))
            case "offset":
                out[j] += k[0]
    return out


def test_second_implementation_gives_the_same_corrected_readings(poses, result):
    data, corrections = result.to_json(), result._subject.solution.corrections
    kinds = {c["kind"] for c in data["corrections"]}
    assert kinds == {"harmonic", "linearity", "gravity", "offset"}
    rng = np.random.default_rng(0)
    for q in poses.q_rad[:5] + 0.1 * rng.normal(size=(5, 7)):
        expected = corrected(np.rad2deg(q), data["corrections"], data["corrections_dh"])
        by_solver = np.rad2deg(q + corrections.at(q))
        np.testing.assert_allclose(expected, by_solver, rtol=0.0, atol=1e-9)
    assert max(abs(np.rad2deg(corrections.at(q)))) > 0.05


def test_effect_of_corrections_is_within_the_best_table_sigma(poses, result):
    by_table, with_corrections = (
        result.fk(poses.q_rad, corrections=c)[:, :3, 3] for c in (False, True)
    )
    distance = np.linalg.norm(by_table - with_corrections, axis=1)
    assert 1e-5 < np.sqrt(np.mean(distance**2)) < 2.0 * result._subject.solution.best.left_m
