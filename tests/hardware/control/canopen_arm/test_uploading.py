"""Parameters on a fake bus: staged, read back, committed, or refused in words."""

from __future__ import annotations

import hashlib
import struct

import pytest
from canopen.sdo.exceptions import SdoCommunicationError

from hardware.arm import DriveState, HostLatency
from hardware.canopen.uploading import MAX_UPLOADS
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import (
    BusError,
    ControlDenied,
    HostLatencyExceeded,
    SdoRefused,
    UploadRefused,
    UploadUnknown,
)
from tests.hardware.fake_arm import JOINTS, FakeArmBus

FREE_TOKEN = struct.pack("<BHBL", 0x80, 0x2002, 0, 0x08000021)
DOCUMENT = ("schema: sarcal/parameters/1\n" + "x: 1.0\n" * 600).encode()


@pytest.fixture
def hasty(driven: CanopenArm, monkeypatch: pytest.MonkeyPatch) -> None:
    """An operator's program that waits no longer than a fake arm needs."""
    monkeypatch.setattr("hardware.canopen.uploading.RETRY_PAUSE_S", 0.01)
    for client in driven._link.access._clients.values():
        monkeypatch.setattr(client, "RESPONSE_TIMEOUT", 0.04)


def test_an_upload_is_staged_read_back_and_committed(driven: CanopenArm, bus: FakeArmBus) -> None:
    receipt = driven.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()
    assert (receipt.slot, receipt.length) == ("A", len(DOCUMENT))
    assert receipt.home_offset_counts == tuple(-11 * j for j in range(1, JOINTS + 1))
    assert driven.active_parameters() == DOCUMENT


def test_an_upload_enables_no_drive(arm: CanopenArm, bus: FakeArmBus) -> None:
    arm.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert {j.drive for j in arm.snapshot().joints} == {DriveState.SWITCH_ON_DISABLED}


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


STAGE = b"\x2f\x02\x20\x00\x01"
COMMIT = b"\x2f\x02\x20\x00\x02"
COMMITTED = b"\x60\x02\x20\x00"


@pytest.mark.parametrize(
    "loses",
    [Loses(0x610, COMMIT), Loses(0x590, COMMITTED, skip=1)],
    ids=["the command", "its answer"],
)
def test_a_commit_of_which_a_frame_was_lost_is_found_out(
    driven: CanopenArm, bus: FakeArmBus, hasty: None, loses: Loses
) -> None:
    """Whether it was carried out or not, 2003h says."""
    bus.document, bus.loses = b"the one before", loses
    receipt = driven.upload_parameters(DOCUMENT)
    assert loses.left == 0
    assert bus.document == DOCUMENT
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()


def test_a_supervisor_that_falls_silent_at_the_commit_leaves_it_unknown(
    driven: CanopenArm, bus: FakeArmBus, hasty: None
) -> None:
    def loses(identifier: int, data: bytes) -> bool:
        return identifier == 0x590 and bus.document == DOCUMENT

    bus.document, bus.loses = b"the one before", loses
    with pytest.raises(UploadUnknown, match=r"not known.*does not answer"):
        driven.upload_parameters(DOCUMENT)
    bus.loses = lambda _identifier, _data: False
    assert driven.active_parameters() == DOCUMENT


def test_a_commit_that_was_done_at_last_is_no_refusal_though_control_was_lost_since(
    driven: CanopenArm, bus: FakeArmBus, hasty: None
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
            bus.say(0x590, FREE_TOKEN)
        return True

    bus.document, bus.loses = b"the one before", loses
    receipt = driven.upload_parameters(DOCUMENT)
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()


@pytest.mark.parametrize("times", [1, 100])
def test_a_document_dropped_before_its_commit_came_is_uploaded_again_and_known_to_be_dropped(
    driven: CanopenArm, bus: FakeArmBus, hasty: None, times: int
) -> None:
    """As a supervisor does whose operator is missed for a moment."""
    dropped = 0

    def loses(identifier: int, data: bytes) -> bool:
        nonlocal dropped
        if identifier == 0x610 and data.startswith(COMMIT) and dropped < times:
            bus.written, bus.staged, dropped = None, False, dropped + 1
            return True
        return False

    bus.document, bus.loses = b"the one before", loses
    if times == 1:
        driven.upload_parameters(DOCUMENT)
        assert bus.document == DOCUMENT
        return
    with pytest.raises(BusError):
        driven.upload_parameters(DOCUMENT)
    assert dropped == MAX_UPLOADS
    assert bus.document == b"the one before"


@pytest.mark.parametrize(
    ("identifier", "begin"), [(0x610, b"\x10"), (0x590, b"\x30")], ids=["request", "answer"]
)
def test_a_frame_lost_in_the_document_has_it_written_again(
    driven: CanopenArm, bus: FakeArmBus, hasty: None, identifier: int, begin: bytes
) -> None:
    bus.loses = Loses(identifier, begin, skip=3)
    receipt = driven.upload_parameters(DOCUMENT)
    assert bus.loses.left == 0
    assert bus.document == DOCUMENT
    assert receipt.length == len(DOCUMENT)


def test_frames_lost_each_time_are_a_silence_and_no_refusal(
    driven: CanopenArm, bus: FakeArmBus, hasty: None
) -> None:
    """The node refuses the segment that closes a transfer which it has given up: not the reason."""
    bus.document, bus.loses = b"the one before", Loses(0x610, b"\x10", times=MAX_UPLOADS, skip=3)
    with pytest.raises(BusError, match="Node 16 does not answer when asked for 2000h"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


@pytest.mark.parametrize("times", [1, MAX_UPLOADS - 1])
def test_an_upload_whose_check_is_not_answered_is_repeated(
    driven: CanopenArm, bus: FakeArmBus, hasty: None, times: int
) -> None:
    bus.loses = Loses(0x590, COMMITTED, times=times)
    assert driven.upload_parameters(DOCUMENT).length == len(DOCUMENT)
    assert bus.loses.left == 0
    assert bus.document == DOCUMENT


LATE = HostLatency(times=2, last_s=0.4, longest_s=0.74)


class Lapses:
    """A supervisor that gives control up at the first command, or each time, and forgets what was written."""

    def __init__(self, bus: FakeArmBus, *, always: bool = False) -> None:
        self.bus, self.always, self.times = bus, always, 0

    def __call__(self, identifier: int, data: bytes) -> bool:
        if identifier != 0x610 or not data.startswith(STAGE) or (self.times and not self.always):
            return False
        self.times += 1
        self.bus.token, self.bus.written = 0, None
        self.bus.say(0x590, FREE_TOKEN)
        return True


def test_control_that_lapsed_by_our_own_lateness_is_taken_again(
    driven: CanopenArm, bus: FakeArmBus, hasty: None
) -> None:
    driven._link.loop.latency._lateness = LATE
    bus.document, bus.loses = b"the one before", Lapses(bus)
    driven.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert bus.token == 127


def test_control_that_lapsed_while_nobody_here_was_late_is_not_taken_again(
    driven: CanopenArm, bus: FakeArmBus, hasty: None
) -> None:
    bus.document, bus.loses = b"the one before", Lapses(bus)
    with pytest.raises(ControlDenied) as denied:
        driven.upload_parameters(DOCUMENT)
    assert denied.value.holder == 0
    assert bus.token == 0
    assert bus.document == b"the one before"


def test_what_comes_of_our_own_lateness_is_not_put_down_to_the_cable(
    driven: CanopenArm, bus: FakeArmBus, hasty: None
) -> None:
    driven._link.loop.latency._lateness = LATE
    bus.document, bus.loses = b"the one before", Lapses(bus, always=True)
    with pytest.raises(HostLatencyExceeded) as late:
        driven.upload_parameters(DOCUMENT)
    assert (late.value.times, late.value.longest_s) == (2, 0.74)
    assert bus.loses.times == MAX_UPLOADS
    assert bus.document == b"the one before"


def test_a_refusal_after_a_silence_is_a_refusal(driven: CanopenArm) -> None:
    access = driven._link.access
    try:
        raise SdoCommunicationError("No SDO response received")
    except SdoCommunicationError:
        with pytest.raises(SdoRefused):
            access.read(1, 0x5FFF)
