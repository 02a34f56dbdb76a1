"""What is said when the app is left: what the arm does, where the session is, how to come back to it."""

import pytest

from operator_app.commands.app import farewell
from tests.oracles.live_source import FakeSource


def left(source: FakeSource, reason: str = "left") -> str:
    source.close(reason)
    assert source.last is not None
    return farewell(source, source.last, reason)


@pytest.fixture
def source(source):
    """With a pose in its session."""
    runner = source.new()
    runner.operations.connect()
    runner.operations.set_modes((1, 5))
    runner.operations.capture(0)
    return source


def test_an_arm_that_answered_is_held(source):
    said = left(source, "SIGTERM")
    assert said.startswith("sarcal: ended by SIGTERM; the arm is held. Session ")
    assert said.endswith(f"\nGo on with: sarcal --resume {source.last}")
    assert "parameters.yaml" not in said


def test_an_arm_that_did_not_answer_is_not_said_to_be_held(source, monkeypatch):
    monkeypatch.setattr(source.arm, "close", lambda: False)
    said = left(source)
    assert "held" not in said
    assert "the arm did not answer: keep clear" in said


def test_of_an_arm_that_is_not_connected_any_more_nothing_is_said(source):
    assert source.runner is not None
    source.runner.session.release_holding()
    assert left(source).startswith("sarcal: Session ")


def test_what_was_written_is_named(source):
    runner = source.runner
    assert runner is not None
    runner.operations.automatic()
    runner.operations.results.calibrate("implicit", ())
    runner.operations.results.write()
    said = left(source)
    assert "parameters.yaml and poses.csv are in it" in said
    assert f"sarcal report {source.last}" in said


def test_who_left_plain_mode_comes_back_to_it(source):
    source.close("left")
    assert source.last is not None
    said = farewell(source, source.last, "left", plain=True)
    assert said.endswith(f"\nGo on with: sarcal --plain --resume {source.last}")
