"""`sarcal controller` before it serves: what it cannot keep its parameters in is one error."""

import os
import time
from dataclasses import replace
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


def test_a_state_that_is_no_folder_is_one_error_that_names_it(tmp_path, ends_with):
    file, pipe, full = tmp_path / "file", tmp_path / "pipe", tmp_path / "full"
    file.write_text("parameters")
    os.mkfifo(pipe)
    full.mkdir()
    os.mkfifo(full / "active")
    for place in (file, pipe, full, file / "below", Path("/proc/x"), Path("/proc")):
        words = ["controller", "-i", "loopback", "-c", "no-state", "--state", str(place)]
        said = ends_with(2, *words)
        assert said.out == ""
        assert f"parameters cannot be stored in {place} (" in said.err
        assert "leave --state out" in said.err


def test_a_folder_is_made_and_nothing_is_left_in_it(tmp_path):
    slots_in(tmp_path / "a" / "b")
    assert list((tmp_path / "a" / "b").iterdir()) == []
    with pytest.raises(SessionError, match="null"):
        slots_in(Path("x\0y"))


def asked(*words: str) -> list[int]:
    args = parser_of("controller").parse_args(["-i", "loopback", *words])
    return [fault.at_sync for fault in script_of(args, 7)]


def test_what_shows_as_an_arm_is_connected_is_there_before():
    both = ("--fault", "other-map", "--fault", "collision")
    assert asked(*both) == [0, 1000]
    assert asked(*both, "--fault-sync", "0") == [0, 0]
    assert asked(*both, "--fault-sync", "30") == [30, 30]


@pytest.mark.sample(10)
@pytest.mark.parametrize("kind", list(FAULTS))
def test_every_kind_can_be_asked_for_and_breaks_nothing_of_the_program(kind):
    at_sync = "0" if FAULTS[kind].at_connect else "1"
    words = ["-i", "loopback", "--fault", kind, "--fault-joint", "6", "--fault-sync", at_sync]
    happened: list[int] = []

    def noted(fault: ScriptedFault) -> ScriptedFault:
        def happen(controller):
            happened.append(fault.at_sync)
            fault.happen(controller)

        return replace(fault, happen=happen)

    script = [noted(fault) for fault in script_of(parser_of("controller").parse_args(words), 7)]
    settings = BusSettings(channel=f"kind-{kind}")
    arm = load_procedure("hinge").arm
    with (
        can.Bus(settings.channel, interface="virtual") as bus,
        run_controller(arm, Choices(), settings, script=script) as controller,
    ):
        peer = RawPeer(bus)
        peer.start()
        until_s = time.monotonic() + 5.0
        while controller.sync_count == 0 and time.monotonic() < until_s:
            peer.send(0x080)
            peer.receive(0.02)
            controller.resume_loop()
        assert controller.sync_count > 0
        assert len(happened) == len(script) > 0
    assert controller.failure is None
