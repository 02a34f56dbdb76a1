"""Recordings of the bus, read by Wireshark: every frame well formed, in order of time, none missing."""

import subprocess
from collections import Counter
from pathlib import Path

import pytest

from hardware.timing import Pace
from operator_app.composition import open_arm
from operator_app.session.workflow.opening import Choices, begin

pytestmark = pytest.mark.needs("tshark")
JOINTS = range(1, 8)


def dissect(file: Path, *fields: str) -> list[list[str]]:
    """Return one row per frame in the order of the file; a missing field is an empty text."""
    arguments = ["tshark", "-r", str(file), "-d", "can.subdissector,canopen", "-T", "fields"]
    for field in fields:
        arguments += ["-e", field]
    out = subprocess.check_output(arguments, text=True, timeout=240)
    return [line.split("\t") for line in out.splitlines()]


def read_well_formed(file: Path) -> list[tuple[float, int, bytes, int | None]]:
    """Return time (s), COB-ID, data and NMT state of a heartbeat; every frame must be well formed."""
    rows = dissect(
        file,
        "frame.time_epoch", "can.id", "canopen.pdo.data.bytes", "canopen.nmt_guard.state",
        "canopen.sdo.cmd", "frame.protocols", "_ws.malformed", "_ws.expert.severity",
    )  # fmt: skip
    assert rows
    assert [row for row in rows if row[6] or row[7]] == []
    # Wireshark does not dissect frames without data, such as SYNC.
    assert all(row[5] == ("can" if int(row[1], 0) == 0x080 else "can:canopen") for row in rows)
    assert all(row[4] for row in rows if 0x580 < int(row[1], 0) < 0x680)
    times = [float(row[0]) for row in rows]
    assert times == sorted(times)
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
def test_recording_of_a_run_has_every_frame(tmp_path, run_command):
    options = ["--poses", "3", "--sessions", tmp_path, "--record", "--json"]
    folder = Path(run_command(4, "run", "hinge", *options).json["session"]["folder"])
    frames = read_well_formed(folder / "bus.blf")
    count = Counter(identifier for _, identifier, _, _ in frames)
    syncs = count[0x080]
    assert syncs > 500
    # Each joint answers each SYNC once; joints in position mode are commanded with most SYNCs.
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


def test_recording_has_stop_and_the_answers_of_the_drives(tmp_path):
    opening = begin("hinge", Choices(interface="virtual"), root=tmp_path)
    with open_arm(opening, record_to=tmp_path / "bus.blf", pace=Pace.FAST_FORWARD) as rig:
        rig.arm.connect()
        rig.arm.take_control()
        rig.arm.stop()
    frames = read_well_formed(tmp_path / "bus.blf")
    commands = [f for f in frames if 0x200 < f[1] < 0x208 and f[2][:2] == b"\x02\x00"]
    assert {identifier for _, identifier, *_ in commands} == {0x200 + joint for joint in JOINTS}
    # Statuswords (6041h): quick stop active.
    answers = [f for f in frames if 0x180 < f[1] < 0x188 and f[2][0] & 0x6F == 0x07]
    assert {identifier for _, identifier, *_ in answers} == {0x180 + joint for joint in JOINTS}
    assert 0.0 < answers[0][0] - commands[0][0] < 0.5
