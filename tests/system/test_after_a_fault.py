"""After a kill, a trip or a dead controller: what the commands say is true, and what they advise works."""

import os
import signal
import subprocess
from collections import Counter
from collections.abc import Callable
from itertools import pairwise
from pathlib import Path

import can
import pytest

from hardware.buses.python_can import BusSettings, open_bus
from operator_app.session.store.journal import read_journal
from tests.oracles.own_process import controller, finished, start, wait_for_poses

pytestmark = pytest.mark.real_time

PATIENCE_S = 240
Start = Callable[..., subprocess.Popen[str]]


@pytest.fixture
def bus(request):
    """Options that name a bus of the test's own."""
    return ("-i", "loopback", "-c", f"fault-{os.getpid()}-{request.node.name[:24]}")


PATIENT = ("--heartbeat-timeout", "5")
"""Where nobody's death is the subject: a busy machine's lateness then trips no drive."""


def poses_of(folder: Path) -> list[int]:
    return [e.data["number"] for e in read_journal(folder).events if e.name == "pose"]


@pytest.mark.campaign
def test_after_a_freeze_the_same_command_goes_on(tmp_path, bus):
    """A frozen operator is missed by the drives, wakes up to their trip, and says how to go on."""
    with controller(tmp_path, *bus):
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "5")
        folder = wait_for_poses(tmp_path / "sessions", 1, run)
        listener = open_bus(BusSettings(interface="loopback", channel=bus[-1]))
        run.send_signal(signal.SIGSTOP)
        while True:  # until the first drive says that it misses the heartbeat
            frame = listener.recv(PATIENCE_S)
            assert frame is not None
            if frame.arbitration_id == 0x081 and frame.data[:2] == b"\x30\x81":
                break
        run.send_signal(signal.SIGCONT)
        listener.shutdown()
        said = finished(run, 3).err
        assert "heartbeat lost (8130h)" in said
        assert f"sarcal run --resume {Path('sessions') / folder.name}" in said
        before = poses_of(folder)
        done = finished(start(tmp_path, "run", "--resume", str(folder), "--json"), 0, 4)
    assert "reset. Nothing has moved." in done.err
    assert done.json["poses"] == 5
    assert poses_of(folder)[: len(before)] == before


@pytest.mark.campaign
def test_a_freeze_of_0_3_s_costs_nothing(tmp_path, bus):
    """Shorter than the drives' patience: no trip, no word of one, every pose."""
    with controller(tmp_path, *bus):
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "5", "--json")
        folder = wait_for_poses(tmp_path / "sessions", 1, run)
        listener = open_bus(BusSettings(interface="loopback", channel=bus[-1]))
        run.send_signal(signal.SIGSTOP)
        while listener.recv(0.0) is not None:
            pass  # what was said before
        for _ in range(3):  # heartbeats of joint 1, one every 0.1 s
            while (frame := listener.recv(PATIENCE_S)) and frame.arbitration_id != 0x701:
                pass
        run.send_signal(signal.SIGCONT)
        listener.shutdown()
        done = finished(run, 0, 4)
    assert "heartbeat lost" not in done.err
    assert done.json["poses"] == 5
    assert poses_of(folder) == [1, 2, 3, 4, 5]


@pytest.mark.campaign
def test_after_a_trip_what_is_advised_works(tmp_path, bus):
    fault = ("--fault", "collision", "--fault-joint", "4", "--fault-sync", "1500")
    with controller(tmp_path, *bus, *PATIENT, *fault):
        said = finished(start(tmp_path, "run", "hinge", *bus, "--poses", "40"), 3).err
        (folder,) = (tmp_path / "sessions").iterdir()
        taken = len(poses_of(folder))
        assert "joint 4 tripped: excess torque (8311h)" in said
        assert "Find what the joint hit or what overloads it. Then clear its trip" in said
        assert "the arm is held" in said
        assert taken > 0
        assert f"clear its trip with: sarcal reset {Path('sessions') / folder.name}" in said
        # Without it nothing goes on, and the same is said.
        said = finished(start(tmp_path, "run", "--resume", str(folder)), 3).err
        assert "sarcal reset" in said

        out = finished(start(tmp_path, "reset", str(folder)), 0).out
        assert "Joint 4  excess torque (8311h): reset" in out
        assert "Nothing has moved" in out
        wanted = str(taken + 1)
        finished(start(tmp_path, "run", "--resume", str(folder), "--poses", wanted), 0, 2, 4)
        assert len(poses_of(folder)) == taken + 1
        done = finished(start(tmp_path, "reset", *bus, "--json"), 0)
        assert done.json == {"cleared": [], "left": []}


@pytest.mark.campaign
def test_a_stop_that_is_still_pressed_stays_and_is_said(tmp_path, bus):
    fault = ("--fault", "external-stop", "--fault-sync", "300")
    with controller(tmp_path, *bus, *PATIENT, *fault):
        said = finished(start(tmp_path, "run", "hinge", *bus, "--poses", "40"), 3).err
        assert "Release the external stop when it is safe" in said
        assert "Find what the joint hit or what overloads it" not in said
        said = finished(start(tmp_path, "reset", *bus), 3).err
        assert said.count("still has a fault") == 1
        assert "the arm still has a fault: external stop" in said
        assert "release the external stop" in said


@pytest.mark.campaign
def test_a_controller_that_died_holds_no_arm(tmp_path, bus):
    with controller(tmp_path, *bus) as (arm, _):
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "40")
        wait_for_poses(tmp_path / "sessions", 1, run)
        arm.kill()
        said = finished(run, 3).err
    assert "the arm is held" not in said
    assert "did not answer the hold command" in said
    # It is still dead: nobody is there to hold, whatever an earlier run had connected to.
    said = finished(start(tmp_path, "run", "--resume", "latest"), 3).err
    assert "no answer from nodes" in said
    assert "held" not in said


@pytest.mark.campaign
@pytest.mark.parametrize("existing", [False, True])
def test_a_failed_connection_leaves_the_folders_that_were_there(tmp_path, ends_with, bus, existing):
    sessions = tmp_path / "new" / "s"
    if existing:
        sessions.mkdir(parents=True)
    said = ends_with(3, "run", "hinge", *bus, "--sessions", sessions).err
    assert "no answer from nodes 1, 2, 3, 4, 5, 6, 7, 16" in said
    assert "held" not in said
    left = [sessions.parent, sessions] if existing else []
    assert sorted(tmp_path.rglob("*")) == left


@pytest.mark.campaign
def test_arm_check_says_nothing_is_held_where_nothing_was_connected(ends_with, bus):
    told = ends_with(3, "arm-check", *bus).out
    assert "no answer from nodes" in told
    assert "held" not in told
    assert "Nothing was enabled: there is no connection to the arm." in told


@pytest.mark.campaign
def test_an_arm_that_was_stopped_by_itself_says_why_before_anything_else(tmp_path, bus):
    fault = ("--fault", "stray", "--fault-joint", "5", "--fault-sync", "500")
    with controller(tmp_path, *bus, *fault):
        said = finished(start(tmp_path, "run", "hinge", *bus, "--poses", "9"), 3).err
    assert said.index("oint 5 is +") < said.index("the arm has been stopped")
    assert "STOP is latched" not in said
    (folder,) = (tmp_path / "sessions").iterdir()
    assert f"sarcal run --resume {Path('sessions') / folder.name}" in said
    (told,) = [e.data for e in read_journal(folder).events if e.name == "sensor_fault"]
    assert told["joint"] == 5


@pytest.mark.campaign
def test_a_drive_that_was_switched_off_at_the_drive_stays_off_until_somebody_goes_on(tmp_path, bus):
    fault = ("--fault", "lost-enable", "--fault-joint", "3", "--fault-sync", "700")
    with controller(tmp_path, *bus, *fault):
        said = finished(start(tmp_path, "run", "hinge", *bus, "--poses", "6"), 3).err
        assert "joint 3: the drive is in state switched on; it was enabled" in said
        assert "Find out why the drive of joint 3 left its state." in said
        (folder,) = (tmp_path / "sessions").iterdir()
        assert f"Go on with: sarcal run --resume {Path('sessions') / folder.name}" in said
        done = finished(start(tmp_path, "run", "--resume", str(folder), "--json"), 0, 4)
    assert done.json["poses"] == 6


def test_nothing_to_reset_on_the_arm_inside_this_program(tmp_path, ends_with):
    assert "nothing to reset" in ends_with(2, "reset", "--sessions", tmp_path).err
    assert not list(tmp_path.iterdir())


@pytest.mark.campaign
def test_probe_and_monitor_look_at_a_bus_and_move_nothing(tmp_path, bus):
    said = finished(start(tmp_path, "probe", *bus), 3).err
    assert "no node answers" in said
    with controller(tmp_path, *bus, *PATIENT):
        found = finished(start(tmp_path, "probe", *bus, "--json"), 0).json
        assert [node["node"] for node in found["nodes"]] == [1, 2, 3, 4, 5, 6, 7, 16]
        assert not any(node["problems"] for node in found["nodes"])

        watcher = start(tmp_path, "monitor", *bus)
        run = start(tmp_path, "run", "hinge", *bus, "--poses", "40")
        folder = wait_for_poses(tmp_path / "sessions", 1, run)
        run.send_signal(signal.SIGINT)
        said = finished(run, 130).err
        assert "the arm is held" in said
        assert f"sarcal run --resume {Path('sessions') / folder.name}" in said
        own = open_bus(BusSettings(interface="loopback", channel=bus[-1]))
        beat = can.Message(arbitration_id=0x77F, data=b"\x05", is_extended_id=False)
        beating = own.send_periodic(beat, 0.05)
        said = finished(start(tmp_path, "probe", *bus), 3).err
        beating.stop()
        own.shutdown()
        assert "another program uses this bus: " in said
        assert "the heartbeat of an operator, node 127 (COB-ID 77Fh)" in said
        assert "No node was probed" in said
        watcher.send_signal(signal.SIGINT)
        out = finished(watcher, 0).out
    for words in (
        "joint 3: has booted",
        "the operator (node 127): operational",
        "node 16: 2010h sub 0 was written",
        "joint 2: free mode commanded",
        "joint 1: drive operation enabled",
        "nothing was sent",
    ):
        assert words in out, words


@pytest.mark.campaign
def test_arm_check_looks_at_an_arm_and_enables_nothing_unasked(tmp_path, bus):
    with controller(tmp_path, *bus, "--record", "all.log") as (arm, _):
        look = ("arm-check", *bus, "--through", "look", "--json", "--record", "look.log")
        found = finished(start(tmp_path, *look), 0).json
        assert found["held"]
        assert {f["stage"] for f in found["findings"]} == {"look"}
        assert list(found["findings"][0]) == ["stage", "name", "passed", "text", "joint"]
        # That a busy computer is late is nothing that the arm does.
        lacking = [f for f in found["findings"] if f["passed"] is not True]
        assert not [f for f in lacking if (f["name"], f["passed"]) != ("period", None)]
        with can.LogReader(tmp_path / "look.log") as recorded:
            assert {0x080, 0x187, 0x601} <= {frame.arbitration_id for frame in recorded}
        # Nobody answers: nothing is enabled.
        done = finished(start(tmp_path, "arm-check", *bus), 0)
        assert "Enable them? [y/N]" in done.err
        assert "not tried: declined" in done.out
        # What the controller records is all that both sides said, in the order of time.
        arm.send_signal(signal.SIGINT)
        arm.wait(PATIENCE_S)
    with can.LogReader(tmp_path / "all.log") as recorded:
        everything = list(recorded)
    assert all(a.timestamp <= b.timestamp for a, b in pairwise(everything))
    times = Counter((f.arbitration_id, bytes(f.data)) for f in everything)
    assert everything[0].arbitration_id == 0x701
    assert times[0x000, b"\x01\x01"] == 2  # both connected, and started node 1
    assert times[0x77F, b"\x05"] > 2
    with can.LogReader(tmp_path / "look.log") as recorded:
        looked = Counter((f.arbitration_id, bytes(f.data)) for f in recorded)
    assert all(times[frame] >= count for frame, count in looked.items())
