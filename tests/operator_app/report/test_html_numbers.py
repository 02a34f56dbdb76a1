"""The numbers on a page are those of the session and of its solution."""

import math

import numpy as np
import pytest
from scipy.stats import t

from operator_app.report.html.page import report_html
from operator_app.session.store.journal import read_journal
from tests.operator_app.report.conftest import number, report_subject


def test_page_compares_both_estimators(page, subject):
    paper = subject.solution.paper
    assert paper is not subject.implicit
    assert "implicit (chosen)" in page.text
    rows = page.rows("Identified parameters")
    assert number(rows[0][-1]) == pytest.approx(math.degrees(paper.x[0]), abs=1e-3)
    assert {row[0]: row[9] for row in rows} == subject.facts.data["side"]
    name, _, value, sigma, paper_value, paper_sigma, difference = page.rows("Both estimators")[0]
    assert name == "theta_off_1"
    assert number(value) == pytest.approx(math.degrees(subject.implicit.x[0]), abs=1e-3)
    assert number(paper_value) == pytest.approx(math.degrees(paper.x[0]), abs=1e-3)
    for shown, estimate in ((sigma, subject.implicit), (paper_sigma, paper)):
        expected = math.degrees(estimate.standard_deviation[0])
        assert number(shown) == pytest.approx(expected, rel=0.06)
    change = math.degrees(paper.x[0] - subject.implicit.x[0])
    assert number(difference) == pytest.approx(change, abs=1e-3)
    assert "Use implicit" in page.text


def test_joint_table_compares_with_stated_sigma(page, subject):
    stated = [
        # Two harmonics, backlash and sag of 0.01 deg each.
        *[math.radians(0.01) * 2.0 * 1e3] * 5,
        # Noise, gain over full scale, backlash and sag; then part of the linearity deviation.
        *[math.hypot(1.03, 0.005 * math.radians(120.0) / math.sqrt(12.0) * 1e3)] * 2,
    ]
    joints = page.rows("Joints:")
    for row, least in zip(joints[:5], stated[:5], strict=True):
        assert number(row[4]) == pytest.approx(least, rel=0.02)
    peak = 0.02 * math.radians(120.0) * 1e3
    for row, least in zip(joints[5:], stated[5:], strict=True):
        assert math.hypot(least, 0.25 * peak) < number(row[4]) < math.hypot(least, 0.5 * peak)
    for row in joints:
        assert number(row[6]) == pytest.approx(number(row[5]) / number(row[4]), rel=0.08)
        assert not row[6].startswith("▲")


def test_page_has_closure_before_after_and_held_out(page, subject):
    rows = {row[0]: [number(cell) for cell in row[1:]] for row in page.rows("Closure at")}
    for name, sigmas in (
        ("nominal, before", subject.solution.before),
        ("implicit (chosen), after", subject.solution.estimate.sigmas),
    ):
        position, orientation = sigmas.position_m, sigmas.orientation_rad
        figures = (position.rms, position.as_printed, orientation.rms, orientation.as_printed)
        assert rows[name] == pytest.approx([1e3 * figure for figure in figures], rel=1e-3)
    held_out = next(values for name, values in rows.items() if "held out" in name)
    sigmas = subject.checks.held_out.sigmas
    assert held_out[0] == pytest.approx(1e3 * sigmas.position_m.rms, rel=1e-3)
    assert held_out[2] == pytest.approx(1e3 * sigmas.orientation_rad.rms, rel=1e-3)


def test_page_lists_all_poses_and_joints(page, subject):
    poses = page.rows("Captured poses")
    assert [row[0] for row in poses] == [str(p.number) for p in subject.poses]
    assert "Excluded by the operator: 4" in page.text
    for row, pose in zip(poses, subject.poses, strict=True):
        assert [number(cell) for cell in row[2:9]] == pytest.approx(
            np.rad2deg(pose.mean_rad).tolist(), abs=6e-4
        )
    assert poses[3][10] == "n/a"
    joints = page.rows("Joints:")
    assert [row[2] for row in joints] == [
        "position", "free", "free", "free", "position", "free", "free",
    ]  # fmt: skip
    assert "RVDT, 12 bit over 120 deg" in joints[5][1]
    low = np.rad2deg(subject.readings_rad).min(axis=0)
    assert [number(row[7]) for row in joints] == pytest.approx(low.tolist(), abs=0.006)


def test_page_has_rvdt_verdicts_and_condition(page, subject):
    assert len(subject.solution.rvdt) == 2
    assert page.rows("Corrections of RVDT readings")
    for verdict in subject.solution.rvdt:
        assert verdict.text in page.text
    rows = {row[0]: row[1:] for row in page.rows("How well the poses")}
    condition = subject.solution.identifiability.scaled_condition_number
    assert number(rows["scaled condition number"][0]) == pytest.approx(condition, rel=5e-3)
    assert "limit 100" in rows["scaled condition number"][1]
    assert rows["rank"] == ["14", "of 14"]
    shown = [number(row[1]) for row in page.rows("Observability")]
    assert shown == pytest.approx(list(subject.solution.identifiability.observability), rel=5e-3)


def test_page_of_the_paper_estimator(folder, parse_page):
    subject = report_subject(read_journal(folder).events, estimator="paper")
    page = parse_page(report_html(subject).decode())
    assert "paper (chosen)" in page.text
    # Student's interval: the noise is estimated from residuals.
    estimate = subject.solution.estimate
    row = page.rows("Identified parameters")[0]
    half = t.ppf(0.975, estimate.dof) * math.degrees(estimate.standard_deviation[0])
    assert number(row[7]) - number(row[6]) == pytest.approx(2.0 * half, rel=0.02)


def test_page_names_unsensed_joints(folder, parse_page):
    subject = report_subject(read_journal(folder).events, unsensed_joints=(6, 7))
    page = parse_page(report_html(subject).decode())
    assert "The readings of joints 6 and 7 were not used" in page.text
    assert "theta_off_6" not in [row[0] for row in page.rows("Identified parameters")]
    assert "The paper's estimator, which needs every joint sensed" in page.text
    assert page.rows("Joints:")[5][1].endswith("(reading not used)")
