"""What single clauses of a bench check say of what they found, without a bus."""

import pytest

from hardware.canopen.drive_settings import DriveFacts
from hardware.commissioning.checks import drive_settings
from hardware.commissioning.clauses import keeps_its_document


@pytest.mark.parametrize(
    ("guard_s", "passed"),
    [(None, False), (0.5, True), (2.0, True), (2.1, None), (10.0, None), (10.1, False)],
)
def test_what_a_run_puts_up_with_does_not_fail_and_is_said(guard_s, passed, approve):
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
def test_only_what_was_uploaded_again_is_said_to_be(before, approve, uploads):
    arm = Credulous(before)
    refused, kept = keeps_its_document(arm)  # type: ignore[arg-type]
    assert (refused.passed, kept.passed) == (False, False)
    approve(kept.text)
    assert arm.uploads == uploads
