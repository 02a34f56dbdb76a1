"""`sarcal controller` before it serves: its state folder and its faults."""

import os
import time
from dataclasses import asdict
from pathlib import Path

import can
import pytest

from hardware.buses.python_can import BusSettings
from hardware.virtual.fault_messages import FAULTS
from hardware.virtual.faults import ScriptedFault
from operator_app.commands.controller import script_of
from operator_app.commands.table import parser_of
from operator_app.config.procedure_file import load_procedure
from operator_app.errors import SessionError
from operator_app.session.workflow.opening import Choices
from operator_app.virtual_arms import run_controller, slots_in
from tests.oracles.raw_can import RawPeer


def test_unusable_state_folder_is_one_error(tmp_path, run_command):
    file, pipe, full = tmp_path / "file", tmp_path / "pipe", tmp_path / "full"
    file.write_text("parameters")
    os.mkfifo(pipe)
    full.mkdir()
    os.mkfifo(full / "active")
    for place in (file, pipe, full, file / "below", Path("/proc/x"), Path("/proc")):
        words = ["controller", "-i", "loopback", "-c", "no-state", "--state", str(place)]
        answer = run_command(2, *words)
        assert answer.out == ""
        assert f"parameters cannot be stored in {place} (" in answer.err
        assert "leave --state out" in answer.err


def test_state_folder_is_created_empty(tmp_path):
    slots_in(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []
    with pytest.raises(SessionError, match="null"):
        slots_in(Path("x\0y"))


def requested_syncs(*words: str) -> list[int]:
    args = parser_of("controller").parse_args(["-i", "loopback", *words])
    return [fault.at_sync for fault in script_of(args, 7)]


def test_faults_visible_at_connect_start_at_sync_0():
    both = ("--fault", "other-map", "--fault", "collision")
    assert requested_syncs(*both) == [0, 1000]
    assert requested_syncs(*both, "--fault-sync", "0") == [0, 0]
    assert requested_syncs(*both, "--fault-sync", "30") == [30, 30]


@pytest.mark.sample(10)
@pytest.mark.parametrize("kind", list(FAULTS))
def test_every_fault_kind_can_be_requested_and_runs(kind):
    at_connect = FAULTS[kind].at_connect
    assert requested_syncs("--fault", kind) == [0 if at_connect else 1000]
    options = ["--fault", kind, "--fault-joint", "6", "--fault-sync", "0" if at_connect else "1"]
    applied: list[int] = []

    class Logged(ScriptedFault):
        def happen(self, arm):
            applied.append(self.at_sync)
            super().happen(arm)

    args = parser_of("controller").parse_args(["-i", "loopback", *options])
    script = [Logged(**asdict(fault)) for fault in script_of(args, 7)]
    settings, arm = BusSettings(channel=f"kind-{kind}"), load_procedure("hinge").arm
    with (
        can.Bus(settings.channel, interface="virtual") as bus,
        run_controller(arm, Choices(), settings, script=script) as controller,
    ):
        peer = RawPeer(bus)
        peer.start()
        until_s = time.monotonic() + 60.0
        while controller.sync_count == 0 and time.monotonic() < until_s:
            peer.send(0x080)
            peer.receive(0.02)
            controller.running.set()
        assert controller.sync_count > 0
        assert len(applied) == len(script) > 0
    assert controller.failure is None
