"""Host latency is reported once each time and journalled; the arm is not blamed for it."""

import errno
import os

import pytest

from hardware.arm import HostLatency
from hardware.canopen.objects import EmergencyCode
from hardware.errors import DriveFault
from operator_app.composition import CutShort
from operator_app.errors import JournalError
from operator_app.headless.console import ConsoleListener, cut_short_lines
from operator_app.session.safety.latency import MIN_INTERVAL_S, LatenessReporter
from operator_app.session.store.journal import read_journal
from operator_app.session.store.replay import session_state
from operator_app.session.ui.operations import Operations
from operator_app.session.workflow.drive_selection import visit
from tests.oracles.journal_events import event_data
from tests.oracles.journalled_sessions import Quiet
from tests.oracles.plant_sessions import short_procedure


def late(times: int, last_s: float, longest_s: float) -> HostLatency:
    return HostLatency(times=times, last_s=last_s, longest_s=longest_s)


def test_one_delay_is_one_message_and_a_series_one_per_interval(approve):
    text = LatenessReporter().new_text
    assert text(HostLatency(), 1000.0) == ""
    approve(text(late(1, 0.4, 0.4), 1000.1))
    assert text(late(1, 0.4, 0.4), 1000.2) == ""
    for k in range(2, 8):  # again and again, a second apart
        assert text(late(k, 0.5, 0.9), 1000.0 + k) == ""
    series = text(late(7, 0.5, 0.9), 1001.0 + MIN_INTERVAL_S)
    assert "late 6 times, the last time by 0.5 s:" in series
    assert text(late(7, 0.5, 0.9), 2000.0) == ""
    assert "late by 0.5 s:" in text(late(8, 0.5, 0.9), 2000.0)


@pytest.fixture
def busy(make_session):
    return make_session(short_procedure(40), connect=True)


def test_latency_is_in_the_journal_and_reported_at_the_next_pose(busy, capsys):
    listener = ConsoleListener()
    busy.take_control()
    busy.set_modes((1, 5))
    lateness = iter((late(0, 0.0, 0.0), late(1, 0.4, 0.4), late(1, 0.4, 0.4), late(3, 0.5, 0.9)))
    for waypoint, busy.arm.lateness in enumerate(lateness):
        assert visit(busy, waypoint)
        busy.capture(waypoint)
        listener.pose_captured(busy.state, 10)
    busy.arm.lateness = late(4, 2.0, 2.0)  # after the last pose
    busy.close("end of the test")
    journalled = [(data["times"], data["last_s"]) for data in event_data(busy, "late")]
    assert journalled == [(1, 0.4), (2, 0.5), (1, 2.0)]
    contents = read_journal(busy.journal.path.parent)
    assert session_state(contents).late == late(4, 2.0, 2.0)
    parts = capsys.readouterr().err.split("Warning: ")
    first, second = (part for part in parts if "this computer" in part)
    assert "late by 0.4 s" in first
    assert "late 2 times, the last time by 0.5 s" in second


@pytest.mark.parametrize(
    ("code", "times", "text"),
    [
        (EmergencyCode.HEARTBEAT_LOST, 1, "This computer was late by 0.83 s: the drives missed"),
        (EmergencyCode.HEARTBEAT_LOST, 3, "by 0.83 s (3 times, by 0.90 s at most)"),
        (EmergencyCode.HEARTBEAT_LOST, 0, ""),
        (EmergencyCode.FOLLOWING, 1, ""),
    ],
)
def test_a_run_ended_by_missed_heartbeats_reports_host_latency(busy, code, times, text):
    """No pose follows at which it could be reported."""
    busy.take_control()
    busy.set_modes((1, 5))
    busy.capture()
    if times:
        busy.arm.lateness = late(times, 0.83, 0.9 if times > 1 else 0.83)
    busy.close("failed")
    fault = DriveFault(1, code, "heartbeat or not")
    cut_short = CutShort(session=busy, cause=fault, connected=True, kept=True)
    lines = [line for line in cut_short_lines(cut_short) if "This computer was late" in line]
    assert len(lines) == bool(text)
    assert text in "".join(lines)


def test_latency_before_a_reconnect_is_journalled(busy):
    busy.arm.lateness = late(2, 0.4, 0.7)
    closed = busy.arm.closed
    Operations(busy, Quiet(busy)).connect()
    assert busy.arm.closed == closed + 1
    assert event_data(busy, "late") == [{"times": 2, "last_s": 0.4, "longest_s": 0.7}]


def test_the_arm_is_released_despite_full_disk_and_latency(busy, monkeypatch):
    busy.arm.lateness = late(1, 0.4, 0.4)

    def full(_descriptor: int, _data: bytes) -> int:
        raise OSError(errno.ENOSPC, "no space left on device")

    closed = busy.arm.closed
    monkeypatch.setattr(os, "write", full)
    with pytest.raises(JournalError, match="no space"):
        busy.close("end of the test")
    assert busy.arm.closed == closed + 1
    assert busy.journal.closed
