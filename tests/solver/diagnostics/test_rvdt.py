"""RVDT verdicts: planted curves and noise found, straight sensors left in peace, ignorance admitted."""

import re
from dataclasses import replace

import numpy as np
import pytest

from solver.diagnostics.rvdt import RvdtVerdict, Soundness, rvdt_verdicts
from solver.diagnostics.rvdt_response import RvdtFigures, noise_of_spread, single_noise, spread_of
from solver.diagnostics.smooth_curve import fit_curve
from solver.estimators.error_model import stated_errors
from solver.estimators.variance_components import estimate_with_errors
from tests.oracles.loop_oracle import paper_truth
from tests.oracles.simulated_loops import FULL_SCALE_RAD, LSB_RAD, Simulation, wrist_curves
from tests.solver.conftest import loop_of, paper_arm, read_poses

MODEL, ARM = loop_of(paper_truth()), paper_arm(paper_truth())


def judged(q: np.ndarray) -> dict[int, RvdtVerdict]:
    samples = np.ones(len(q), dtype=np.int64)
    whole, errors = (
        replace(
            stated_errors(ARM, samples=samples, unsensed_joints=unsensed), give_rad=0.0, give_m=0.0
        )
        for unsensed in ((), (6, 7))
    )
    found = {c.name: c for c in estimate_with_errors(MODEL, q, whole).components.components}
    noise = {
        j: single_noise(ARM.joints[j - 1].sensor, found[f"rvdt_{j}"], None, samples) for j in (6, 7)
    }
    model = loop_of(paper_truth(), unsensed=(6, 7))
    verdicts = rvdt_verdicts(model, ARM, q, errors, noise=noise, samples=samples, variances={})
    return {v.joint: v for v in verdicts}


def figures(verdict: RvdtVerdict) -> RvdtFigures:
    assert verdict.figures is not None
    return verdict.figures


def apart(one: np.ndarray, other: np.ndarray) -> float:
    """Largest difference but for a constant, which nobody can tell from the joint's offset."""
    difference = one - other
    return float(np.ptp(difference) / 2.0)


def test_a_planted_curve_of_1_percent_is_found(hinge_data):
    q = read_poses(hinge_data / "hinge_rvdt1pct.csv")
    exact = read_poses(hinge_data / "hinge_exact.csv")
    found = judged(q)
    for joint in (6, 7):
        one = figures(found[joint])
        # The planted curve itself, free of its noise: a sine of three periods a turn (by a fit).
        angle, deviation = exact[:, joint - 1], (q - exact)[:, joint - 1]
        basis = np.stack((np.sin(3 * angle), np.cos(3 * angle), np.ones_like(angle)), axis=1)
        wave = np.linalg.lstsq(basis, deviation, rcond=None)[0]
        assert np.hypot(*wave[:2]) == pytest.approx(0.01 * FULL_SCALE_RAD, rel=0.05)
        planted = basis @ wave
        assert apart(one.curve(one.angle_rad), planted) < 0.001 * FULL_SCALE_RAD
        assert found[joint].verdict is Soundness.CURVED
        assert found[joint].treat_as_unsensed
        assert f"treat joint {joint} as unsensed" in found[joint].text
        assert 1.5 < one.noise.lsb < 2.6
    # Joint 7's poses cover nearly all of the scale, so half the peak-to-peak is the amplitude.
    assert figures(found[7]).half_range == pytest.approx(0.01, abs=0.001)
    assert found[6].share + found[7].share > 0.8


def test_linear_sensors_are_not_corrected(hinge_data):
    found = judged(read_poses(hinge_data / "hinge_quantised.csv"))
    for verdict in found.values():
        assert verdict.verdict is Soundness.SOUND
        assert not verdict.treat_as_unsensed
        assert figures(verdict).gain == pytest.approx(1.0, abs=1e-3)


def test_a_curve_beyond_2_percent_is_out_of_specification():
    found = judged(Simulation(poses=60, bows=wrist_curves(6.0)).rereadings(1))
    assert found[7].verdict is Soundness.OUT_OF_SPECIFICATION
    assert figures(found[7]).linearity > 0.02


def test_excess_noise_is_out_of_specification():
    found = judged(Simulation(poses=60, wrist_sd=4.0 * LSB_RAD).rereadings(1))
    for verdict in found.values():
        assert verdict.verdict is Soundness.OUT_OF_SPECIFICATION
        assert figures(verdict).noise.low < 4.0 < figures(verdict).noise.high
        assert re.search(r"noise of a single reading [34]\.\d LSB", verdict.text)


def test_the_gain_is_estimated():
    found = judged(Simulation(poses=40, gains={6: 0.02}).rereadings(0))
    assert figures(found[6]).gain == pytest.approx(1.02, abs=3e-3)
    assert figures(found[7]).gain == pytest.approx(1.0, abs=3e-3)


def test_with_too_few_poses_no_statement_is_made():
    found = judged(Simulation(poses=40).rereadings(0)[:12])
    for verdict in found.values():
        assert verdict.verdict is Soundness.CANNOT_DECIDE
        assert verdict.figures is None
        assert not verdict.treat_as_unsensed
        assert "12 poses are too few" in verdict.text


def test_with_a_small_span_no_statement_is_made():
    found = judged(Simulation(poses=40, spread_deg=6.0).rereadings(0))
    assert found[6].verdict is Soundness.CANNOT_DECIDE
    assert "through only" in found[6].text


def test_a_compliant_fixture_is_not_blamed_on_the_sensor():
    found = judged(Simulation(poses=40, flexure_m=1e-3, flexure_rad=5e-3).readings(0))
    one = figures(found[6])
    # Five milliradians of flexure hide one of noise: no accusation, and the text says why.
    assert one.noise.low == 0.0
    assert "noise of a single reading: not determined" in found[6].text
    assert found[6].verdict is Soundness.SOUND


def test_a_model_without_unsensed_rvdts_is_refused():
    q, samples = Simulation(poses=20).rereadings(0), np.ones(20, dtype=np.int64)
    errors = stated_errors(ARM, samples=samples)
    with pytest.raises(ValueError, match="RVDT"):
        rvdt_verdicts(MODEL, ARM, q, errors, noise={}, samples=samples, variances={})


def test_noise_does_not_raise_the_degree_of_the_curve():
    degrees = []
    for seed in range(50):
        rng = np.random.default_rng(seed)
        x = rng.uniform(-1.0, 1.0, 60)
        degrees.append(fit_curve(x, 0.3 * x + rng.normal(size=60)).degree)
    assert np.mean(np.array(degrees) == 1) > 0.7
    with pytest.raises(ValueError, match="eight points"):
        fit_curve(np.arange(5.0), np.arange(5.0))


@pytest.mark.parametrize("points", [20, 40, 100])
def test_a_linear_sensor_is_called_curved_at_the_stated_rate(points):
    """The degree is the best of several, and noise has as many chances to look like a bend."""
    rng, runs = np.random.default_rng(7), 3000
    curved = 0
    for _ in range(runs):
        x = rng.uniform(-1.0, 1.0, points)
        curved += fit_curve(x, 0.3 * x + rng.normal(size=points)).line_probability < 0.01
    # More than 1.45 % of 3,000 has a chance of 1 % at a rate of 1 %.
    assert curved <= 0.0145 * runs


@pytest.mark.parametrize("lsb", [0.05, 0.2, 0.4, 1.0, 8.0])
def test_noise_is_estimated_from_rounded_readings(lsb):
    """Against rounded draws: below half a count most of the spread is lost, above it 1/12 is added."""
    rng = np.random.default_rng(4)
    readings = np.round(rng.uniform(size=(1, 20_000)) + lsb * rng.normal(size=(16, 20_000)))
    square = float(readings.var(axis=0, ddof=1).mean())
    assert spread_of(lsb) == pytest.approx(square, rel=0.03)
    assert noise_of_spread(square) == pytest.approx(lsb, rel=0.04)


def test_constant_readings_have_no_noise():
    assert noise_of_spread(0.0) == 0.0
