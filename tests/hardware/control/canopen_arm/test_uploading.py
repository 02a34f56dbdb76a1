"""Parameters on a fake bus: staged, read back, committed, or refused in words."""

import hashlib
import struct
import time

import pytest
from canopen.sdo.exceptions import SdoCommunicationError

from hardware.arm import DriveState
from hardware.control.uploading import MAX_UPLOADS
from hardware.errors import (
    BusError,
    ControlDenied,
    HostLatencyExceeded,
    UploadRefused,
    UploadUnknown,
)
from hardware.timing import Pace
from tests.hardware.fake_arm import JOINTS, FakeArmBus
from tests.hardware.on_fake_bus import hasty, make, wait_for

FREE_TOKEN = struct.pack("<BHBL", 0x80, 0x2002, 0, 0x08000021)
DOCUMENT = ("schema: sarcal/parameters/1\n" + "x: 1.0\n" * 600).encode()
SHA256 = hashlib.sha256(DOCUMENT).hexdigest()


class Clock:
    """Shows a time at which this computer was busy for so long."""

    late_s = 0.0

    def __call__(self) -> float:
        return time.monotonic() + self.late_s


@pytest.fixture
def clock():
    return Clock()


@pytest.fixture
def pace():
    return Pace.FAST_FORWARD


@pytest.fixture
def arm(bus, clock, pace):
    """Of an operator's program that waits no longer than a fake arm needs."""
    timing = hasty(speed=10.0, heartbeat_timeout_s=0.35, sdo_timeout_s=0.1)
    made = make(bus, pace=pace, timing=timing, clock=clock)
    made.connect()
    yield made
    made.close()


def test_upload_is_staged_verified_and_committed(driven, bus):
    receipt = driven.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert receipt.sha256 == SHA256
    assert (receipt.slot, receipt.length) == ("A", len(DOCUMENT))
    assert receipt.home_offset_counts == tuple(-11 * j for j in range(1, JOINTS + 1))
    assert driven.active_parameters() == DOCUMENT


def test_upload_leaves_drives_disabled(arm, bus):
    arm.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert {j.drive for j in arm.snapshot().joints} == {DriveState.SWITCH_ON_DISABLED}


@pytest.mark.parametrize("document", [b"", b"abc", b"abcd", b"abcdefg", bytes(range(256))])
def test_documents_of_any_length_round_trip(driven, bus, document):
    if document:
        driven.upload_parameters(document)
    assert driven.active_parameters() == document


def test_upload_refusal_gives_the_controllers_reason(driven, bus):
    bus.document, bus.refusal = b"the one before", "serial SDA-0007 is another arm"
    with pytest.raises(UploadRefused, match="serial SDA-0007 is another arm"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


def test_corrupted_document_is_not_committed(driven, bus):
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


def test_silence_after_commit_raises_upload_unknown(driven, bus):
    def loses(identifier: int, data: bytes) -> bool:
        return identifier == 0x590 and bus.document == DOCUMENT

    bus.document, bus.loses = b"the one before", loses
    with pytest.raises(UploadUnknown, match=r"not known.*does not answer"):
        driven.upload_parameters(DOCUMENT)
    bus.loses = lambda _identifier, _data: False
    assert driven.active_parameters() == DOCUMENT


def test_repeated_commit_after_lost_control_is_accepted(driven, bus):
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
    assert driven.upload_parameters(DOCUMENT).sha256 == SHA256


@pytest.mark.parametrize("times", [1, 100])
def test_document_dropped_before_commit_is_uploaded_again(
    driven, bus, times
):
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
    "loses",
    [
        pytest.param(Loses(0x610, b"\x10", skip=3), id="a segment"),
        pytest.param(Loses(0x590, b"\x30", skip=3), id="its answer"),
        pytest.param(Loses(0x590, COMMITTED), id="the check"),
        pytest.param(Loses(0x590, COMMITTED, times=MAX_UPLOADS - 1), id="the check, many times"),
        # Whether it was carried out or not, 2003h says.
        pytest.param(Loses(0x610, COMMIT), id="the commit"),
        pytest.param(Loses(0x590, COMMITTED, skip=1), id="the commit's answer"),
    ],
)
def test_lost_frame_is_retried(driven, bus, loses):
    bus.document, bus.loses = b"the one before", loses
    receipt = driven.upload_parameters(DOCUMENT)
    assert (receipt.length, receipt.sha256) == (len(DOCUMENT), SHA256)
    assert loses.left == 0
    assert bus.document == DOCUMENT


def test_repeatedly_lost_segments_report_no_answer(driven, bus):
    """The node refuses the segment that closes a transfer which it has given up: not the reason."""
    bus.document, bus.loses = b"the one before", Loses(0x610, b"\x10", times=MAX_UPLOADS, skip=3)
    with pytest.raises(BusError, match="Node 16 does not answer when asked for 2000h"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


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


@pytest.fixture
def late(driven, clock):
    """An arm whose operator's program was late for a moment."""
    clock.late_s = 0.74
    wait_for(lambda: driven.snapshot().lateness.times > 0)
    return driven


@pytest.mark.parametrize("pace", [Pace.REAL_TIME])
def test_control_lost_by_host_latency_is_taken_again(late, bus):
    bus.document, bus.loses = b"the one before", Lapses(bus)
    late.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert bus.token == 127


def test_control_lost_without_host_latency_is_denied(driven, bus):
    bus.document, bus.loses = b"the one before", Lapses(bus)
    with pytest.raises(ControlDenied) as denied:
        driven.upload_parameters(DOCUMENT)
    assert denied.value.holder == 0
    assert bus.token == 0
    assert bus.document == b"the one before"


@pytest.mark.parametrize("pace", [Pace.REAL_TIME])
def test_control_lost_repeatedly_raises_host_latency_exceeded(late, bus):
    bus.document, bus.loses = b"the one before", Lapses(bus, always=True)
    with pytest.raises(HostLatencyExceeded) as exceeded:
        late.upload_parameters(DOCUMENT)
    assert exceeded.value.longest_s == pytest.approx(0.7, abs=0.1)
    assert bus.loses.times == MAX_UPLOADS
    assert bus.document == b"the one before"


def test_refusal_after_sdo_timeout_raises_upload_refused(driven, bus):
    bus.refusal = "another arm"
    try:
        raise SdoCommunicationError("No SDO response received")
    except SdoCommunicationError:
        with pytest.raises(UploadRefused, match="another arm"):
            driven.upload_parameters(DOCUMENT)


@pytest.mark.parametrize("frame", [2, 3, 9])
def test_upload_after_ctrl_c_succeeds(driven, bus, frame):
    sent = []

    def interrupt(identifier: int, data: bytes) -> None:
        if identifier == 0x610:
            sent.append(data)
            if len(sent) == frame:
                raise KeyboardInterrupt

    bus.on_send = interrupt
    with pytest.raises(KeyboardInterrupt):
        driven.upload_parameters(DOCUMENT)
    assert bus.document == b""
    assert driven.upload_parameters(DOCUMENT).length == len(DOCUMENT)
    assert driven.active_parameters() == DOCUMENT
