"""A ball for a hinge and a hinge for a ball are told from noise, and what the remedy says works."""

from __future__ import annotations

import re
import shlex
from dataclasses import replace

import numpy as np
import pytest

from operator_app.cli import main
from operator_app.config.fixture_file import load_fixture
from tests.benchmarks.shop_floor_outcome import outcome
from tests.oracles.shop_floor import session
from tests.oracles.shop_floor_faults import CASES

COMMAND = re.compile(r"sarcal (new fixture[^\n;]*)")


def test_a_hinge_read_with_much_noise_is_no_ball():
    """Its position misclosure is just below 2 mm, as that of a ball would be."""
    found = session(61)
    noise = np.random.default_rng(61).normal(size=found.readings.shape)
    found = replace(found, readings=found.readings + np.deg2rad(0.2) * noise)
    said = outcome(found)
    assert not said.accepted
    assert "WRONG_FIXTURE" not in said.causes


@pytest.mark.campaign
@pytest.mark.parametrize("fixture", ["hinge", "sarcos_ball"])
def test_the_other_fixture_is_named_and_its_remedy_works(fixture, tmp_path, monkeypatch):
    """Poses of a ball solved as a hinge's, and the other way round: the command that is said is run."""
    monkeypatch.chdir(tmp_path)
    ball = fixture == "hinge"
    taken = CASES["ball for hinge"](3000).taken if ball else session(3000)
    first = outcome(taken, fixture=load_fixture(fixture).fixture)
    assert first.causes[0] == "WRONG_FIXTURE", first.said
    assert ("--drop-unidentifiable" in first.said) == ball
    command = COMMAND.search(first.said)
    assert command is not None, first.said
    assert main(shlex.split(command[1])) == 0
    again = outcome(taken, fixture=load_fixture("found.yaml").fixture, drop=ball)
    assert again.accepted, again.said


def test_a_hinge_dropped_into_a_ball_is_named():
    """--drop-unidentifiable leaves a centre that may be anywhere along the hinge."""
    said = outcome(session(3001), fixture=load_fixture("sarcos_ball").fixture, drop=True)
    assert "WRONG_FIXTURE" in said.causes, said.causes
