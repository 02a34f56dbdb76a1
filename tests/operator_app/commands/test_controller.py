"""`sarcal controller` before it serves: its state folder and its faults."""

import os
from pathlib import Path

import pytest

from hardware.virtual.fault_messages import FAULTS
from operator_app.commands.controller import procedure_of, script_of
from operator_app.commands.table import parser_of
from operator_app.errors import SessionError
from operator_app.virtual_arms import slots_in


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


def test_the_command_to_run_needs_a_procedure_of_this_arm_in_this_fixture():
    tracker = procedure_of("sarcos_dextrous", "tracker", fixture_kind="measured")
    assert tracker == ("open_loop --go-home", "")
    assert procedure_of("sarcos_dextrous", "hinge", fixture_kind="hinge") == ("hinge", "")
    for names in (("ur5e", "hinge"), ("sarcos_dextrous", "my_hinge.yaml")):
        run, advice = procedure_of(*names, fixture_kind="hinge")
        assert run == "PROCEDURE"
        assert "sarcal new procedure --arm {} --fixture {}".format(*names) in advice


def requested_syncs(*words: str) -> list[int]:
    args = parser_of("controller").parse_args(["-i", "loopback", *words])
    return [fault.at_sync for fault in script_of(args, 7)]


def test_faults_visible_at_connect_start_at_sync_0():
    both = ("--fault", "other-map", "--fault", "collision")
    assert requested_syncs(*both) == [0, 1000]
    assert requested_syncs(*both, "--fault-sync", "0") == [0, 0]
    assert requested_syncs(*both, "--fault-sync", "30") == [30, 30]
    for kind, row in FAULTS.items():
        assert requested_syncs("--fault", kind) == [0 if row.at_connect else 1000], kind
