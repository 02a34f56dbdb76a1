"""What `sarcal reset` says: what stays once where it is the arm's, and joint by joint where it is theirs."""

import pytest

from operator_app.commands.reset import report

STOP, TORQUE = "external stop, first contact (5441h)", "excess torque (8311h)"


def said(
    capsys: pytest.CaptureFixture[str], cleared: dict[int, str], stays: dict[int, str]
) -> tuple[str, list[str]]:
    report(cleared, stays, arm_joints=7, in_json=False)
    captured = capsys.readouterr()
    return captured.out, captured.err.splitlines()


def test_a_stop_contact_that_is_still_pressed_is_said_once(
    capsys: pytest.CaptureFixture[str],
) -> None:
    _, (line,) = said(capsys, {}, dict.fromkeys(range(1, 8), STOP))
    assert line.startswith(f"sarcal: the arm still has a fault: {STOP}. ")


def test_what_is_some_joints_own_is_said_of_each(capsys: pytest.CaptureFixture[str]) -> None:
    _, lines = said(capsys, {}, {2: TORQUE, 5: TORQUE, 6: STOP})
    assert [line.partition(" still")[0] for line in lines] == [
        "sarcal: joint 2",
        "sarcal: joint 5",
        "sarcal: joint 6",
    ]


def test_with_nothing_tripped_it_says_what_connecting_reset(
    capsys: pytest.CaptureFixture[str],
) -> None:
    out, lines = said(capsys, {}, {})
    assert not lines
    assert "No drive has a fault" in out
    assert "reset the nodes' communication" in out
