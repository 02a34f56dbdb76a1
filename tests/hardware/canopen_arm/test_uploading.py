"""Parameters on a fake bus: staged, read back, committed, or refused in words."""

from __future__ import annotations

import hashlib

import pytest

from hardware.canopen_arm import CanopenArm
from hardware.errors import (
    CommandRefused,
    UploadRefused,
)
from tests.hardware.fake_arm import JOINTS, FakeArmBus

DOCUMENT = ("schema: sarcal/parameters/1\n" + "x: 1.0\n" * 600).encode()


def test_an_upload_is_staged_read_back_and_committed(driven: CanopenArm, bus: FakeArmBus) -> None:
    receipt = driven.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()
    assert (receipt.slot, receipt.length) == ("A", len(DOCUMENT))
    assert receipt.home_offset_counts == tuple(-11 * j for j in range(1, JOINTS + 1))
    assert driven.active_parameters() == DOCUMENT


@pytest.mark.parametrize("document", [b"", b"abc", b"abcd", b"abcdefg", bytes(range(256))])
def test_any_length_survives(driven: CanopenArm, bus: FakeArmBus, document: bytes) -> None:
    if document:
        driven.upload_parameters(document)
    assert driven.active_parameters() == document


def test_a_refusal_carries_the_controllers_words(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.document, bus.refusal = b"the one before", "serial SDA-0007 is another arm"
    with pytest.raises(UploadRefused, match="serial SDA-0007 is another arm"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


def test_a_document_that_comes_back_different_is_dropped(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    bus.document, bus.corrupts = b"the one before", True
    with pytest.raises(UploadRefused, match=f"byte {len(DOCUMENT) - 1} differs"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


def test_uploading_needs_control(arm: CanopenArm) -> None:
    with pytest.raises(CommandRefused, match="control"):
        arm.upload_parameters(DOCUMENT)
