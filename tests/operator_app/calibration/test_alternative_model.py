"""Shifts of one reading and wrong fixture kinds, as alternative models; remedies that work."""

import re
import shlex

import numpy as np
import pytest

from operator_app.calibration.alternative_model import shift_of
from operator_app.cli import main
from operator_app.config.fixture_file import load_fixture
from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.as_shipped import solved
from tests.oracles.shop_floor import session
from tests.oracles.shop_floor_faults import CASES

POSES = 40


@pytest.fixture(scope="module")
def angle():
    return np.random.default_rng(3).uniform(2.0, 3.5, POSES)


@pytest.mark.parametrize(("first", "size"), [(3, 0.02), (20, -0.5), (POSES - 3, 0.02)])
@pytest.mark.parametrize("turns", [0, 1], ids=["", "wrapped"])
def test_shift_is_found_beside_offset_harmonic_and_turns(angle, first, size, turns):
    reading = (
        angle - 3.1 + 0.01 * np.cos(2.0 * angle) + 2.0 * np.pi * turns * (np.arange(POSES) % 2)
    )
    reading[first:] += size
    assert shift_of(reading, angle) == (first, pytest.approx(size, abs=2e-3))


def test_harmonics_noise_and_few_poses_show_no_shift(angle):
    assert shift_of(angle + 0.05 * np.sin(3.0 * angle), angle) is None
    noise = np.random.default_rng(4).normal(size=POSES)
    assert shift_of(angle + 0.1 * noise, angle) is None
    assert shift_of(angle[:8], angle[:8]) is None


def test_large_rvdt_shift_is_the_first_cause():
    case = CASES["joint slips 50 counts"](3015)  # 1.5 deg: the fit diverges
    assert case.causes == ("STEP_JOINT_7",)
    (first, *_) = solved(case.taken).causes
    assert first.code == "STEP_JOINT_7"
    assert first.blocking


COMMAND = re.compile(r"sarcal (new fixture[^\n;]*)")


@pytest.mark.campaign
@pytest.mark.parametrize("fixture", ["hinge", "sarcos_ball"])
def test_wrong_fixture_kind_is_named_and_its_remedy_works(fixture, tmp_path, monkeypatch):
    monkeypatch.chdir(tmp_path)
    ball = fixture == "hinge"
    taken = CASES["ball for hinge"](3000).taken if ball else session(3000)
    first = outcome(taken, fixture=load_fixture(fixture).fixture)
    assert first.causes[0] == "WRONG_FIXTURE", first.text
    assert ("--drop-unidentifiable" in first.text) == ball
    command = COMMAND.search(first.text)
    assert command is not None, first.text
    assert main(shlex.split(command[1])) == 0
    again = outcome(taken, fixture=load_fixture("found.yaml").fixture, drop=ball)
    assert again.accepted, again.text


def test_hinge_poses_solved_as_a_ball_are_named():
    result = outcome(session(3001), fixture=load_fixture("sarcos_ball").fixture, drop=True)
    assert "WRONG_FIXTURE" in result.causes, result.causes
