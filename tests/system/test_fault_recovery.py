"""Recovery after an operator freeze, a drive trip or a dead controller: messages are true, their advice works."""

import os
import signal
import subprocess
from collections import Counter
from itertools import pairwise
from pathlib import Path

import can
import pytest

from hardware.buses.python_can import BusSettings, open_bus
from tests.oracles.journal_events import event_data
from tests.oracles.own_process import controller, finished, start, wait_for_poses

pytestmark = [pytest.mark.real_time, pytest.mark.campaign]

PATIENCE_S = 240
PATIENT = ("--heartbeat-timeout", "5")
"""For tests without a heartbeat loss: host latency trips no drive."""


@pytest.fixture
def bus(request):
    return ("-i", "loopback", "-c", f"fault-{os.getpid()}-{request.node.name[:24]}")


def pose_numbers(folder: Path) -> list[int]:
    return [pose["number"] for pose in event_data(folder, "pose")]


def only_session(root: Path) -> Path:
    (folder,) = (root / "sessions").iterdir()
    return folder


def resume_command(folder: Path) -> str:
    return f"sarcal run --resume {Path('sessions') / folder.name}"


def run_until_fault(root: Path, bus: tuple[str, ...]) -> tuple[str, Path]:
    """Return error messages and session folder of a run that ends with exit code 3."""
    errors = finished(start(root, "run", "hinge", *bus, "--poses", "40"), 3).err
    return errors, only_session(root)


def freeze(
    run: subprocess.Popen[str],
    bus: tuple[str, ...],
    identifier: int,
    data: bytes = b"",
    times: int = 1,
) -> None:
    """Stop the process until so many frames with this identifier and beginning came."""
    listener = open_bus(BusSettings(interface="loopback", channel=bus[-1]))
    run.send_signal(signal.SIGSTOP)
    while listener.recv(0.0) is not None:
        pass  # frames from before the freeze
    while times > 0:
        frame = listener.recv(PATIENCE_S)
        assert frame is not None
        times -= frame.arbitration_id == identifier and frame.data.startswith(data)
    run.send_signal(signal.SIGCONT)
    listener.shutdown()


def test_resume_succeeds_after_frozen_operator_trips_drives(tmp_path, bus):
    with controller(tmp_path, *bus):
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "5")
        folder = wait_for_poses(tmp_path / "sessions", 1, run)
        freeze(run, bus, 0x081, b"\x30\x81")
        errors = finished(run, 3).err
        assert "heartbeat lost (8130h)" in errors
        assert resume_command(folder) in errors
        poses = pose_numbers(folder)
        resumed = finished(start(tmp_path, "run", "--resume", str(folder), "--json"), 0, 4)
    assert "reset. Nothing has moved." in resumed.err
    assert resumed.json["poses"] == 5
    assert pose_numbers(folder)[: len(poses)] == poses


def test_freeze_of_0_3_s_trips_no_drive_and_loses_no_pose(tmp_path, bus):
    with controller(tmp_path, *bus):
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "5", "--json")
        folder = wait_for_poses(tmp_path / "sessions", 1, run)
        freeze(run, bus, 0x701, times=3)  # heartbeats of joint 1, one every 0.1 s
        completed = finished(run, 0, 4)
    assert "heartbeat lost" not in completed.err
    assert (completed.json["poses"], pose_numbers(folder)) == (5, [1, 2, 3, 4, 5])


def test_reset_and_resume_succeed_after_torque_trip(tmp_path, bus):
    fault = ("--fault", "collision", "--fault-joint", "4", "--fault-sync", "1500")
    with controller(tmp_path, *bus, *PATIENT, *fault):
        errors, folder = run_until_fault(tmp_path, bus)
        count = len(pose_numbers(folder))
        assert "joint 4 tripped: excess torque (8311h)" in errors
        assert "Find what the joint hit or what overloads it. Then clear its trip" in errors
        assert "the arm is held" in errors
        assert count > 0
        assert f"clear its trip with: sarcal reset {Path('sessions') / folder.name}" in errors
        # Resuming without a reset is refused with the same advice.
        assert "sarcal reset" in finished(start(tmp_path, "run", "--resume", str(folder)), 3).err

        out = finished(start(tmp_path, "reset", str(folder)), 0).out
        assert "Joint 4  excess torque (8311h): reset" in out
        assert "Nothing has moved" in out
        resume = ("run", "--resume", str(folder), "--poses", str(count + 1))
        finished(start(tmp_path, *resume), 0, 2, 4)
        assert len(pose_numbers(folder)) == count + 1
        second_reset = finished(start(tmp_path, "reset", *bus, "--json"), 0)
        assert second_reset.json == {"cleared": [], "left": []}


def test_reset_reports_external_stop_that_is_still_pressed(tmp_path, bus):
    fault = ("--fault", "external-stop", "--fault-sync", "300")
    with controller(tmp_path, *bus, *PATIENT, *fault):
        errors, _ = run_until_fault(tmp_path, bus)
        assert "Release the external stop when it is safe" in errors
        assert "Find what the joint hit or what overloads it" not in errors
        errors = finished(start(tmp_path, "reset", *bus), 3).err
        assert errors.count("still has a fault") == 1
        assert "the arm still has a fault: external stop" in errors
        assert "release the external stop" in errors


def test_arm_is_not_reported_as_held_after_controller_dies(tmp_path, bus):
    with controller(tmp_path, *bus) as (process, _):
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "40")
        wait_for_poses(tmp_path / "sessions", 1, run)
        process.kill()
        errors = finished(run, 3).err
    assert "the arm is held" not in errors
    assert "did not answer the hold command" in errors
    errors = finished(start(tmp_path, "run", "--resume", "latest"), 3).err
    assert "no answer from nodes" in errors
    assert "held" not in errors


@pytest.mark.parametrize("existing", [False, True])
def test_failed_connection_removes_only_new_folders(tmp_path, run_command, bus, existing):
    sessions = tmp_path / "new" / "s"
    if existing:
        sessions.mkdir(parents=True)
    errors = run_command(3, "run", "hinge", *bus, "--sessions", sessions).err
    assert "no answer from nodes 1, 2, 3, 4, 5, 6, 7, 16" in errors
    assert "held" not in errors
    assert sorted(tmp_path.rglob("*")) == ([sessions.parent, sessions] if existing else [])


def test_arm_check_without_answer_reports_that_nothing_was_enabled(run_command, bus):
    report = run_command(3, "arm-check", *bus).out
    assert "no answer from nodes" in report
    assert "held" not in report
    assert "Nothing was enabled: there is no connection to the arm." in report


def test_probe_and_monitor_report_bus_traffic(tmp_path, bus):
    assert "no node answers" in finished(start(tmp_path, "probe", *bus), 3).err
    with controller(tmp_path, *bus, *PATIENT):
        nodes = finished(start(tmp_path, "probe", *bus, "--json"), 0).json["nodes"]
        assert [node["node"] for node in nodes] == [1, 2, 3, 4, 5, 6, 7, 16]
        assert not any(node["problems"] for node in nodes)

        monitor = start(tmp_path, "monitor", *bus)
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "40")
        folder = wait_for_poses(tmp_path / "sessions", 1, run)
        run.send_signal(signal.SIGINT)
        errors = finished(run, 130).err
        assert "the arm is held" in errors
        assert resume_command(folder) in errors
        other_operator = open_bus(BusSettings(interface="loopback", channel=bus[-1]))
        heartbeat = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        heartbeats = other_operator.send_periodic(heartbeat, 0.05)
        errors = finished(start(tmp_path, "probe", *bus), 3).err
        heartbeats.stop()
        other_operator.shutdown()
        assert "another program uses this bus: " in errors
        assert "the heartbeat of an operator, node 127 (COB-ID 77Fh)" in errors
        assert "No node was probed" in errors
        monitor.send_signal(signal.SIGINT)
        out = finished(monitor, 0).out
    for message in (
        "joint 3: has booted",
        "the operator (node 127): operational",
        "node 16: write of 0000007Fh to 2010h sub 0 requested",
        "joint 2: free mode commanded",
        "joint 1: drive operation enabled",
        "nothing was sent",
    ):
        assert message in out, message


def recorded_frames(file: Path) -> list[can.Message]:
    with can.LogReader(file) as frames:
        return list(frames)


def count_frames(frames: list[can.Message]) -> Counter[tuple[int, bytes]]:
    return Counter((frame.arbitration_id, bytes(frame.data)) for frame in frames)


def test_arm_check_enables_nothing_without_consent(tmp_path, bus):
    with controller(tmp_path, *bus, "--record", "all.log") as (process, _):
        look = ("arm-check", *bus, "--through", "look", "--json", "--record", "look.log")
        report = finished(start(tmp_path, *look), 0).json
        assert report["held"]
        assert {f["stage"] for f in report["findings"]} == {"look"}
        assert list(report["findings"][0]) == ["stage", "name", "passed", "text", "joint"]
        # Host latency is no fault of the arm: the period is then not determined.
        not_passed = {
            (f["name"], f["passed"]) for f in report["findings"] if f["passed"] is not True
        }
        assert not_passed <= {("period", None)}
        declined = finished(start(tmp_path, "arm-check", *bus), 0)
        assert "Enable them? [y/N]" in declined.err
        assert "not tried: declined" in declined.out
        process.send_signal(signal.SIGINT)
        process.wait(PATIENCE_S)
    # The controller's recording has the frames of both sides in order of time.
    frames = recorded_frames(tmp_path / "all.log")
    assert all(a.timestamp <= b.timestamp for a, b in pairwise(frames))
    assert frames[0].arbitration_id == 0x701
    all_counts = count_frames(frames)
    assert all_counts[0x000, b"\x01\x01"] == 2  # both commands started node 1
    assert all_counts[0x77F, b"\x05"] > 2
    look_counts = count_frames(recorded_frames(tmp_path / "look.log"))
    assert {0x080, 0x187, 0x601} <= {identifier for identifier, _ in look_counts}
    assert all(all_counts[frame] >= count for frame, count in look_counts.items())
