from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.objects import Abort
from hardware.commissioning.checks import drive_settings
from hardware.commissioning.clauses import BENCH, Clause, is_enabled_unmoved, keeps_its_document
from hardware.errors import SdoRefused
from tests.oracles.profiles import sarcos


def settings_of_drive(name: str, objects: dict[tuple[int, int], int]) -> list[Clause]:
    """The clauses of this name about a drive with these objects; 1016h: 500 ms."""
    held = {(0x1016, 0): 1, (0x1016, 1): 0x7F0000 | 500} | objects

    def read_unsigned(node: int, index: int, sub: int = 0) -> int:
        if (index, sub) not in held:
            raise SdoRefused(node, index, sub, Abort.NO_OBJECT, "")
        return held[index, sub]

    access: Any = SimpleNamespace(read_unsigned=read_unsigned)
    return [clause for clause in drive_settings(access, sarcos(1)) if clause.name == name]


@pytest.mark.parametrize(
    ("guard_s", "passed"),
    [(None, False), (0.5, True), (2.0, True), (2.1, None), (10.0, None), (10.1, False)],
)
def test_heartbeat_timeout_bounds_of_guard_clause(guard_s, passed, approve):
    consumer = {(0x1016, 1): 0 if guard_s is None else 0x7F0000 | round(1e3 * guard_s)}
    (guard,) = settings_of_drive("guard", consumer)
    assert guard.passed is passed
    approve(guard.text)


def test_drive_without_reaction_to_the_timeout_fails_guard_clause(approve):
    (guard,) = settings_of_drive("guard", {(0x6007, 0): 0})
    assert guard.passed is False
    approve(guard.text)


@pytest.mark.parametrize(("window", "reported"), [(None, 0), (5000, 0), (0xFFFFFFFF, 1)])
def test_following_error_check_that_is_off_is_reported(window, reported, approve):
    held = {} if window is None else {(0x6065, 0): window}
    clauses = settings_of_drive("following error", held)
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
