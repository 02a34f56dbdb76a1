"""Parameter upload on a fake bus: staged, verified, committed, repeated after losses, or refused."""

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
from tests.hardware.on_fake_bus import make, short_timing, wait_for

FREE_TOKEN = struct.pack("<BHBL", 0x80, 0x2002, 0, 0x08000021)
OLD_DOCUMENT = b"the one before"
DOCUMENT = ("schema: sarcal/parameters/1\n" + "x: 1.0\n" * 600).encode()
SHA256 = hashlib.sha256(DOCUMENT).hexdigest()
STAGE = b"\x2f\x02\x20\x00\x01"
COMMIT = b"\x2f\x02\x20\x00\x02"
COMMITTED = b"\x60\x02\x20\x00"


class Clock:
    """Monotonic time, ahead by `late_s` after a suspension of this computer."""

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
def bus(bus):
    bus.document = OLD_DOCUMENT
    return bus


@pytest.fixture
def arm(bus, clock, pace):
    timing = short_timing(speed=10.0, heartbeat_timeout_s=0.35, sdo_timeout_s=0.1)
    arm = make(bus, pace=pace, timing=timing, clock=clock)
    arm.connect()
    yield arm
    arm.close()


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
    bus.document = b""
    if document:
        driven.upload_parameters(document)
    assert driven.active_parameters() == document


def test_upload_refusal_gives_the_controllers_reason(driven, bus):
    bus.refusal = "serial SDA-0007 is another arm"
    with pytest.raises(UploadRefused, match="serial SDA-0007 is another arm"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == OLD_DOCUMENT


def test_corrupted_document_is_not_committed(driven, bus):
    bus.corrupts = True
    with pytest.raises(UploadRefused, match=f"byte {len(DOCUMENT) - 1} differs"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == OLD_DOCUMENT


class FrameLoss:
    """Loses the first `times` SDO frames with this beginning, after `skip` that arrive."""

    def __init__(self, identifier: int, begin: bytes, times: int = 1, skip: int = 0) -> None:
        self.identifier, self.begin, self.remaining, self.skip = identifier, begin, times, skip

    def __call__(self, identifier: int, data: bytes) -> bool:
        if identifier != self.identifier or not data.startswith(self.begin) or self.remaining == 0:
            return False
        if self.skip:
            self.skip -= 1
            return False
        self.remaining -= 1
        return True


def test_silence_after_commit_raises_upload_unknown(driven, bus):
    bus.drops = lambda identifier, _: identifier == 0x590 and bus.document == DOCUMENT
    with pytest.raises(UploadUnknown, match=r"not known.*does not answer"):
        driven.upload_parameters(DOCUMENT)
    bus.drops = lambda _identifier, _data: False
    assert driven.active_parameters() == DOCUMENT


def test_repeated_commit_after_lost_control_is_accepted(driven, bus):
    """The response to the commit was lost, and its repetition is refused: 2003h decides."""
    commits = 0

    def drops(identifier: int, data: bytes) -> bool:
        nonlocal commits
        if identifier != 0x610 or not data.startswith(COMMIT):
            return False
        commits += 1
        if commits == 2:
            assert bus.written is not None
            bus.document, bus.written, bus.staged = bus.written, None, False
            bus.inject(0x590, FREE_TOKEN)
        return True

    bus.drops = drops
    assert driven.upload_parameters(DOCUMENT).sha256 == SHA256


@pytest.mark.parametrize("times", [1, 100])
def test_document_dropped_before_commit_is_uploaded_again(driven, bus, times):
    """A supervisor drops it if it misses its operator's heartbeat for a moment."""
    dropped = 0

    def drops(identifier: int, data: bytes) -> bool:
        nonlocal dropped
        if identifier == 0x610 and data.startswith(COMMIT) and dropped < times:
            bus.written, bus.staged, dropped = None, False, dropped + 1
            return True
        return False

    bus.drops = drops
    if times == 1:
        driven.upload_parameters(DOCUMENT)
        assert bus.document == DOCUMENT
        return
    with pytest.raises(BusError):
        driven.upload_parameters(DOCUMENT)
    assert dropped == MAX_UPLOADS
    assert bus.document == OLD_DOCUMENT


@pytest.mark.parametrize(
    "loss",
    [
        pytest.param(FrameLoss(0x610, b"\x10", skip=3), id="segment"),
        pytest.param(FrameLoss(0x590, b"\x30", skip=3), id="segment response"),
        pytest.param(FrameLoss(0x590, COMMITTED), id="stage response"),
        pytest.param(FrameLoss(0x590, COMMITTED, times=MAX_UPLOADS - 1), id="stage responses"),
        # 2003h tells whether the commit was executed.
        pytest.param(FrameLoss(0x610, COMMIT), id="commit"),
        pytest.param(FrameLoss(0x590, COMMITTED, skip=1), id="commit response"),
    ],
)
def test_lost_frame_is_retried(driven, bus, loss):
    bus.drops = loss
    receipt = driven.upload_parameters(DOCUMENT)
    assert (receipt.length, receipt.sha256) == (len(DOCUMENT), SHA256)
    assert loss.remaining == 0
    assert bus.document == DOCUMENT


def test_repeatedly_lost_segments_report_no_answer(driven, bus):
    """The node aborts the segment that ends a transfer it has given up; that abort is not the cause."""
    bus.drops = FrameLoss(0x610, b"\x10", times=MAX_UPLOADS, skip=3)
    with pytest.raises(BusError, match="Node 16 does not answer when asked for 2000h"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == OLD_DOCUMENT


class ControlLapse:
    """Supervisor that releases control at the first stage command, or at each, and drops the document."""

    def __init__(self, bus: FakeArmBus, *, always: bool = False) -> None:
        self.bus, self.always, self.times = bus, always, 0

    def __call__(self, identifier: int, data: bytes) -> bool:
        if identifier != 0x610 or not data.startswith(STAGE) or (self.times and not self.always):
            return False
        self.times += 1
        self.bus.token, self.bus.written = 0, None
        self.bus.inject(0x590, FREE_TOKEN)
        return True


@pytest.fixture
def late(driven, clock):
    """An arm whose host computer was suspended for a moment."""
    clock.late_s = 0.74
    wait_for(lambda: driven.snapshot().lateness.times > 0)
    return driven


@pytest.mark.parametrize("pace", [Pace.REAL_TIME])
def test_control_lost_by_host_latency_is_taken_again(late, bus):
    bus.drops = ControlLapse(bus)
    late.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert bus.token == 127


def test_control_lost_without_host_latency_is_denied(driven, bus):
    bus.drops = ControlLapse(bus)
    with pytest.raises(ControlDenied) as denied:
        driven.upload_parameters(DOCUMENT)
    assert denied.value.holder == 0
    assert bus.token == 0
    assert bus.document == OLD_DOCUMENT


@pytest.mark.parametrize("pace", [Pace.REAL_TIME])
def test_control_lost_repeatedly_raises_host_latency_exceeded(late, bus):
    bus.drops = ControlLapse(bus, always=True)
    with pytest.raises(HostLatencyExceeded) as exceeded:
        late.upload_parameters(DOCUMENT)
    assert exceeded.value.longest_s == pytest.approx(0.7, abs=0.1)
    assert bus.drops.times == MAX_UPLOADS
    assert bus.document == OLD_DOCUMENT


def test_refusal_after_sdo_timeout_raises_upload_refused(driven, bus):
    bus.refusal = "another arm"
    try:
        raise SdoCommunicationError("No SDO response received")
    except SdoCommunicationError:
        with pytest.raises(UploadRefused, match="another arm"):
            driven.upload_parameters(DOCUMENT)


@pytest.mark.parametrize("frame", [2, 3, 9])
def test_upload_after_ctrl_c_succeeds(driven, bus, frame):
    sent = 0

    def press_ctrl_c(identifier: int, _data: bytes) -> None:
        nonlocal sent
        sent += identifier == 0x610
        if identifier == 0x610 and sent == frame:
            raise KeyboardInterrupt

    bus.on_send = press_ctrl_c
    with pytest.raises(KeyboardInterrupt):
        driven.upload_parameters(DOCUMENT)
    assert bus.document == OLD_DOCUMENT
    assert driven.upload_parameters(DOCUMENT).length == len(DOCUMENT)
    assert driven.active_parameters() == DOCUMENT
