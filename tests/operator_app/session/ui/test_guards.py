"""Every guard, with its conditions met, and the reasons that it gives otherwise."""

from dataclasses import replace
from types import SimpleNamespace

import pytest

from fixtures.base import CheckKind, SetupCheck, Severity
from hardware.arm import DriveState, Fault, JointMode
from operator_app.session.ui import action_table, guards
from operator_app.session.ui.snapshot import ARM_RECOVERY, Level, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step
from operator_app.session.ui.user_interface import perform_action
from tests.oracles.story import lost, real, stale, stopped, story, tripped, with_joints

FIRST_CLOSED = {
    "start": Step.FIXTURE,
    "connected": Step.MODES,
    "ticked": Step.CAPTURE,
    "modes": Step.CALIBRATE,
    "capturing": Step.RESULTS,  # three poses leave a degree of freedom
    "captured": Step.RESULTS,
    "solved": None,
    "written": None,
    "uploaded": Step.CAPTURE,  # all joints are in position mode
}


def ours(s: SessionSnapshot) -> SessionSnapshot:
    """Data that are old because of this computer."""
    return replace(stale(s), arm=replace(stale(s).arm, late_s=0.2))


@pytest.mark.parametrize("name", FIRST_CLOSED)
def test_steps_become_available_in_order(name):
    missing = {step: guards.missing_for(step, story()[name]) for step in Step}
    assert next((step for step in Step if missing[step]), None) is FIRST_CLOSED[name]
    for step, reason in missing.items():
        assert not reason or (len(reason) > 15 and reason[-1] != "."), step


def refused(s):
    text = "the hinge axis makes an angle of 0.2 deg with joint 1's axis"
    what = {"kind": CheckKind.AXIS_ANGLE, "severity": Severity.REFUSED}
    bad = SetupCheck(**what, text=text, remedy="tilt the hinge")
    return replace(s, checks=(*s.checks, bad))


def interrupted(s):
    return replace(s, state=replace(s.state, resumed=True))


def resumed(s):
    """A session with a calibration, before it is connected."""
    return replace(s, solution=None, identity=None, arm=None)


def slipped(s):
    return replace(s, state=replace(s.state, sensor_jump="joint 3 jumped by +2223 counts"))


def switched_off(s):
    fault = Fault(node=3, joint=3, code=0, text="the drive is in state 'switched on'", sync_count=9)
    return replace(s, arm=replace(s.arm, faults=(fault,)))


def all_off(s):
    """Every drive is off, as after a reset."""
    return with_joints(s, lambda j: replace(j, drive=DriveState.SWITCH_ON_DISABLED))


def misreported(s):
    """A drive is in another mode than it was put into."""
    return with_joints(s, lambda j: replace(j, mode=JointMode.FREE) if j.joint == 1 else j)


def not_accepted(s):
    return replace(s, solution=replace(s.solution, reasons=("condition 900 is above 100",)))


@pytest.mark.parametrize(
    ("guard", "name", "change"),
    [
        ("fixture_ready", "start", None),
        ("fixture_ready", "connected", real),
        ("modes_ready", "connected", None),
        ("modes_ready", "ticked", refused),
        ("modes_ready", "ticked", lambda s: replace(s, checks=())),
        ("capture_ready", "ticked", None),
        ("capture_ready", "modes", stopped),
        ("may_move", "uploaded", lambda s: s),
        ("may_capture", "uploaded", lambda s: s),
        ("capture_ready", "modes", tripped),
        ("capture_ready", "modes", misreported),
        ("calibrate_ready", "modes", None),
        ("results_ready", "captured", None),
        ("results_ready", "solved", resumed),
        ("results_ready", "solved", lambda s: replace(s, solution=None)),
        ("export_ready", "captured", None),
        ("export_ready", "solved", not_accepted),
        ("may_connect", "connected", None),
        ("may_use_data", "start", None),
        ("may_use_data", "modes", stopped),
        ("may_use_data", "modes", stale),
        ("may_use_data", "modes", ours),
        ("may_use_data", "modes", lost),
        ("may_capture", "modes", stale),
        ("may_capture", "ticked", None),
        ("may_capture", "capturing", interrupted),
        ("may_capture", "capturing", slipped),
        ("may_move", "modes", lost),
        ("may_move", "modes", lambda s: replace(s, next_waypoint=None)),
        ("may_run_automatically", "captured", None),
        ("may_run_automatically", "modes", stopped),
        ("may_edit_pose", "modes", None),
        ("may_calibrate", "modes", None),
        (
            "may_calibrate",
            "captured",
            lambda s: replace(s, estimator="paper", unsensed_joints=(6,)),
        ),
        ("may_write", "captured", None),
        ("may_write", "solved", not_accepted),
        ("may_upload", "solved", stale),
        ("may_report", "captured", None),
        ("may_verify", "captured", None),
        ("may_verify", "uploaded", stopped),
        ("may_verify", "uploaded", lambda s: replace(s, selected_joints=(3,))),
        ("may_reset", "modes", None),
        ("capture_ready", "modes", all_off),
    ],
)
def test_unmet_conditions_are_reported(guard, name, change, approve):
    missing = getattr(guards, guard)((change or replace)(story()[name]))
    assert missing
    approve(missing)


@pytest.mark.parametrize(
    ("guard", "name", "change"),
    [
        ("may_connect", "start", None),
        ("fixture_ready", "connected", None),
        ("modes_ready", "ticked", None),
        ("capture_ready", "modes", None),
        ("may_capture", "modes", None),
        ("may_move", "modes", None),
        ("may_run_automatically", "capturing", None),
        # To measure the first pose again, although all waypoints are visited.
        ("may_run_automatically", "captured", lambda s: replace(slipped(s), next_waypoint=None)),
        ("may_run_automatically", "capturing", interrupted),
        ("may_edit_pose", "capturing", None),
        ("may_calibrate", "captured", None),
        ("may_write", "solved", None),
        ("may_upload", "solved", None),
        # A file is uploaded with drives that are off.
        ("may_upload", "solved", tripped),
        ("may_report", "solved", None),
        ("may_verify", "solved", None),
        ("may_verify", "uploaded", None),
        ("may_reset", "modes", stopped),
        ("may_reset", "modes", tripped),
        ("may_reset", "modes", switched_off),
    ],
)
def test_with_all_conditions_met_nothing_is_missing(guard, name, change):
    assert getattr(guards, guard)((change or replace)(story()[name])) == ""


def test_the_check_list_of_a_real_arm_is_ticked_item_by_item():
    guard = action_table.by_name("confirm_all").guard  # the palette lists it for every arm
    assert guard(real(story()["connected"]))
    assert not guard(story()["connected"])


@pytest.mark.parametrize(
    ("until", "open_"),
    [({TaskKind.CONNECT}, True), (ARM_RECOVERY, True), ({TaskKind.MODES}, False)],
)
def test_the_action_an_alarm_asks_for_is_allowed(until, open_):
    """It says: connect again."""
    tasks = frozenset(until)
    s = story()["modes"].with_message(Level.ALARM, "why", time="12:00:00", resolving_tasks=tasks)
    assert (guards.may_connect(s) == "") is open_


def test_remounting_is_refused_if_a_sensor_fails_during_the_question():
    shown, told = [story()["captured"]], []
    failed = replace(shown[0], state=replace(shown[0].state, sensor_jump="jumped"))
    interface = SimpleNamespace(
        ask=lambda _, then: (shown.append(failed), then("yes")), snapshot=lambda: shown[-1],
        refuse=told.append, open=told.append, runner=None, sessions=SimpleNamespace(remounted="opened"),
    )  # fmt: skip
    perform_action(action_table.by_name("remount"), interface)
    assert told == ["jumped"]
