from dataclasses import replace
from types import SimpleNamespace

import numpy as np
import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.drive_settings import DriveFacts
from hardware.commissioning.checks import drive_settings
from hardware.commissioning.clauses import BENCH, is_enabled_unmoved, keeps_its_document

DRIVE = DriveFacts(joint=1, unsupported_modes=(), quick_stop_option=6, operator_timeout_s=0.5)


@pytest.mark.parametrize(
    ("guard_s", "passed"),
    [(None, False), (0.5, True), (2.0, True), (2.1, None), (10.0, None), (10.1, False)],
)
def test_heartbeat_timeout_bounds_of_guard_clause(guard_s, passed, approve):
    clauses = drive_settings([replace(DRIVE, operator_timeout_s=guard_s)])
    (guard,) = [clause for clause in clauses if clause.name == "guard"]
    assert guard.passed is passed
    approve(guard.text)


def test_drive_without_reaction_to_the_timeout_fails_guard_clause(approve):
    clauses = drive_settings([replace(DRIVE, ignores_timeout=True)])
    (guard,) = [clause for clause in clauses if clause.name == "guard"]
    assert guard.passed is False
    approve(guard.text)


@pytest.mark.parametrize(("window", "reported"), [(None, 0), (5000, 0), (0xFFFFFFFF, 1)])
def test_following_error_check_that_is_off_is_reported(window, reported, approve):
    clauses = drive_settings([replace(DRIVE, following_window_counts=window)])
    clauses = [clause for clause in clauses if clause.name == "following error"]
    assert [clause.passed for clause in clauses] == [None] * reported
    for clause in clauses:
        approve(clause.text)


@pytest.mark.parametrize(("before", "uploads"), [(b"good", 2), (b"", 1)])
def test_stored_invalid_document_is_reported_with_restoration(before, approve, uploads):
    documents = [before]
    controller = SimpleNamespace(
        active_parameters=lambda: documents[-1], upload_parameters=documents.append
    )
    refused, restored = keeps_its_document(controller)  # type: ignore[arg-type]
    assert (refused.passed, restored.passed) == (False, False)
    approve(restored.text)
    assert len(documents[1:]) == uploads


@pytest.mark.parametrize("mode", [JointMode.POSITION, JointMode.FREE, None])
def test_enabled_drive_outside_position_mode_fails(mode, approve):
    enabled = DriveState.OPERATION_ENABLED
    joints = [
        SimpleNamespace(joint=j, drive=enabled, mode=joint_mode)
        for j, joint_mode in enumerate((JointMode.POSITION, mode), 1)
    ]
    arm = SimpleNamespace(
        capture=lambda _: SimpleNamespace(mean_rad=np.zeros(2)),
        take_control=lambda: None,
        snapshot=lambda: SimpleNamespace(joints=joints),
    )
    clauses = list(is_enabled_unmoved(arm, BENCH))  # type: ignore[arg-type]
    failed = [clause for clause in clauses if not clause.passed]
    assert len(failed) == (mode is not JointMode.POSITION)
    for clause in failed:
        approve(clause.text)
