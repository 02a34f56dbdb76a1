"""Strip and banner fit 80 columns."""

from dataclasses import replace

import pytest

from hardware.arm import DriveState, JointMode
from operator_app.session.ui.snapshot import DataState, StopReport, TaskKind
from operator_app.tui.widgets.status import Banner, SafetyStrip
from tests.oracles.story import busy, lost, real, stale, stopped, story, tripped, unstopped


@pytest.fixture(scope="module")
def capturing():
    return story()["capturing"]


def line_of(panel, picture, width: int = 80) -> str:
    (row,) = panel._build(picture, width, 1)
    return "".join(text for text, _ in row)


def silent_and_tripped(capturing):
    s = tripped(stale(capturing))
    arm = replace(s.arm, heartbeat_age_s={**s.arm.heartbeat_age_s, 5: 0.9})
    return replace(s, arm=arm)


@pytest.mark.parametrize(
    "change",
    [
        pytest.param(stopped, id="stopped"),
        pytest.param(lambda s: real(stopped(s)), id="stopped for real"),
        pytest.param(unstopped, id="not stopped"),
        pytest.param(real, id="real"),
        pytest.param(lost, id="lost"),
        pytest.param(lambda s: busy(s, TaskKind.AUTOMATIC, moves=True), id="moving"),
        pytest.param(silent_and_tripped, id="silent and tripped"),
    ],
)
def test_strip_and_banner_fit_80_columns(capturing, change):
    picture = change(capturing)
    assert "…" not in line_of(SafetyStrip(), picture) + line_of(Banner(), picture)


def test_full_strip_abbreviates_drive_state(capturing):
    strip = line_of(SafetyStrip(), silent_and_tripped(capturing))
    assert strip.endswith("│DRV ■ J4 FAULT")
    assert all(part in strip for part in ("HB ▲ N5 LATE", "DATA ▲ J5 STALE"))


def test_unsent_stop_names_the_remedy_before_the_cause(capturing):
    problem = "the interface has gone away and does not come back"
    line = line_of(Banner(), replace(capturing, stop=StopReport(asked_s=0.0, problem=problem)))
    assert "could NOT be sent: use the hardware stop" in line


def test_joint_that_has_not_stopped_takes_precedence(capturing, approve):
    approve(line_of(Banner(), unstopped(capturing)))


def test_stop_by_lost_data_is_not_shown_as_software_stop(capturing):
    silent = replace(stopped(capturing), data=DataState.LOST)
    assert "DATA LOST" in line_of(Banner(), replace(silent, stop=None))
    assert "SOFTWARE STOP" in line_of(Banner(), silent)


def test_strip_counts_drives_in_fault(capturing):
    joints = tuple(replace(j, drive=DriveState.FAULT) for j in capturing.arm.joints)
    strip = line_of(SafetyStrip(), replace(capturing, arm=replace(capturing.arm, joints=joints)))
    assert strip.endswith("│DRV ■ 7 FAULT")


def test_bus_with_stale_data_is_not_ok(capturing):
    assert "BUS ● ok" in line_of(SafetyStrip(), capturing)
    assert "BUS ▲│" in line_of(SafetyStrip(), stale(capturing))
    assert "BUS ▲ LATE │" in line_of(SafetyStrip(), stale(capturing), 120)


def test_nothing_is_claimed_about_an_arm_without_data(capturing):
    banner = line_of(Banner(), lost(capturing))
    assert "unknown" in banner
    assert "hold" not in banner


def test_modes_of_four_drives_stay_in_the_strip(capturing):
    joints = tuple(
        replace(j, mode=JointMode.POSITION if j.joint in (1, 5, 6, 7) else JointMode.FREE)
        for j in capturing.arm.joints
    )
    s = replace(capturing, arm=replace(capturing.arm, joints=joints))
    assert "POS J1 J5 J6 J7 " in line_of(SafetyStrip(), s, 120)
