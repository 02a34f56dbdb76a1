"""What a session records, read by Wireshark: every frame well formed, in order of time, none missing."""

import subprocess
from collections import Counter
from itertools import pairwise
from pathlib import Path

import pytest

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.session.workflow.opening import Choices, begin

pytestmark = pytest.mark.needs("tshark")
JOINTS = range(1, 8)


def dissected(file: Path, *fields: str) -> list[list[str]]:
    """One row a frame, in the file's order; of a field that a frame lacks an empty text."""
    arguments = ["tshark", "-r", str(file), "-d", "can.subdissector,canopen", "-T", "fields"]
    for field in fields:
        arguments += ["-e", field]
    done = subprocess.run(arguments, capture_output=True, text=True, check=True, timeout=60)
    return [line.split("\t") for line in done.stdout.splitlines()]


def read(file: Path) -> list[tuple[float, int, bytes, int | None]]:
    """Time (s), COB-ID, data, NMT state of a heartbeat; once all are known to be well formed."""
    rows = dissected(
        file,
        "frame.time_epoch", "can.id", "canopen.pdo.data.bytes", "canopen.nmt_guard.state",
        "canopen.sdo.cmd", "frame.protocols", "_ws.malformed", "_ws.expert.severity",
    )  # fmt: skip
    assert rows
    # Of what the dissector finds odd it makes an expert's note, of what it cannot read a malformed packet.
    assert [row for row in rows if row[6] or row[7]] == []
    # A SYNC has no data, and Wireshark hands frames without any to no dissector.
    assert all(row[5] == ("can" if int(row[1], 0) == 0x080 else "can:canopen") for row in rows)
    assert all(row[4] for row in rows if 0x580 < int(row[1], 0) < 0x680)
    times = [float(row[0]) for row in rows]
    assert sum(later < earlier for earlier, later in pairwise(times)) == 0
    return [
        (
            time,
            int(row[1], 0),
            bytes.fromhex(row[2].replace(":", "")),
            int(row[3], 0) if row[3] else None,
        )
        for time, row in zip(times, rows, strict=True)
    ]


@pytest.mark.campaign
def test_what_a_run_recorded_is_all_of_it(tmp_path, ends_with):
    options = ["--poses", "3", "--sessions", tmp_path, "--record", "--json"]
    folder = Path(ends_with(4, "run", "hinge", *options).json["session"]["folder"])
    frames = read(folder / "bus.blf")
    count = Counter(identifier for _, identifier, _, _ in frames)
    syncs = count[0x080]
    assert syncs > 500
    # Each joint answers each SYNC once; the two that are driven are commanded with most, the others now and then.
    assert {count[0x180 + joint] for joint in JOINTS} == {syncs}
    assert {joint for joint in JOINTS if count[0x200 + joint] > syncs / 3} == {1, 5}
    assert min(count[0x200 + joint] for joint in JOINTS) > 50
    assert count[0x000] >= 2  # reset communication, start
    for node in (*JOINTS, 16):
        assert count[0x580 + node] == count[0x600 + node] > 10
        states = [state for _, identifier, _, state in frames if identifier == 0x700 + node]
        assert 0 in states  # boot-up
        assert states[-1] == 5
    assert count[0x77F] > 3


def _stopped(frame: tuple[float, int, bytes, int | None]) -> bool:
    _, identifier, data, _ = frame
    return 0x180 < identifier < 0x188 and data[0] & 0x6F == 0x07


def test_stop_is_in_the_recording_at_its_time(tmp_path):
    opening = begin("hinge", Choices(interface="virtual"), root=tmp_path)
    with open_arm(opening, record_to=tmp_path / "bus.blf", pace=Pace.FAST_FORWARD) as rig:
        rig.arm.connect()
        rig.arm.take_control()
        rig.arm.stop()
    frames = read(tmp_path / "bus.blf")
    stops = [
        at
        for at, (_, identifier, data, _) in enumerate(frames)
        if 0x200 < identifier < 0x208 and data[:2] == b"\x02\x00"
    ]
    assert {frames[at][1] for at in stops} == {0x200 + joint for joint in JOINTS}
    # Not before the first of them, and soon after it, a drive says that it has stopped (6041h).
    stopped = [at for at, frame in enumerate(frames) if _stopped(frame)]
    assert {frames[at][1] for at in stopped} == {0x180 + joint for joint in JOINTS}
    assert min(stops) < min(stopped)
    assert 0.0 < frames[min(stopped)][0] - frames[min(stops)][0] < 0.5
