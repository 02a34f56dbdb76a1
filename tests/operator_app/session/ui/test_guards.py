"""Every guard, open and shut, and the words it says when it is shut."""

from dataclasses import replace

import pytest

from fixtures.base import CheckKind, SetupCheck, Severity
from hardware.arm import Fault, JointMode
from operator_app.session.ui import guards
from operator_app.session.ui.message_log import ARM_RECOVERY, add_message
from operator_app.session.ui.snapshot import Level, SessionSnapshot, TaskKind
from operator_app.session.ui.steps import Step
from tests.oracles.story import busy, lost, real, stale, stopped, story, tripped

TOLD = (
    "start", "connected", "ticked", "modes", "capturing", "captured", "solved", "written", "uploaded",
)  # fmt: skip
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
    """Data that are old as nobody here looked."""
    found = stale(s)
    assert found.arm is not None
    return replace(found, arm=replace(found.arm, late_s=0.2))


@pytest.mark.parametrize("name", TOLD)
def test_steps_become_available_in_order(name):
    told = story()[name]
    missing = {step: guards.missing_for(step, told) for step in Step}
    assert next((step for step in Step if missing[step]), None) is FIRST_CLOSED[name]
    for step, sentences in missing.items():
        assert all(len(s) > 15 and s[-1] != "." for s in sentences), step


def refused(s):
    bad = SetupCheck(
        kind=CheckKind.AXIS_ANGLE,
        severity=Severity.REFUSED,
        text="the hinge axis makes an angle of 0.2 deg with joint 1's axis",
        remedy="tilt the hinge",
    )
    return replace(s, checks=(*s.checks, bad))


def interrupted(s):
    return replace(s, state=replace(s.state, resumed=True))


def resumed(s):
    """A session with a calibration, before it is connected."""
    return replace(s, solution=None, identity=None, arm=None)


def slipped(s):
    return replace(s, state=replace(s.state, sensor_jump="joint 3 jumped by +2223 counts"))


def switched_off(s):
    """A drive, at the drive."""
    fault = Fault(node=3, joint=3, code=0, text="the drive is in state switched on", sync_count=9)
    return replace(s, arm=replace(s.arm, faults=(fault,)))


def misreported(s):
    """A drive is in another mode than it was put into."""
    joints = tuple(replace(j, mode=JointMode.FREE) if j.joint == 1 else j for j in s.arm.joints)
    return replace(s, arm=replace(s.arm, joints=joints))


def not_accepted(s):
    return replace(s, solution=replace(s.solution, reasons=("condition 900 is above 100",)))


@pytest.mark.parametrize(
    ("guard", "told", "change"),
    [
        (guards.fixture_ready, "start", None),
        (guards.fixture_ready, "connected", real),
        (guards.modes_ready, "connected", None),
        (guards.modes_ready, "ticked", refused),
        (guards.modes_ready, "ticked", lambda s: replace(s, checks=())),
        (guards.capture_ready, "ticked", None),
        (guards.capture_ready, "modes", stopped),
        (guards.may_move, "uploaded", lambda s: s),
        (guards.may_capture, "uploaded", lambda s: s),
        (guards.capture_ready, "modes", tripped),
        (guards.capture_ready, "modes", misreported),
        (guards.calibrate_ready, "modes", None),
        (guards.results_ready, "captured", None),
        (guards.results_ready, "solved", resumed),
        (guards.export_ready, "captured", None),
        (guards.export_ready, "solved", not_accepted),
        (guards.may_connect, "connected", None),
        (guards.may_use_data, "start", None),
        (guards.may_use_data, "modes", stopped),
        (guards.may_use_data, "modes", stale),
        (guards.may_use_data, "modes", ours),
        (guards.may_use_data, "modes", lost),
        (guards.may_capture, "modes", stale),
        (guards.may_capture, "ticked", None),
        (guards.may_capture, "capturing", interrupted),
        (guards.may_capture, "capturing", slipped),
        (guards.may_move, "modes", lost),
        (guards.may_move, "modes", lambda s: replace(s, next_waypoint=None)),
        (guards.may_run_automatically, "captured", None),
        (guards.may_run_automatically, "modes", stopped),
        (guards.may_edit_pose, "modes", None),
        (guards.may_calibrate, "modes", None),
        (
            guards.may_calibrate,
            "captured",
            lambda s: replace(s, estimator="paper", unsensed_joints=(6,)),
        ),
        (guards.may_write, "captured", None),
        (guards.may_write, "solved", not_accepted),
        (guards.may_upload, "solved", stale),
        (guards.may_report, "captured", None),
        (guards.may_verify, "captured", None),
        (guards.may_verify, "uploaded", stopped),
        (guards.may_verify, "uploaded", lambda s: replace(s, wanted_joints=(3,))),
        (guards.may_reset, "modes", None),
    ],
)
def test_unmet_conditions_are_reported(guard, told, change, approve):
    s = story()[told]
    s = s if change is None else change(s)
    missing = guard(s)
    assert missing
    approve(missing[0])


@pytest.mark.parametrize(
    ("guard", "told", "change"),
    [
        (guards.may_connect, "start", None),
        (guards.fixture_ready, "connected", None),
        (guards.modes_ready, "ticked", None),
        (guards.capture_ready, "modes", None),
        (guards.may_capture, "modes", None),
        (guards.may_move, "modes", None),
        (guards.may_run_automatically, "capturing", None),
        (guards.may_edit_pose, "capturing", None),
        (guards.may_calibrate, "captured", None),
        (guards.may_write, "solved", None),
        (guards.may_upload, "solved", None),
        # A file is uploaded with drives that are off.
        (guards.may_upload, "solved", tripped),
        (guards.may_report, "solved", None),
        (guards.may_verify, "solved", None),
        (guards.may_verify, "uploaded", None),
        (guards.may_reset, "modes", stopped),
        (guards.may_reset, "modes", tripped),
        (guards.may_reset, "modes", switched_off),
    ],
)
def test_with_all_conditions_met_nothing_is_missing(guard, told, change):
    s = story()[told]
    assert guard(s if change is None else change(s)) == ()


@pytest.mark.parametrize(
    ("joints", "words"),
    [((1,), "would sag"), ((), "would sag"), ((1, 2, 5), "drive trips"), ((1, 5), None)],
)
def test_too_few_and_too_many_position_joints_are_explained(joints, words):
    missing = guards.modes_problem(story()["ticked"], joints)
    assert (missing == ()) if words is None else words in missing[0]
    wanted = replace(story()["ticked"], wanted_joints=joints)
    assert bool(guards.may_apply_modes(wanted)) == (words is not None)


@pytest.mark.parametrize(
    ("until", "open_"),
    [({TaskKind.CONNECT}, True), (ARM_RECOVERY, True), ({TaskKind.MODES}, False)],
)
def test_the_action_an_alarm_asks_for_is_allowed(until, open_):
    """It says: connect again."""
    s = add_message(
        story()["modes"], Level.ALARM, "why", time="12:00:00", resolving_tasks=frozenset(until)
    )
    assert (guards.may_connect(s) == ()) is open_


def test_any_key_ends_a_motion_only():
    s = story()["modes"]
    assert guards.stops_on_any_key(busy(s, TaskKind.MOVE, moves=True).task)
    assert not guards.stops_on_any_key(busy(s, TaskKind.EXPORT, moves=False).task)
    assert not guards.stops_on_any_key(None)
