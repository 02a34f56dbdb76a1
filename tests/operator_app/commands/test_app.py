"""The message when the app ends: state of the arm, session folder, command to continue."""

import pytest

from operator_app.commands.app import farewell
from tests.oracles.live_arm import FakeSessions


def close_and_report(source: FakeSessions, reason: str = "left", *, plain: bool = False) -> str:
    source.close(reason)
    assert source.last is not None
    return farewell(source, source.last, reason, plain=plain)


@pytest.fixture
def source(source):
    runner = source.new()
    runner.operations.connect()
    runner.operations.set_modes((1, 5))
    runner.operations.capture(0)
    return source


@pytest.mark.parametrize(
    ("reason", "words", "plain", "option"),
    [("SIGTERM", "ended by SIGTERM", False, ""), ("interrupted", "interrupted", True, "--plain ")],
)
def test_connected_arm_is_reported_as_held_with_the_command_to_continue(
    source, reason, words, plain, option
):
    message = close_and_report(source, reason, plain=plain)
    assert message.startswith(f"sarcal: {words}; the arm is held. Session ")
    assert message.endswith(f"\nGo on with: sarcal {option}--resume {source.last}")
    assert "parameters.yaml" not in message


def test_unresponsive_arm_is_not_reported_as_held(source, monkeypatch):
    monkeypatch.setattr(source.arm, "close", lambda: False)
    message = close_and_report(source)
    assert "held" not in message
    assert "the arm did not answer: keep clear" in message


def test_disconnected_arm_is_not_mentioned(source):
    source.runner.session.release_holding()
    assert close_and_report(source).startswith("sarcal: Session ")


def test_written_files_are_named(source):
    runner = source.runner
    runner.operations.automatic()
    runner.operations.calibrate("implicit", ())
    runner.operations.write()
    message = close_and_report(source)
    assert "parameters.yaml and poses.csv are in it" in message
    assert f"sarcal report {source.last}" in message
