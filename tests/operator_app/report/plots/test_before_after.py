"""Pictures before and after calibration are to scale and agree with the page's tables."""

import re

import numpy as np
import pytest
import sarcal

from operator_app.config.poses_file import load_poses
from operator_app.report.plots.before_after import arm_pair, hand_pair
from tests.operator_app.report.conftest import number
from tests.oracles.open_arm import write_measured_poses


def test_before_and_after_pictures_agree_with_the_tables(page, subject):
    hand, arm = hand_pair(subject), arm_pair(subject)
    arm_before, arm_after = arm.pictures
    for one, other in (hand.pictures, arm.pictures):
        assert (one.x, one.y) == (other.x, other.y)
        for picture in (one, other):
            assert picture.title in page.text
            assert picture.x.high - picture.x.low == pytest.approx(
                picture.aspect * (picture.y.high - picture.y.low)
            )
    # Mark areas are relative to the worst error before.
    accuracy = subject.solution.accuracy
    worst, spreads = accuracy.before.worst, (accuracy.before, accuracy.after)
    for picture, spread in zip(hand.pictures, spreads, strict=True):
        (marks,) = picture.layers
        assert max(marks.sizes) * worst == pytest.approx(spread.worst)
        assert np.sqrt(np.mean(np.square(marks.sizes))) * worst == pytest.approx(spread.rms)
        match = re.search(r" ([\d.]+) mm rms$", picture.title)
        assert float(match[1]) == pytest.approx(1e3 * spread.rms, rel=5e-3)
    # The gap is that of the table of poses.
    number_, size = re.fullmatch(
        r"After: the loop of pose (\d+) stays open by ([\d.]+) mm", arm_after.title
    ).groups()
    (row,) = (row for row in page.rows("Captured poses") if row[0] == number_)
    assert number(size) == pytest.approx(number(row[10]), rel=5e-3)
    before = float(arm_before.title.split()[-2])
    assert before > 3.0 * number(size)
    # Chain and gap are drawn to scale.
    factor = re.search(r"drawn (\d+) times", arm_after.description + arm_before.title + arm.note)
    times = 1.0 if factor is None else float(factor[1])
    (gap,) = (layer for layer in arm_before.layers if layer.label == "gap")
    assert np.hypot(np.ptp(gap.x), np.ptp(gap.y)) <= 1.01 * times * before


def test_open_arm_gap_agrees_with_the_measurement(tmp_path):
    """By the triangle of base, tool and endpoint."""
    file = write_measured_poses(tmp_path / "open.csv")
    poses = sarcal.load_poses(file)
    result = sarcal.calibrate(
        arm="sarcos_dextrous", fixture="tracker", poses=poses, drop_unidentifiable=True
    )
    pair = arm_pair(result._subject)
    match = re.fullmatch(
        r"After: the tool of pose (\d+) is ([\d.]+) mm from where it was measured",
        pair.pictures[1].title,
    )
    k = int(match[1]) - 1
    endpoint = load_poses(file).poses.endpoint
    measured = endpoint[k, :3]
    base = [result.values.get(f"base_{axis}_mm", 0.0) / 1e3 for axis in "xyz"]
    # Distances are the same in the instrument's frame and in the base.
    measured_m = np.linalg.norm(measured - base)
    tool_m = np.linalg.norm(result.fk(poses.q_rad[k])[:3, 3])
    assert 1e3 * abs(tool_m - measured_m) <= 1.01 * float(match[2]) < 1.0
    before = re.search(r" is ([\d.]+) mm from", pair.pictures[0].title)
    assert float(before[1]) > 10.0
