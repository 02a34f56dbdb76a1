"""What single clauses of a bench check say of what they found, without a bus."""

from types import SimpleNamespace

import numpy as np
import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.drive_settings import DriveFacts
from hardware.commissioning.checks import drive_settings
from hardware.commissioning.clauses import is_enabled_unmoved, keeps_its_document
from hardware.commissioning.stages import BENCH


@pytest.mark.parametrize(
    ("guard_s", "passed"),
    [(None, False), (0.5, True), (2.0, True), (2.1, None), (10.0, None), (10.1, False)],
)
def test_heartbeat_timeout_bounds_of_guard_clause(guard_s, passed, approve):
    drive = DriveFacts(
        joint=1, unsupported_modes=(), quick_stop_option=6, operator_timeout_s=guard_s
    )
    (guard,) = [clause for clause in drive_settings([drive]) if clause.name == "guard"]
    assert guard.passed is passed
    approve(guard.text)


class Credulous:
    """Keeps whatever it is sent."""

    def __init__(self, document: bytes) -> None:
        self.document, self.uploads = document, 0

    def active_parameters(self) -> bytes:
        """What it has."""
        return self.document

    def upload_parameters(self, document: bytes) -> None:
        """Take it."""
        self.document = document
        self.uploads += 1


@pytest.mark.parametrize(("before", "uploads"), [(b"good", 2), (b"", 1)])
def test_stored_invalid_document_is_reported_with_restoration(before, approve, uploads):
    arm = Credulous(before)
    refused, kept = keeps_its_document(arm)  # type: ignore[arg-type]
    assert (refused.passed, kept.passed) == (False, False)
    approve(kept.text)
    assert arm.uploads == uploads


class Limp:
    """Enables its drives in modes of its own, and does not sink meanwhile."""

    def __init__(self, *modes: JointMode | None) -> None:
        self.modes = modes

    def capture(self, _: int) -> SimpleNamespace:
        """Stand still."""
        return SimpleNamespace(mean_rad=np.zeros(len(self.modes)))

    def take_control(self) -> None:
        """Enable."""

    def snapshot(self) -> SimpleNamespace:
        """Say that every drive is enabled, and in which mode."""
        enabled = DriveState.OPERATION_ENABLED
        joints = [
            SimpleNamespace(joint=j, drive=enabled, mode=mode)
            for j, mode in enumerate(self.modes, 1)
        ]
        return SimpleNamespace(joints=joints)


@pytest.mark.parametrize("mode", [JointMode.POSITION, JointMode.FREE, None])
def test_enabled_drive_outside_position_mode_fails(mode, approve):
    arm = Limp(JointMode.POSITION, mode)
    found = list(is_enabled_unmoved(arm, BENCH))  # type: ignore[arg-type]
    failed = [clause for clause in found if not clause.passed]
    assert len(failed) == (mode is not JointMode.POSITION)
    for clause in failed:
        approve(clause.text)
