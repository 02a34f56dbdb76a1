import contextlib
import hashlib
import struct
import time

import pytest

from hardware import errors
from hardware.arm import DriveState
from hardware.control.uploading import MAX_UPLOADS
from hardware.timing import Pace
from tests.hardware.control.canopen_arm.conftest import drive, short_timing, wait_for
from tests.hardware.fake_arm import JOINTS, FakeArmBus, FrameLoss

FREE_TOKEN = struct.pack("<BHBL", 0x80, 0x2002, 0, 0x08000021)
OLD_DOCUMENT = b"the one before"
DOCUMENT = ("schema: sarcal/parameters/1\n" + "x: 1.0\n" * 600).encode()
SHA256 = hashlib.sha256(DOCUMENT).hexdigest()
STAGE = b"\x2f\x02\x20\x00\x01"
COMMIT = b"\x2f\x02\x20\x00\x02"
COMMITTED = b"\x60\x02\x20\x00"
MANY = 100
TIMING = short_timing(speed=10.0, heartbeat_timeout_s=0.35, sdo_timeout_s=0.1)


@pytest.fixture
def bus(bus):
    bus.document = OLD_DOCUMENT
    return bus


@pytest.fixture
def arm(connected):
    return connected(timing=TIMING)


def test_upload_is_staged_verified_and_committed_without_enabling_drives(arm, bus):
    receipt = arm.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert receipt.sha256 == SHA256
    assert (receipt.slot, receipt.length) == ("A", len(DOCUMENT))
    assert receipt.home_offset_counts == tuple(-11 * j for j in range(1, JOINTS + 1))
    assert arm.active_parameters() == DOCUMENT
    assert {j.drive for j in arm.snapshot().joints} == {DriveState.SWITCH_ON_DISABLED}


@pytest.mark.parametrize(
    ("frames", "error"),
    [
        ([(0x703, b"\x00"), (0x703, b"\x05")], errors.NodeRestarted),
        ([(0x000, b"\x81\x03")], errors.OtherMaster),
        ([(0x083, b"\x05\x73\x20" + bytes(5))], errors.DriveFault),  # its sensor has failed
        ([(0x083, b"\x11\x86\x20" + bytes(5))], None),  # a drive in fault still has its counter
    ],
)
def test_upload_is_refused_if_a_counter_may_have_been_reset(arm, bus, frames, error):
    for frame in frames:
        bus.inject(*frame)
    with contextlib.suppress(errors.HardwareError):
        arm.capture(1)  # reads the frames
    with pytest.raises(error) if error else contextlib.nullcontext():
        arm.upload_parameters(DOCUMENT)
    assert bus.document == (OLD_DOCUMENT if error else DOCUMENT)
    assert error is None or bus.token == 0


@pytest.mark.parametrize("document", [b"", b"abc", b"abcd", b"abcdefg", bytes(range(256))])
def test_documents_of_any_length_round_trip(driven, bus, document):
    bus.document = b""
    if document:
        driven.upload_parameters(document)
    assert driven.active_parameters() == document


@pytest.mark.parametrize(
    ("fault", "text"),
    [("corrupts", f"byte {len(DOCUMENT) - 1} of "), ("wrong_digest", "SHA-256 00")],
)
def test_corrupted_document_is_not_committed(driven, bus, fault, text):
    setattr(bus, fault, True)
    with pytest.raises(errors.UploadRefused, match=text):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == OLD_DOCUMENT


def test_silence_after_commit_raises_upload_unknown(driven, bus):
    bus.drops = lambda identifier, _: identifier == 0x590 and bus.document == DOCUMENT
    with pytest.raises(errors.UploadUnknown, match=r"not known.*does not answer"):
        driven.upload_parameters(DOCUMENT)
    bus.drops = lambda _identifier, _data: False
    assert driven.active_parameters() == DOCUMENT


def test_repeated_commit_after_lost_control_is_accepted(driven, bus):
    """The response to the commit was lost, and its repetition is refused: 2003h decides."""

    def commit_and_refuse_repetition(commits: int) -> None:
        if commits == 2:
            bus.document, bus.written, bus.staged = bus.written, None, False
            bus.inject(0x590, FREE_TOKEN)

    bus.drops = FrameLoss(0x610, COMMIT, times=MANY, act=commit_and_refuse_repetition)
    assert driven.upload_parameters(DOCUMENT).sha256 == SHA256


@pytest.mark.parametrize("times", [1, MANY])
def test_document_dropped_before_commit_is_uploaded_again(driven, bus, times):
    """A supervisor drops it if it misses its operator's heartbeat for a moment."""

    def drop_document(_lost: int) -> None:
        bus.written, bus.staged = None, False

    bus.drops = FrameLoss(0x610, COMMIT, times=times, act=drop_document)
    if times == 1:
        driven.upload_parameters(DOCUMENT)
        assert bus.document == DOCUMENT
        return
    with pytest.raises(errors.BusError):
        driven.upload_parameters(DOCUMENT)
    # On a busy machine an attempt may time out earlier; `stage responses` below needs the last one.
    assert 1 < bus.drops.lost <= MAX_UPLOADS
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
    assert loss.lost == loss.times
    assert bus.document == DOCUMENT


def test_repeatedly_lost_segments_report_no_answer(driven, bus):
    """The node aborts the segment that ends a transfer it has given up; that abort is not the cause."""
    bus.drops = FrameLoss(0x610, b"\x10", times=MAX_UPLOADS, skip=3)
    with pytest.raises(errors.BusError, match="Node 16 does not answer when asked for 2000h"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == OLD_DOCUMENT


def control_lapse(bus: FakeArmBus, times: int = 1) -> FrameLoss:
    """Let the supervisor release control and drop the document when it is to check it."""

    def release_control(_lost: int) -> None:
        bus.token, bus.written = 0, None
        bus.inject(0x590, FREE_TOKEN)

    return FrameLoss(0x610, STAGE, times=times, act=release_control)


@pytest.fixture
def late(connected):
    """An arm whose host computer was suspended for a moment."""
    late_s = 0.0
    arm = drive(
        connected(pace=Pace.REAL_TIME, timing=TIMING, clock=lambda: time.monotonic() + late_s)
    )
    late_s = 0.74
    wait_for(lambda: arm.snapshot().lateness.times > 0)
    return arm


def test_control_lost_by_host_latency_is_taken_again(late, bus):
    bus.drops = control_lapse(bus)
    late.upload_parameters(DOCUMENT)
    assert (bus.document, bus.token) == (DOCUMENT, 127)


def test_control_lost_without_host_latency_is_denied(driven, bus):
    bus.drops = control_lapse(bus)
    with pytest.raises(errors.ControlDenied) as denied:
        driven.upload_parameters(DOCUMENT)
    assert (denied.value.holder, bus.token, bus.document) == (0, 0, OLD_DOCUMENT)


def test_control_lost_repeatedly_raises_host_latency_exceeded(late, bus):
    bus.drops = control_lapse(bus, times=MANY)
    with pytest.raises(errors.HostLatencyExceeded) as exceeded:
        late.upload_parameters(DOCUMENT)
    assert 0.6 < exceeded.value.last_s <= late.snapshot().lateness.longest_s
    assert 1 < bus.drops.lost <= MAX_UPLOADS
    assert bus.document == OLD_DOCUMENT


def test_upload_refusal_gives_the_controllers_reason(driven, bus):
    bus.refusal = "serial SDA-0007 is another arm"
    with pytest.raises(errors.UploadRefused, match=r"controller refused .* another arm\. The prev"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == OLD_DOCUMENT


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
