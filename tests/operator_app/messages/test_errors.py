"""Errors as what happened and what to do now: sentences that end once, and never say less than was done."""

from __future__ import annotations

import pytest

from hardware.errors import (
    BusError,
    DriveFault,
    DuplicateNodeId,
    NodeRestarted,
    OtherMaster,
    SensorFault,
)
from operator_app.messages.errors import words


@pytest.mark.parametrize(
    "error",
    [
        BusError("The arm has gone silent. Check power and cable, then reconnect."),
        OtherMaster("Somebody else commands this arm. End that program, then connect again."),
        NodeRestarted((5,), ["joint 5"]),
        SensorFault(3, "jumped by +2223 counts", since_sync=1),
        SensorFault(3, "stands still", stuck=True),
        DuplicateNodeId((5,)),
    ],
    ids=lambda error: type(error).__name__,
)
def test_what_happened_and_what_to_do_are_sentences(error: Exception) -> None:
    said = words(error)
    assert ".." not in str(said)
    # Poses were left out, or what a drive counts is in doubt.
    assert "Nothing was changed" not in said.remedy


@pytest.mark.parametrize(
    ("code", "said"),
    [
        (0x5441, "Release the external stop"),
        (0x5442, "Release the external stop"),
        (0x7305, "Mend that sensor"),
        (0x8130, "This computer paused"),
        (0x8311, "Find out what it met"),
    ],
)
def test_a_trip_is_told_by_what_brought_it_about(code: int, said: str) -> None:
    remedy = words(DriveFault(1, code, "as it says")).remedy
    assert said in remedy
    assert "reset (R)" in remedy
