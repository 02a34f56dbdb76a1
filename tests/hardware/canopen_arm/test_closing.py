"""Pace, closing and recording on a fake bus."""

from __future__ import annotations

import struct
import threading
import time
from pathlib import Path

import can
import numpy as np
import pytest

from hardware.canopen_arm import CanopenArm
from hardware.errors import (
    BusError,
)
from hardware.timing import Pace
from tests.hardware.fake_arm import JOINTS, FakeArmBus
from tests.hardware.on_fake_bus import (
    make,
)


def test_fast_forward_sends_no_sync_between_commands(driven: CanopenArm, bus: FakeArmBus) -> None:
    before = bus.syncs
    for _ in range(50):
        driven.active_parameters()
    assert bus.syncs == before


def test_real_time_sends_one_sync_a_period_always(bus: FakeArmBus) -> None:
    arm = make(bus, pace=Pace.REAL_TIME)
    arm.connect()
    reached = threading.Event()
    times: list[float] = []

    def note(_sync: int) -> None:
        times.append(time.monotonic())
        if len(times) == 40:
            reached.set()

    bus.on_sync = note
    assert reached.wait(5)
    arm.close()
    assert np.median(np.diff(times)) == pytest.approx(0.01, abs=0.002)


def test_the_operator_is_heard_ten_times_a_second(driven: CanopenArm, bus: FakeArmBus) -> None:
    start, first = time.monotonic(), [i for i, _ in bus.sent].count(0x77F)
    while time.monotonic() - start < 0.45:
        driven.capture(1)
    heard = [i for i, _ in bus.sent].count(0x77F) - first
    assert 3 <= heard <= 6


def test_closing_holds_disables_and_gives_the_token_back(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    bus.drives[3].counts = 3333
    driven.close()
    assert bus.token == 0
    assert {drive.mode for drive in bus.drives.values()} == {8}
    assert bus.drives[3].target == 3333
    assert {drive.status for drive in bus.drives.values()} == {0x40}
    driven.close()
    assert not [t for t in threading.enumerate() if t.name == "sarcal-control"]


def test_closing_after_stop_does_not_lift_the_stop(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    driven.close()
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    assert bus.token == 0


def test_stop_while_closing_stops_the_drives_and_latches(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    start = bus.syncs
    bus.on_sync = lambda sync: driven.stop() if sync == start + 2 else None
    driven.close()
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    assert bus.token == 0
    driven.connect()
    assert driven.snapshot().stopped


def test_stop_reaches_the_drives_to_the_last_moment_of_closing(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    loop = driven._link.loop
    close, before = loop.close, []

    def close_and_stop() -> None:
        close()
        before.append(len(bus.sent))
        driven.stop()

    monkeypatch.setattr(loop, "close", close_and_stop)
    driven.close()
    late = [(i, struct.unpack("<Hib", data)[0]) for i, data in bus.sent[before[0] :]]
    assert late == [(0x200 + j, 0x0002) for j in range(1, JOINTS + 1)]


def test_closing_twice_at_once_closes_once(
    driven: CanopenArm, monkeypatch: pytest.MonkeyPatch
) -> None:
    link = driven._link
    close, closed = link.close, []
    other = threading.Thread(target=driven.close)
    waited = []

    def close_within() -> None:
        closed.append(link)
        if len(closed) == 1:
            driven.close()  # as a signal handler of this thread would
            other.start()
            other.join(0.05)
            waited.append(other.is_alive())
        close()

    monkeypatch.setattr(link, "close", close_within)
    driven.close()
    other.join(5.0)
    assert waited == [True], "the other thread went on before the arm was closed"
    assert closed == [link]
    with pytest.raises(BusError, match="not connected"):
        driven.snapshot()


def test_the_bus_is_recorded_both_ways(bus: FakeArmBus, tmp_path: Path) -> None:
    arm = make(bus, record_to=tmp_path / "bus.blf")
    arm.connect()
    arm.capture(5)
    arm.close()
    with can.BLFReader(tmp_path / "bus.blf") as reader:
        recorded = [(message.arbitration_id, message.is_rx) for message in reader]
    assert recorded.count((0x080, False)) == bus.syncs
    assert recorded.count((0x183, True)) == bus.syncs
    assert (0x600 + 16, False) in recorded
    assert arm.recording_failure is None


def test_a_recording_that_cannot_start_is_said(bus: FakeArmBus, tmp_path: Path) -> None:
    with pytest.raises(BusError, match="cannot be recorded"):
        make(bus, record_to=tmp_path / "missing" / "bus.blf").connect()
