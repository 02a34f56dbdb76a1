"""Descriptions of frames, which are given by the numbers of CiA 301 and 402."""

import struct

from hardware.commissioning.bus_monitor import BusMonitor
from tests.oracles.profiles import sarcos


def events(monitor: BusMonitor, identifier: int, data: bytes, now_s: float = 0.0) -> list[str]:
    return list(monitor.take_in(identifier, data, now_s))


def test_node_boot_silence_and_return_are_reported():
    monitor = BusMonitor(sarcos())
    assert events(monitor, 0x703, b"\x00", 0.0) == ["joint 3: has booted"]
    assert events(monitor, 0x703, b"\x7f", 0.1) == ["joint 3: pre-operational"]
    assert events(monitor, 0x703, b"\x05", 0.2) == ["joint 3: operational"]
    assert events(monitor, 0x703, b"\x05", 0.3) == []
    assert list(monitor.time_passes(1.0)) == []
    assert list(monitor.time_passes(2.0)) == ["joint 3: no heartbeat for 1.7 s"]
    assert list(monitor.time_passes(3.0)) == []
    assert events(monitor, 0x703, b"\x05", 3.1) == ["joint 3: its heartbeat is back"]


def test_emergencies_commands_and_writes_are_described(approve):
    monitor = BusMonitor(sarcos())
    for identifier, data in (
        (0x084, struct.pack("<HB5x", 0x8311, 0x21)),
        (0x084, bytes(8)),
        (0x000, b"\x82\x00"),
        (0x205, struct.pack("<Hib", 0x06, 7, 0)),
        (0x205, struct.pack("<Hib", 0x0F, 7, 10)),
        (0x205, struct.pack("<Hib", 0x02, 7, 10)),
        (0x610, bytes.fromhex("2100200064000000")),
        (0x603, bytes.fromhex("2b4060000f000000")),
        (0x603, bytes.fromhex("2264600078563412")),
        (0x590, bytes.fromhex("8000200021000008")),
    ):
        approve("; ".join(events(monitor, identifier, data)))
    for word in (0x0F, 0x1F):
        assert len(events(monitor, 0x205, struct.pack("<Hib", word, 7, 10))) == (word == 0x0F)


def test_begin_of_sync_is_reported():
    monitor = BusMonitor(sarcos())
    begun = ["a master has begun to send SYNC"]
    assert [events(monitor, 0x080, b"", t) for t in (0.0, 0.01, 2.0)] == [begun, [], begun]


def test_block_download_is_reported_as_one_write():
    """Segment 33 looks like the request of another write, as segments begin with their number (CiA 301)."""
    monitor = BusMonitor(sarcos())
    requested = "node 16: write of {} bytes to 2000h sub 0 requested"
    written = [requested.format(231)]
    assert events(monitor, 0x610, bytes.fromhex("c2002000e7000000")) == written
    for number in (*range(1, 33), 0x80 | 33):
        assert events(monitor, 0x610, bytes([number, *b"segment"])) == []
    assert events(monitor, 0x610, bytes.fromhex("c100000000000000")) == []
    for identifier, ending in (
        (0x610, "8000200000000405"),
        (0x590, "8000200021000008"),
        (0x590, "6000200000000000"),
    ):
        assert events(monitor, 0x610, bytes.fromhex("c2002000e7000000")) == written
        events(monitor, identifier, bytes.fromhex(ending))
        segmented = events(monitor, 0x610, bytes.fromhex("2100200064000000"))
        assert segmented == [requested.format(100)]


def test_answer_of_wrong_length_is_reported_once(approve):
    monitor = BusMonitor(sarcos())
    (sentence,) = events(monitor, 0x182, bytes(6))
    approve(sentence)
    assert events(monitor, 0x182, bytes(6)) == []


def test_summary_has_drive_states_positions_and_counts_of_all_frames():
    monitor = BusMonitor(sarcos())
    events(monitor, 0x080, b"")
    assert events(monitor, 0x181, struct.pack("<Hih", 0x0227, -5, 0)) == [
        "joint 1: drive operation enabled"
    ]
    assert events(monitor, 0x181, struct.pack("<Hih", 0x0227, -6, 0)) == []
    events(monitor, 0x77F, b"\x05")
    for identifier, data in ((0x7EE, b"foreign"), (0x201, b""), (0x580, b"")):
        assert events(monitor, identifier, data) == []
    assert len(events(monitor, 0x181, b"short")) == 1
    summary = monitor.summary()
    assert (summary["frames"], summary["syncs"]) == (8, 1)
    assert summary["joints"] == {"1": {"drive": "operation enabled", "position_counts": -6}}
    assert summary["nodes"] == {"127": "operational"}
