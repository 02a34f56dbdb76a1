"""A recorded session read by Wireshark's CANopen dissector, which nobody here wrote."""

import subprocess
from pathlib import Path

import can
import pytest

from tests.oracles.virtual_rig import rig
from tests.oracles.wireshark import dissected


@pytest.mark.needs("tshark")
def test_wireshark_reads_the_bus_as_it_was_meant(tmp_path: Path) -> None:
    file = tmp_path / "session.blf"
    with rig() as arm, can.Bus(arm.channel, interface="virtual") as tap:
        for node in (*range(1, 8), 16):
            arm.peer.wait_for(lambda number, _, node=node: number == 0x700 + node)
        states = arm.operational()
        arm.peer.command(3, 0x0F, states[2][1] + 9000, 8)
        arm.peer.write(16, 0x2000, 0, b"a document of several segments")
        arm.clock.time_s += 0.11
        arm.peer.wait_for(lambda number, _: number == 0x710)
        with can.Logger(str(file)) as writer:
            while (message := tap.recv(0.0)) is not None:
                writer(message)
    rows = dissected(
        file,
        "can.id",
        "canopen.function_code",
        "canopen.node_id",
        "canopen.sdo.main_idx",
        "canopen.sdo.cmd",
        "canopen.em.err_code",
        "canopen.nmt_guard.state",
        "canopen.nmt_ctrl.cd",
    )
    assert rows
    by_identifier: dict[int, list[list[str]]] = {}
    for row in rows:
        by_identifier.setdefault(int(row[0], 0), []).append(row)
    assert int(by_identifier[0x000][0][7], 0) == 1  # start
    assert [int(row[6], 0) for row in by_identifier[0x701]] == [5]  # operational
    assert [int(row[5], 0) for row in by_identifier[0x083]] == [0x8612]
    indices = {int(row[3], 0) for row in by_identifier[0x590] if row[3]}
    assert {0x2000, 0x2010} <= indices
    assert len(by_identifier[0x187]) == len(by_identifier[0x080])
    text = subprocess.run(
        ["tshark", "-r", str(file), "-d", "can.subdissector,canopen"],
        capture_output=True,
        text=True,
        check=True,
        timeout=60,
    ).stdout
    assert "Malformed" not in text
    assert "CANopen" in text
