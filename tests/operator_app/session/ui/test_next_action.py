"""The hint above the keys: the next action, short enough for the smallest terminal."""

from dataclasses import replace
from functools import cache

import pytest

from hardware.arm import DriveState, Fault
from operator_app.calibration.verification import VerificationResult
from operator_app.config.procedure_file import load_procedure
from operator_app.report.spans import wrapped
from operator_app.session.ui.action_handlers import apply_prompt
from operator_app.session.ui.guards import may_run_automatically
from operator_app.session.ui.next_action import next_action
from operator_app.session.ui.snapshot import TaskKind
from operator_app.session.ui.steps import Step
from tests.oracles.story import (
    busy,
    diverged,
    lost,
    real,
    stale,
    stopped,
    story,
    tripped,
    unstopped,
    with_joints,
)


@cache
def snapshots():
    of_an_arm = stopped, unstopped, stale, lost, diverged, tripped, heartbeat_lost
    return {
        **story(),
        **{
            f"{name}, {change.__name__}": change(s)
            for name, s in story().items()
            for change in (real, *(of_an_arm if s.arm else ()))
        },
        "moving": busy(story()["capturing"], TaskKind.AUTOMATIC, moves=True),
    }


def heartbeat_lost(s):
    """All drives have tripped, as after a killed program."""
    faults = tuple(
        Fault(node=j, joint=j, code=0x8130, text="operator's heartbeat lost", sync_count=0)
        for j in range(1, 8)
    )
    s = with_joints(s, lambda j: replace(j, drive=DriveState.FAULT, mode=None))
    return replace(s, arm=replace(s.arm, faults=faults))


@pytest.mark.parametrize("step", list(Step), ids=lambda step: step.title)
def test_hints_fit_two_rows_of_80_columns(step):
    for name, snapshot in snapshots().items():
        hint = next_action(step, snapshot).hint
        assert len(wrapped(f" Next {hint}", 79, indent=" " * 6)) <= 2, (name, hint)


def test_joint_that_has_not_stopped_comes_before_the_reset(approve):
    action = next_action(Step.CAPTURE, unstopped(story()["capturing"]))
    assert action.action == "reset"
    approve(action.hint)


def uploaded(*, modes_applied: bool, verified: VerificationResult | None = None):
    s = replace(story()["uploaded"], verification=verified)
    if not modes_applied:
        return s
    modes = story()["modes"]
    return replace(s, arm=modes.arm, state=replace(s.state, modes=modes.state.modes))


def test_after_the_upload_a_verification_is_offered():
    """Also from a held arm: the same key applies the modes again."""
    for applied in (False, True):
        assert "y verifies" in next_action(Step.EXPORT, uploaded(modes_applied=applied)).hint


@pytest.mark.parametrize(("holds", "text"), [(True, "verified"), (False, "find the cause")])
def test_a_verification_result_is_the_last_hint(holds, text):
    result = replace(story()["verified"].verification, odd_poses=() if holds else (0,))
    hint = next_action(Step.EXPORT, uploaded(modes_applied=True, verified=result)).hint
    assert text in hint
    assert hint.endswith("Enter or q quits")


def test_disabled_drives_lead_back_to_the_modes_and_a_missing_arm_to_connect():
    s = story()["capturing"]
    disabled = with_joints(s, lambda j: replace(j, drive=DriveState.SWITCH_ON_DISABLED))
    action = next_action(Step.CAPTURE, disabled)
    assert action.action == "back"
    assert "apply the modes again" in action.hint
    assert "Enter" in action.hint
    for step in (Step.FIXTURE, Step.MODES, Step.CAPTURE):
        assert next_action(step, replace(s, identity=None, arm=None)).action == "step_1"
    assert next_action(Step.MODES, replace(s, ticked=frozenset())).label == "Back to Fixture"


def test_an_open_arm_drives_all_joints():
    s = story()["ticked"]
    every = tuple(range(1, s.procedure.arm.joint_count + 1))
    opened = replace(s, procedure=load_procedure("open_loop"), selected_joints=every, mobility=7)
    opened = replace(opened, ticked=frozenset(range(len(opened.procedure.fixture.checklist))))
    assert next_action(Step.MODES, opened).hint == (
        "Enter applies the modes: J1, J2, J3, J4, J5, J6 and J7 drive (it asks first)"
    )
    assert apply_prompt(opened) == "Put joints 1, 2, 3, 4, 5, 6 and 7 into position mode"
    assert apply_prompt(s) == "Put joints 1 and 5 into position mode, the others free"


def test_hint_names_the_fault_and_the_number_of_drives():
    s = story()["modes"]
    hint = next_action(Step.CONNECT, heartbeat_lost(s)).hint
    assert hint.startswith("7 drives are in fault (8130h: ")
    assert next_action(Step.CONNECT, tripped(s)).hint.startswith("the drive of J4 is in fault:")
    dropped = Fault(node=3, joint=3, code=0, text="the drive is off", sync_count=0)
    off = replace(s, arm=replace(s.arm, faults=(dropped,)))
    assert next_action(Step.MODES, off).action == "reset"


def test_a_missing_drift_check_is_named_and_can_be_made():
    s = story()["captured"]
    assert "drift check" not in next_action(Step.CAPTURE, s).hint
    assert may_run_automatically(s)
    s = replace(s, state=replace(s.state, readings=()))
    assert "drift check is missing" in next_action(Step.CAPTURE, s).hint
    assert not may_run_automatically(s)


@pytest.mark.parametrize(("left", "words"), [(1, "the last pose"), (2, "the 2 remaining poses")])
def test_hint_counts_the_poses_that_remain(left, words):
    s = story()["capturing"]
    capture = replace(s.procedure.capture, poses=len(s.state.used_poses) + left)
    s = replace(s, procedure=replace(s.procedure, capture=capture))
    assert next_action(Step.CAPTURE, s).hint.startswith(f"Enter captures {words} automatically")
