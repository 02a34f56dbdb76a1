"""Verdicts on RVDTs, their corrections, offsets from the loop and noise, against planted truth and exact readings."""

import re
from dataclasses import replace
from pathlib import Path

import numpy as np
import pytest
import sarcal

from fixtures.ball import Ball
from operator_app.calibration.calibrate import calibrate
from operator_app.calibration.rvdt import ReadingTable, reading_tables
from operator_app.config.parameters_file import save_parameters
from operator_app.config.poses_file import load_poses
from operator_app.report.facts import facts_of
from operator_app.report.text import facts_text
from operator_app.session.store.parameters_document import rvdt_remedy
from solver.diagnostics.rvdt import Soundness
from tests.oracles.as_shipped import ARM, HINGE, poses_of, solved, spread_out
from tests.oracles.parameter_documents import make_document
from tests.oracles.shop_floor import Sizes, Specimen, session, taken
from tests.oracles.shop_floor_chain import frames, rotation_about_z
from tests.oracles.shop_floor_faults import CASES, ball_instead_of_hinge
from tests.oracles.shop_floor_misread import sinusoidal_rvdts
from tests.oracles.simulated_loops import FULL_SCALE_RAD, LSB_RAD, Simulation, wrist_curves

DATA = Path(__file__).parents[2] / "data" / "hinge"
CURVED = DATA / "hinge_rvdt1pct.csv"
RVDTS = (6, 7)


@pytest.fixture(scope="module")
def curved():
    """Readings with a linearity deviation of 1 % of full scale, solved as they are."""
    return calibrate(ARM, HINGE, load_poses(CURVED).poses)


def verdicts_of(simulation, seed, poses=None):
    """The verdict of each RVDT from readings of random closed poses, or from some of them."""
    read = simulation.readings if simulation.flexure_m else simulation.rereadings
    return rvdts_of(calibrate(ARM, HINGE, sarcal.poses_of(q_rad=read(seed)[:poses])._set))


def rvdts_of(solution):
    return {v.joint: v for v in solution.rvdt}


def test_planted_curve_of_1_percent_is_found(curved):
    exact = load_poses(DATA / "hinge_exact.csv").poses.q_rad
    q, verdicts = load_poses(CURVED).poses.q_rad, rvdts_of(curved)
    for joint, verdict in verdicts.items():
        # The planted curve without its noise: a sine of three periods a turn.
        angle, deviation = exact[:, joint - 1], (q - exact)[:, joint - 1]
        basis = np.stack((np.sin(3 * angle), np.cos(3 * angle), np.ones_like(angle)), axis=1)
        wave = np.linalg.lstsq(basis, deviation, rcond=None)[0]
        assert np.hypot(*wave[:2]) == pytest.approx(0.01 * FULL_SCALE_RAD, rel=0.05)
        figures = verdict.figures
        # A constant difference is part of the joint's offset.
        assert np.ptp(figures.curve(figures.angle_rad) - basis @ wave) < 0.002 * FULL_SCALE_RAD
        assert verdict.verdict is Soundness.CURVED
        assert verdict.treat_as_unsensed
        assert f"treat joint {joint} as unsensed" in verdict.text
        assert 1.5 < figures.noise.lsb < 2.6
    # The poses cover nearly all of joint 7's scale: half the peak-to-peak is the amplitude.
    assert verdicts[7].figures.half_range == pytest.approx(0.01, abs=0.001)
    assert verdicts[6].share + verdicts[7].share > 0.8


def test_linear_sensors_are_not_corrected():
    solution = calibrate(ARM, HINGE, load_poses(DATA / "hinge_quantised.csv").poses)
    for verdict in solution.rvdt:
        assert verdict.verdict is Soundness.SOUND
        assert not verdict.treat_as_unsensed
        assert verdict.figures.gain == pytest.approx(1.0, abs=1e-3)


def test_curve_beyond_2_percent_is_out_of_specification():
    verdict = verdicts_of(Simulation(bows=wrist_curves(6.0)), 1)[7]
    assert verdict.verdict is Soundness.OUT_OF_SPECIFICATION
    assert verdict.figures.linearity > 0.02


def test_excess_noise_is_out_of_specification():
    for verdict in verdicts_of(Simulation(wrist_sd=4.0 * LSB_RAD), 1).values():
        assert verdict.verdict is Soundness.OUT_OF_SPECIFICATION
        assert verdict.figures.noise.low < 4.0 < verdict.figures.noise.high
        assert re.search(r"noise of a single reading [34]\.\d LSB", verdict.text)


def test_gain_is_estimated():
    verdicts = verdicts_of(Simulation(poses=40, gains={6: 0.02}), 0)
    for joint, gain in ((6, 1.02), (7, 1.0)):
        assert verdicts[joint].figures.gain == pytest.approx(gain, abs=3e-3)


def test_few_poses_or_a_small_span_give_no_statement():
    few = verdicts_of(Simulation(poses=40), 0, poses=12)
    for verdict in few.values():
        assert verdict.verdict is Soundness.CANNOT_DECIDE
        assert verdict.figures is None
        assert not verdict.treat_as_unsensed
        assert "12 poses are too few" in verdict.text
    narrow = verdicts_of(Simulation(poses=40, spread_deg=6.0), 0)[6]
    assert narrow.verdict is Soundness.CANNOT_DECIDE
    assert "through only" in narrow.text


def test_compliant_fixture_is_not_blamed_on_the_sensor():
    """Deflections of 5 mrad hide 1 mrad of noise."""
    verdict = verdicts_of(Simulation(poses=40, flexure_m=1e-3, flexure_rad=5e-3), 0)[6]
    assert verdict.figures.noise.low == 0.0
    assert "noise of a single reading: not determined" in verdict.text
    assert verdict.verdict is Soundness.SOUND


def test_readings_beyond_the_table_use_its_ends(curved):
    (table, _) = reading_tables(curved)
    low, high = table.reading_rad[[0, -1]]
    readings = np.array([low - 0.2, low, high, high + 0.1])
    np.testing.assert_allclose(
        table.corrected(readings) - readings, table.add_rad[[0, 0, -1, -1]], atol=1e-15
    )
    assert table.beyond(readings) == 2


def test_command_line_applies_the_rvdt_table(curved, tmp_path, run_command):
    file = tmp_path / "p.yaml"
    remedies = tuple(map(rvdt_remedy, reading_tables(curved)))
    for remedy, read in zip(remedies, reading_tables(curved), strict=True):
        np.testing.assert_allclose(
            ReadingTable.of(remedy).add_rad, read.add_rad, rtol=0, atol=1e-15
        )

    def solve_with_table(**changes):
        save_parameters(file, replace(make_document(), rvdt=remedies, **changes))
        return run_command(0, "solve", CURVED, "--rvdt-table", file, "--json")

    answer = solve_with_table()
    assert "Readings of joint 6 corrected by up to " in answer.err
    result = answer.json
    assert [r["verdict"] for r in result["rvdt"]] == ["sound", "sound"]
    for verdict in result["rvdt"]:
        assert verdict["gain"] == pytest.approx(1.0, abs=0.002)
        assert verdict["linearity_percent_of_full_scale"] < 0.1
    sides = [result["side"][f"theta_off_{j}"] for j in (1, 2, 7)]
    assert sides == ["ground", "arm", "hand"]
    assert "CIRCULAR_TABLE" not in {w["code"] for w in result["warnings"]}
    warnings = solve_with_table(pose_set_sha256=load_poses(CURVED).poses.sha256()).json["warnings"]
    (circular,) = (w for w in warnings if w["code"] == "CIRCULAR_TABLE")
    assert "was made from these same poses" in circular["text"]


def test_file_without_rvdt_table_or_of_another_arm_is_refused(tmp_path, run_command):
    file = tmp_path / "p.yaml"
    save_parameters(file, make_document())
    command = ["solve", CURVED, "--rvdt-table", file]
    assert "no RVDT table" in run_command(2, *command).err
    errors = run_command(2, *command, "--arm", "franka_panda").err
    assert "sarcos_dextrous, these poses are from franka_panda" in errors


@pytest.mark.parametrize("seed", [103, 105])
def test_rvdt_ripple_within_linearity_is_accepted(seed):
    solution = solved(sinusoidal_rvdts(seed).taken)
    assert all(v.verdict is Soundness.CURVED for v in solution.rvdt)
    assert solution.accepted
    assert not [c for c in solution.causes if c.code.startswith("RVDT")]


def test_cause_and_verdict_of_a_nonlinear_rvdt_have_one_figure():
    case = CASES["RVDT 3 %"](3001)
    solution = solved(case.taken)
    first = solution.causes[0]
    assert first.code in case.causes
    (verdict,) = (v for v in solution.rvdt if v.verdict is Soundness.OUT_OF_SPECIFICATION)
    assert f"({100.0 * verdict.figures.linearity:.1f} % of full scale" in first.text


def test_insignificant_excess_of_linearity_is_worded_as_such():
    verdict = next(v for v in solved(sinusoidal_rvdts(222).taken).rvdt if v.joint == 7)
    assert verdict.figures.linearity > 0.02
    assert verdict.verdict is Soundness.CURVED
    assert "within specification" not in verdict.text
    assert "not significantly beyond its specification" in verdict.text
    assert (
        f"(sigma {100.0 * verdict.figures.linearity_sd:.2f} %, specification 2 %)" in verdict.text
    )


def test_motion_in_one_pose_names_the_pose():
    solution = solved(spread_out(session(61), (4, 5), 5.0))
    assert [c.code for c in solution.causes] == ["UNSTEADY_6"]
    assert (solution.causes[0].poses, solution.causes[0].sensor) == (("p005",), "RVDT")
    verdict = next(v for v in solution.rvdt if v.joint == 6)
    assert verdict.verdict is not Soundness.OUT_OF_SPECIFICATION
    assert verdict.noise.lsb == pytest.approx(2.0, rel=0.1)


def test_cause_of_non_convergence_comes_first():
    solution = solved(spread_out(session(61), np.s_[:, 5:], 50.0))
    assert not solution.accepted
    assert [c.code for c in solution.causes] == ["RVDT_6", "RVDT_7", "NOT_CONVERGED"]
    text = " ".join(facts_text(facts_of(solution)).split())
    positions = [
        text.index(words) for words in ("RVDT of joint 6", "RVDT of joint 7", "did not converge")
    ]
    assert positions == sorted(positions)
    assert "(sd6_deg)" in text


@pytest.mark.parametrize(("lsb", "samples"), [(1.0, 32), (8.0, 32), (4.0, 8), (2.0, 8)])
def test_spread_within_poses_gives_single_reading_noise(lsb, samples):
    for verdict in solved(session(7003, Sizes(noise_lsb=lsb), samples=samples)).rvdt:
        assert verdict.noise.lsb == pytest.approx(lsb, rel=0.1)
        assert f"noise of a single reading {verdict.noise.lsb:.1f} LSB" in verdict.text
        # 2 LSB are allowed for a single reading; means of 32 readings of 8 LSB would pass.
        assert (verdict.verdict is Soundness.OUT_OF_SPECIFICATION) == (lsb > 2.5)


def test_noise_is_undetermined_without_spread():
    poses = poses_of(session(7003, Sizes(noise_lsb=1.0)))
    for verdict in calibrate(ARM, HINGE, replace(poses, sd_rad=None)).rvdt:
        assert not verdict.noise.determined
        assert verdict.noise.high > 1.0
        assert "not determined by these poses, below" in verdict.text
        assert verdict.verdict is not Soundness.OUT_OF_SPECIFICATION


def test_several_placements_give_noise():
    poses = poses_of(session(7003, Sizes.only()))
    verdicts = calibrate(ARM, HINGE, replace(poses, placement=np.arange(len(poses)) % 2 + 1)).rvdt
    for verdict in verdicts:
        assert verdict.noise.lsb == pytest.approx(2.0, rel=0.1)
        assert "solve one placement alone" in verdict.text
    assert len(verdicts) == 2


def ball_session(seed, *, lsb, samples):
    """Poses of a tool on a ball, and the ball at its true place."""
    angles = ball_instead_of_hinge(seed).taken.angles
    specimen = Specimen.drawn(seed, Sizes(noise_lsb=lsb))
    chain = specimen.chain
    tip = np.array([chain.a[7], 0.0, chain.s[7]])
    T = frames(chain, angles)
    tool = np.linalg.inv(T[:, 1]) @ T[:, 7] @ rotation_about_z(angles[:, 7])
    ground = (tool @ np.append(tip, 1.0))[:, :3]
    assert np.ptp(ground, axis=0).max() < 1e-9
    compliance = HINGE.compliance
    ball = Ball(tip_m=tuple(tip), ground_m=tuple(ground[0]), compliance=compliance)
    return taken(specimen, angles, samples=samples), ball


@pytest.mark.parametrize(("lsb", "samples"), [(1.0, 32), (2.0, 8), (8.0, 32), (2.0, 1), (8.0, 1)])
def test_ball_poses_give_noise_but_no_linearity(lsb, samples):
    simulated, ball = ball_session(7003, lsb=lsb, samples=samples)
    verdicts = calibrate(ARM, ball, poses_of(simulated), drop=True).rvdt
    assert [v.joint for v in verdicts] == [6, 7]
    for verdict in verdicts:
        noise = verdict.noise
        assert "these poses do not determine" in verdict.text
        assert "mrad" not in verdict.text
        assert lsb > 2.5 or verdict.verdict is Soundness.CANNOT_DECIDE
        assert noise.from_spread == (samples > 1)
        if samples > 1:
            assert noise.lsb == pytest.approx(lsb, rel=0.1)
        else:
            assert noise.low <= lsb <= noise.high
