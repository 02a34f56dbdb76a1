import can
import pytest

from hardware.errors import BusError
from tests.hardware.fake_arm import JOINTS


def test_recording_holds_every_frame_in_order(connected, bus, tmp_path):
    arm = connected(record_to=tmp_path / "bus.blf")
    arm.take_control()
    arm.stop()
    arm.close()
    assert arm.recording_failure is None
    frames = list(can.LogReader(tmp_path / "bus.blf"))
    directions = [(frame.arbitration_id, frame.is_rx) for frame in frames]
    assert directions.count((0x080, False)) == bus.syncs
    # The bus may be closed before the answer to the last SYNC.
    assert bus.syncs - directions.count((0x183, True)) in (0, 1)
    stops = [f for f in frames if 0x200 < f.arbitration_id <= 0x207 and f.data[:2] == b"\x02\x00"]
    assert {f.arbitration_id for f in stops} == {0x201 + k for k in range(JOINTS)}
    assert not any(f.is_rx for f in stops)
    open_requests = 0
    for frame in sorted(frames, key=lambda f: f.timestamp):
        open_requests += frame.arbitration_id == 0x604
        if frame.arbitration_id == 0x584:
            assert open_requests > 0
            open_requests -= 1


@pytest.mark.parametrize("suffix", [".blf", ".asc", ".log"])
def test_channel_name_ending_in_digits_is_recorded(connected, bus, tmp_path, suffix):
    """python-can packs the number at the end of a channel's name into two bytes."""
    receive = bus._recv_internal

    def receive_on_channel(timeout: float | None) -> tuple[can.Message | None, bool]:
        message, filtered = receive(timeout)
        if message is not None:
            message.channel = "bench-4294967296"
        return message, filtered

    bus._recv_internal = receive_on_channel  # type: ignore[method-assign]
    arm = connected(record_to=tmp_path / f"bus{suffix}")
    arm.close()
    assert arm.recording_failure is None
    with can.LogReader(tmp_path / f"bus{suffix}") as recording:
        assert any(frame.arbitration_id == 0x701 for frame in recording)


def test_reconnecting_starts_a_second_recording(connected, tmp_path):
    arm = connected(record_to=tmp_path / "bus.blf")
    arm.close()
    first = (tmp_path / "bus.blf").read_bytes()
    arm.connect()
    arm.close()
    assert (tmp_path / "bus.blf").read_bytes() == first
    with can.LogReader(tmp_path / "bus-2.blf") as second:
        assert any(frame.arbitration_id == 0x701 for frame in second)


def test_unwritable_recording_raises_bus_error(connected, tmp_path):
    with pytest.raises(BusError, match="cannot be recorded"):
        connected(record_to=tmp_path / "missing" / "bus.blf")
