"""Parameters on a fake bus: staged, read back, committed, or refused in words."""

from __future__ import annotations

import hashlib
import struct

import pytest
from canopen.sdo.exceptions import SdoCommunicationError

from hardware.control.canopen_arm import CanopenArm
from hardware.errors import (
    BusError,
    CommandRefused,
    SdoRefused,
    UploadRefused,
    UploadUnknown,
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


class Loses:
    """SDO frames that do not arrive: those that begin so, the first `times` of them."""

    def __init__(self, identifier: int, begin: bytes, times: int = 1, skip: int = 0) -> None:
        self.identifier, self.begin, self.left, self.skip = identifier, begin, times, skip

    def __call__(self, identifier: int, data: bytes) -> bool:
        if identifier != self.identifier or not data.startswith(self.begin) or self.left == 0:
            return False
        if self.skip:
            self.skip -= 1
            return False
        self.left -= 1
        return True


COMMIT = b"\x2f\x02\x20\x00\x02"
COMMITTED = b"\x60\x02\x20\x00"


@pytest.mark.parametrize(
    "loses",
    [Loses(0x610, COMMIT), Loses(0x590, COMMITTED, skip=1)],
    ids=["the command", "its answer"],
)
def test_a_commit_of_which_a_frame_was_lost_is_found_out(
    driven: CanopenArm, bus: FakeArmBus, loses: Loses
) -> None:
    """Whether it was carried out or not, 2003h says."""
    bus.document, bus.loses = b"the one before", loses
    receipt = driven.upload_parameters(DOCUMENT)
    assert loses.left == 0
    assert bus.document == DOCUMENT
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()


def test_a_supervisor_that_falls_silent_at_the_commit_leaves_it_unknown(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    def loses(identifier: int, data: bytes) -> bool:
        return identifier == 0x590 and bus.document == DOCUMENT

    for client in driven._link.access._clients.values():
        monkeypatch.setattr(client, "RESPONSE_TIMEOUT", 0.1)
    bus.document, bus.loses = b"the one before", loses
    with pytest.raises(UploadUnknown, match=r"not known.*does not answer"):
        driven.upload_parameters(DOCUMENT)
    bus.loses = lambda _identifier, _data: False
    assert driven.active_parameters() == DOCUMENT


def test_a_commit_that_was_done_at_last_is_no_refusal_though_control_was_lost_since(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    """Its answer was lost, and it was repeated: what 2003h says counts, and not why the repetition is refused."""
    asked = 0

    def loses(identifier: int, data: bytes) -> bool:
        nonlocal asked
        if identifier != 0x610 or not data.startswith(COMMIT):
            return False
        asked += 1
        if asked == 2:
            assert bus.written is not None
            bus.document, bus.written, bus.staged = bus.written, None, False
            bus.say(0x590, struct.pack("<BHBL", 0x80, 0x2002, 0, 0x08000021))
        return True

    bus.document, bus.loses = b"the one before", loses
    receipt = driven.upload_parameters(DOCUMENT)
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()


def test_a_document_dropped_before_its_commit_came_is_refused(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    """As a supervisor does whose operator is missed for a moment."""

    def loses(identifier: int, data: bytes) -> bool:
        if identifier == 0x610 and data.startswith(COMMIT):
            bus.written, bus.staged = None, False
            return True
        return False

    bus.document, bus.loses = b"the one before", loses
    with pytest.raises(UploadRefused, match="the one before stays active"):
        driven.upload_parameters(DOCUMENT)


@pytest.mark.parametrize(
    ("identifier", "begin"), [(0x610, b"\x10"), (0x590, b"\x30")], ids=["request", "answer"]
)
def test_a_frame_lost_in_the_document_has_it_written_again(
    driven: CanopenArm, bus: FakeArmBus, identifier: int, begin: bytes
) -> None:
    bus.loses = Loses(identifier, begin, skip=3)
    receipt = driven.upload_parameters(DOCUMENT)
    assert bus.loses.left == 0
    assert bus.document == DOCUMENT
    assert receipt.length == len(DOCUMENT)


def test_frames_lost_twice_are_a_silence_and_no_refusal(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    """The node refuses the segment that closes a transfer which it has given up: not the reason."""
    bus.document, bus.loses = b"the one before", Loses(0x610, b"\x10", times=2, skip=3)
    with pytest.raises(BusError, match="Node 16 does not answer when asked for 2000h"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


def test_a_refusal_after_a_silence_is_a_refusal(driven: CanopenArm) -> None:
    access = driven._link.access
    try:
        raise SdoCommunicationError("No SDO response received")
    except SdoCommunicationError:
        with pytest.raises(SdoRefused):
            access.read(1, 0x5FFF)


def test_uploading_needs_control(arm: CanopenArm) -> None:
    with pytest.raises(CommandRefused, match="control"):
        arm.upload_parameters(DOCUMENT)
