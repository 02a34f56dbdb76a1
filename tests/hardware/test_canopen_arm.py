"""The operator's arm against a fake bus: every promise of the `Arm` protocol, and what goes wrong."""

from __future__ import annotations

import hashlib
import itertools
import math
import struct
import threading
import time
from collections.abc import Callable, Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import can
import numpy as np
import pytest

from hardware.arm import Arm, ArmSnapshot, DriveState, JointMode
from hardware.buses import BusSettings
from hardware.canopen_arm import CanopenArm
from hardware.connection import BusOpeners
from hardware.description import (
    ArmDescription,
    EncoderDescription,
    JointDescription,
    RvdtDescription,
)
from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveFault,
    Intruder,
    ModeNotReached,
    NodeMissing,
    Stopped,
    UploadRefused,
    WrongArm,
)
from hardware.tasks import Steps, Task
from hardware.timing import Pace, Timing
from oracles.profiles import sarcos
from tests.hardware.fake_arm import COUNTS_PER_REV, JOINTS, FakeArmBus

PER_RAD = COUNTS_PER_REV / (2 * math.pi)
POSITION, FREE = JointMode.POSITION, JointMode.FREE
TWO_DRIVEN = [FREE, POSITION, FREE, FREE, POSITION, FREE, FREE]


def describe() -> ArmDescription:
    encoder = EncoderDescription(counts_per_rev=COUNTS_PER_REV)
    rvdt = RvdtDescription(bits=12, full_scale_rad=math.radians(120))
    return ArmDescription(
        model="fake",
        joints=tuple(
            JointDescription(
                name=f"joint {j}",
                lower_rad=-math.pi / 2 if j < JOINTS else -math.radians(30),
                upper_rad=math.pi / 2 if j < JOINTS else math.radians(30),
                max_speed_rad_per_s=1.0,
                max_torque_nm=50.0,
                sensor=encoder if j < JOINTS else rvdt,
            )
            for j in range(1, JOINTS + 1)
        ),
    )


def make(
    bus: FakeArmBus, *, description: ArmDescription | None = None, **options: Any
) -> CanopenArm:
    options.setdefault("pace", Pace.FAST_FORWARD)
    options.setdefault(
        "timing", Timing(answer_timeouts_s=dict.fromkeys(Pace, 0.05), heartbeat_timeout_s=0.35)
    )
    return CanopenArm(
        description or describe(),
        BusSettings(channel="fake"),
        options.pop("profile", sarcos()),
        openers=BusOpeners(main=lambda _settings: bus, stop=lambda _settings: bus.stop_handle()),
        **options,
    )


@pytest.fixture
def bus() -> FakeArmBus:
    fake = FakeArmBus()
    fake.drives[7].counts = 100
    return fake


@pytest.fixture(autouse=True)
def no_waiting(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr("hardware.connection.LISTEN_S", 0.02)
    monkeypatch.setattr("hardware.connection.BOOT_TIMEOUT_S", 0.2)


@pytest.fixture
def arm(bus: FakeArmBus) -> Iterator[CanopenArm]:
    made = make(bus)
    made.connect()
    yield made
    bus.broken = None
    made.close()


@pytest.fixture
def driven(arm: CanopenArm) -> CanopenArm:
    arm.take_control()
    arm.set_modes(TWO_DRIVEN)
    return arm


def frames(bus: FakeArmBus, base: int) -> list[tuple[int, bytes]]:
    return [(i, data) for i, data in bus.sent if base < i <= base + JOINTS]


def wait_for(condition: Callable[[], bool]) -> None:
    """Spin until a condition holds; pytest's own timeout ends what never does."""
    while not condition():
        pass


def capture_for_ever(arm: CanopenArm) -> None:
    while True:
        arm.capture(5)


# ---- connecting ------------------------------------------------------------------------------------


def test_it_is_an_arm(bus: FakeArmBus) -> None:
    arm: Arm = make(bus)
    assert callable(arm.connect)


def test_connecting_identifies_every_node(bus: FakeArmBus) -> None:
    arm = make(bus)
    identity = arm.connect()
    assert (identity.model, identity.serial_number) == ("fake", "FAKE-1")
    assert [node.node for node in identity.nodes] == [1, 2, 3, 4, 5, 6, 7, 16]
    assert identity.nodes[-1].role == "supervisor"
    assert identity.nodes[2].serial_number == 7003
    snapshot = arm.snapshot()
    assert [joint.position_counts for joint in snapshot.joints] == [
        1000,
        2000,
        3000,
        4000,
        5000,
        6000,
        100,
    ]
    assert snapshot.joints[0].position_rad == pytest.approx(1000 / PER_RAD)
    assert snapshot.joints[0].drive is DriveState.SWITCH_ON_DISABLED
    assert snapshot.token == 0
    assert set(snapshot.heartbeat_age_s) == {1, 2, 3, 4, 5, 6, 7, 16}
    arm.close()


def test_nothing_is_sent_before_the_others_were_listened_to(bus: FakeArmBus) -> None:
    bus.other_operator = True
    with pytest.raises(ControlDenied) as denied:
        make(bus).connect()
    assert denied.value.holder == 127
    assert bus.sent == []


COMMANDS_JOINT_1 = bytes.fromhex("0f000500000008")


@pytest.mark.parametrize(
    ("frames", "words"),
    [
        (((0x080, b""), (0x201, COMMANDS_JOINT_1)), r"a SYNC \(080h\)"),
        (((0x080, b"\x07"),), r"a SYNC \(080h\)"),
        (((0x201, COMMANDS_JOINT_1),), r"a command to joint 1 \(201h\)"),
        (((0x000, b"\x82\x00"),), r"an NMT command \(000h\)"),
    ],
)
def test_nothing_is_sent_where_another_master_works(
    bus: FakeArmBus,
    monkeypatch: pytest.MonkeyPatch,
    frames: tuple[tuple[int, bytes], ...],
    words: str,
) -> None:
    monkeypatch.setattr("hardware.connection.LISTEN_S", 0.3)
    bus.other_master = frames
    with pytest.raises(Intruder, match=f"else works on this bus: {words} came .* End that program"):
        make(bus).connect()
    assert bus.sent == []


def test_what_a_master_said_before_anybody_listened_bars_nobody(bus: FakeArmBus) -> None:
    """Our own predecessor may have been killed a moment ago, and an adapter have kept its last frames."""
    for frame in ((0x080, b""), (0x201, COMMANDS_JOINT_1), (0x000, b"\x82\x00")):
        bus.say(*frame)
    arm = make(bus)
    arm.connect()
    arm.close()


def test_a_master_that_comes_while_connecting_is_named() -> None:
    class Contested(FakeArmBus):
        def _handle(self, identifier: int, data: bytes) -> None:
            super()._handle(identifier, data)
            if (identifier, data) == (0x000, b"\x82\x07"):
                self._queue.append((0x000, b"\x80\x00"))

    with pytest.raises(Intruder, match=r"commands this arm: an NMT command \(000h\)"):
        make(Contested()).connect()


def test_other_devices_on_the_bus_are_not_reset_and_not_started(bus: FakeArmBus) -> None:
    arm = make(bus)
    arm.connect()
    arm.close()
    nodes = [*range(1, 8), 16]
    told = [data for identifier, data in bus.sent if identifier == 0x000]
    assert told == [bytes([command, node]) for command in (0x82, 0x01) for node in nodes]


def test_missing_nodes_are_named(bus: FakeArmBus) -> None:
    bus.dead = {3, 16}
    with pytest.raises(NodeMissing) as missing:
        make(bus).connect()
    assert missing.value.nodes == (3, 16)


def test_another_arm_is_named_with_everything_that_differs(bus: FakeArmBus) -> None:
    bus.model, bus.full_scale = "other", 110_000_000
    description = describe()
    joints = list(description.joints)
    joints[1] = replace(joints[1], upper_rad=1.0)
    joints[3] = replace(joints[3], sensor=EncoderDescription(counts_per_rev=1000))
    with pytest.raises(WrongArm) as wrong:
        make(bus, description=replace(description, joints=tuple(joints))).connect()
    text = str(wrong.value)
    for part in (
        "'other'",
        "joint 2 has the range",
        "joint 4 has an encoder",
        "joint 7 has an RVDT of 110.000000 deg",
    ):
        assert part in text
    assert "joint 1 " not in text


def test_nothing_runs_after_a_failed_connection(bus: FakeArmBus) -> None:
    bus.dead = {3}
    before = threading.active_count()
    with pytest.raises(NodeMissing):
        make(bus).connect()
    assert threading.active_count() == before


def test_calls_before_connecting_say_so(bus: FakeArmBus) -> None:
    with pytest.raises(BusError, match="not connected"):
        make(bus).snapshot()


# ---- control and modes -----------------------------------------------------------------------------


def test_taking_control_enables_every_drive_where_it_is(arm: CanopenArm, bus: FakeArmBus) -> None:
    before = [drive.counts for drive in bus.drives.values()]
    arm.take_control()
    assert bus.token == 127
    assert {drive.status for drive in bus.drives.values()} == {0x27}
    assert [drive.target for drive in bus.drives.values()] == before
    snapshot = arm.snapshot()
    assert snapshot.token == 127
    assert {joint.mode for joint in snapshot.joints} == {POSITION}


def test_a_token_held_by_somebody_else_is_respected(arm: CanopenArm, bus: FakeArmBus) -> None:
    bus.token = 42
    with pytest.raises(ControlDenied) as denied:
        arm.take_control()
    assert denied.value.holder == 42
    assert frames(bus, 0x200) == []


def test_an_operator_who_appears_later_is_respected(arm: CanopenArm, bus: FakeArmBus) -> None:
    bus.say(0x77F, b"\x05")
    wait_for(arm._link.other_operator)
    with pytest.raises(ControlDenied):
        arm.take_control()


def test_a_faulted_drive_is_named_when_control_is_taken(arm: CanopenArm, bus: FakeArmBus) -> None:
    bus.drives[4].status = 0x08
    with pytest.raises(DriveFault) as fault:
        arm.take_control()
    assert (fault.value.joint, fault.value.code) == (4, 0x8611)


def test_modes_are_read_back(driven: CanopenArm, bus: FakeArmBus) -> None:
    assert [drive.mode for drive in bus.drives.values()] == [10, 8, 10, 10, 8, 10, 10]
    assert [joint.mode for joint in driven.snapshot().joints] == TWO_DRIVEN


def test_a_mode_that_is_not_reached_is_named(arm: CanopenArm, bus: FakeArmBus) -> None:
    arm.take_control()
    bus.drives[3].follows_mode = False
    with pytest.raises(ModeNotReached) as late:
        arm.set_modes(TWO_DRIVEN)
    assert (late.value.joint, late.value.wanted, late.value.actual) == (3, "free", "position")


def test_modes_need_enabled_drives(arm: CanopenArm) -> None:
    with pytest.raises(CommandRefused, match="switch on disabled"):
        arm.set_modes(TWO_DRIVEN)


def test_holding_puts_free_joints_where_they_are(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.drives[3].counts = 3456
    driven.hold()
    assert bus.drives[3].target == 3456
    assert {drive.mode for drive in bus.drives.values()} == {8}


# ---- moving ----------------------------------------------------------------------------------------


def test_a_move_reaches_its_targets_in_small_steps(driven: CanopenArm, bus: FakeArmBus) -> None:
    result = driven.move({2: 0.2, 5: -0.1}, speed_rad_per_s=0.5)
    assert result.reached
    assert result.reason == ""
    assert bus.drives[2].counts == round(0.2 * PER_RAD)
    assert bus.drives[5].counts == round(-0.1 * PER_RAD)
    assert result.positions_rad[1] == pytest.approx(0.2, abs=1 / PER_RAD)
    targets = [target for _, target, _ in bus.drives[2].heard]
    assert max(abs(b - a) for a, b in itertools.pairwise(targets)) <= 0.5 * 0.01 * PER_RAD + 1
    assert not driven.snapshot().moving


def test_the_same_moves_take_the_same_syncs_every_time() -> None:
    counts = []
    for _ in range(2):
        fake = FakeArmBus()
        fake.drives[7].counts = 100
        arm = make(fake)
        arm.connect()
        arm.take_control()
        arm.set_modes(TWO_DRIVEN)
        arm.move({2: 0.2, 5: -0.1}, speed_rad_per_s=0.5)
        arm.settle(window=5, spread_rad=[1e-3] * JOINTS, timeout_syncs=50)
        arm.capture(10)
        counts.append(fake.syncs)
        arm.close()
    assert counts[0] == counts[1]


@pytest.mark.parametrize(
    ("targets", "speed", "words"),
    [
        ({2: 3.0}, 0.5, "outside"),
        ({2: math.nan}, 0.5, "finite"),
        ({2: 0.1}, 5.0, "rad/s"),
        ({2: 0.1}, 0.0, "rad/s"),
        ({3: 0.1}, 0.5, "free mode"),
    ],
)
def test_a_move_out_of_bounds_never_starts(
    driven: CanopenArm, bus: FakeArmBus, targets: dict[int, float], speed: float, words: str
) -> None:
    before = len(frames(bus, 0x200))
    with pytest.raises(CommandRefused, match=words):
        driven.move(targets, speed_rad_per_s=speed)
    assert len(frames(bus, 0x200)) == before


def test_a_watch_ends_the_move_with_its_words_and_deceleration(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    seen: list[ArmSnapshot] = []

    def watch(snapshot: ArmSnapshot) -> str | None:
        seen.append(snapshot)
        return "far enough" if snapshot.joints[1].position_rad > 0.2 else None

    result = driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=watch)
    assert (result.reached, result.reason) == (False, "far enough")
    assert 0.2 < result.positions_rad[1] < 0.5
    assert seen[-1].moving
    assert seen[-1].joints[1].speed_rad_per_s == pytest.approx(0.5, rel=0.05)
    targets = np.array([target for _, target, _ in bus.drives[2].heard]) / PER_RAD
    last_steps = np.diff(targets)[-4:] / 0.01
    assert np.all(np.abs(last_steps) < 0.2), "it stopped without slowing down"
    assert bus.drives[2].counts == bus.drives[2].target


def test_an_exception_of_the_watch_arrives_when_the_arm_is_at_rest(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    def watch(snapshot: ArmSnapshot) -> str | None:
        if snapshot.joints[1].position_rad > 0.2:
            raise RuntimeError("broken watch")
        return None

    with pytest.raises(RuntimeError, match="broken watch"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=watch)
    assert driven.move({2: 0.0}, speed_rad_per_s=0.5).reached


def test_ctrl_c_in_a_move_leaves_the_arm_at_rest(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    reached_middle = threading.Event()
    bus.on_sync = lambda _sync: bus.drives[2].target > 0.3 * PER_RAD and reached_middle.set()
    wait, interrupted = Task.wait, []

    def interrupted_wait(task: Task, someone_there: Callable[[], bool]) -> bool:
        if not interrupted:
            interrupted.append(reached_middle.wait(10))
            raise KeyboardInterrupt
        return wait(task, someone_there)

    monkeypatch.setattr(Task, "wait", interrupted_wait)
    with pytest.raises(KeyboardInterrupt):
        driven.move({2: 1.5}, speed_rad_per_s=0.5)
    rest = bus.drives[2].target
    assert 0.3 * PER_RAD < rest < 1.5 * PER_RAD - 1
    assert not driven.snapshot().moving
    driven.capture(20)
    assert bus.drives[2].target == rest


def test_a_tripped_drive_ends_the_move_and_all_others_hold(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    start = bus.syncs
    bus.on_sync = lambda sync: bus.trip(5, 0x8311) if sync == start + 40 else None
    with pytest.raises(DriveFault) as fault:
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert (fault.value.joint, fault.value.code) == (5, 0x8311)
    assert fault.value.args[0].startswith("joint 5 tripped: excess torque")
    assert {drive.mode for joint, drive in bus.drives.items() if joint != 5} == {8}
    assert [f.code for f in driven.snapshot().faults] == [0x8311]
    with pytest.raises(DriveFault):
        driven.capture(3)


def brake_at(angle_rad: float) -> Callable[[ArmSnapshot], str | None]:
    return lambda now: "far enough" if now.joints[1].position_rad > angle_rad else None


def after_braking_began(bus: FakeArmBus, syncs: int, act: Callable[[], None]) -> None:
    """Let something happen some SYNCs after joint 2 passed 0.2 rad, where it is told to brake."""
    passed: list[int] = []

    def look(sync: int) -> None:
        if not passed and bus.drives[2].counts > 0.2 * PER_RAD:
            passed.append(sync)
        if passed and sync == passed[0] + syncs:
            act()

    bus.on_sync = look


@pytest.mark.parametrize("joint", [2, 5])
def test_a_drive_that_trips_while_braking_is_named_and_all_others_hold(
    driven: CanopenArm, bus: FakeArmBus, joint: int
) -> None:
    after_braking_began(bus, 10, lambda: bus.trip(joint, 0x8311))
    with pytest.raises(DriveFault) as fault:
        driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=brake_at(0.2))
    assert (fault.value.joint, fault.value.code) == (joint, 0x8311)
    assert {drive.mode for j, drive in bus.drives.items() if j != joint} == {8}


def test_a_trip_is_a_trip_when_its_emergency_comes_after_its_statusword(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    start = bus.syncs

    def trip_in_two_parts(sync: int) -> None:
        if sync == start + 40:
            bus.drives[2].status = 0x08
        elif sync == start + 45:
            bus.trip(2, 0x8311)

    bus.on_sync = trip_in_two_parts
    with pytest.raises(DriveFault):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert {drive.mode for j, drive in bus.drives.items() if j != 2} == {8}


def test_an_external_stop_while_braking_is_a_stop_at_once(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    external = struct.pack("<HB5x", 0x5441, 0x81)
    after_braking_began(bus, 10, lambda: bus.say(0x90, external))
    with pytest.raises(Stopped, match="external stop"):
        driven.move({2: 1.0}, speed_rad_per_s=0.5, watch=brake_at(0.2))
    targets = [target for _, target, _ in bus.drives[2].heard]
    assert targets[-1] - targets[-2] > 0.1 * 0.01 * PER_RAD, "it was braked to rest first"


# ---- settling and capturing ------------------------------------------------------------------------


def test_settling_waits_for_the_spread_to_shrink(driven: CanopenArm, bus: FakeArmBus) -> None:
    start = bus.syncs
    bus.drives[4].noise = lambda sync: 500 if sync < start + 30 and sync % 2 else 0
    spread = [100 / PER_RAD] * JOINTS
    assert driven.settle(window=10, spread_rad=spread, timeout_syncs=200)
    assert 38 <= bus.syncs - start <= 41


def test_settling_gives_up_after_its_syncs(driven: CanopenArm, bus: FakeArmBus) -> None:
    start = bus.syncs
    bus.drives[4].noise = lambda sync: 500 * (sync % 2)
    spread = [100 / PER_RAD] * JOINTS
    assert not driven.settle(window=10, spread_rad=spread, timeout_syncs=60)
    assert bus.syncs - start == 60


def test_a_reading_is_mean_sd_and_count_of_the_samples(driven: CanopenArm, bus: FakeArmBus) -> None:
    noise = [3, -1, 4, 1, -5, 9, -2, 6]
    start = bus.syncs
    bus.drives[6].noise = lambda sync: noise[(sync - start - 1) % len(noise)]
    reading = driven.capture(len(noise))
    values = np.array(noise) + 6000
    assert reading.samples == len(noise)
    assert reading.mean_counts[5] == values.mean()
    assert reading.mean_rad[5] == pytest.approx(values.mean() / PER_RAD, rel=1e-14)
    variance = sum((v - values.mean()) ** 2 for v in values) / (len(noise) - 1)
    assert reading.sd_rad[5] == pytest.approx(math.sqrt(variance) / PER_RAD, rel=1e-12)
    assert reading.sd_rad[0] == 0.0
    assert reading.first_sync == driven.snapshot().sync_count - len(noise) + 1


def test_one_sample_has_no_deviation(driven: CanopenArm) -> None:
    assert np.all(driven.capture(1).sd_rad == 0.0)


@pytest.mark.parametrize("fault", ["silent", "twice"])
def test_a_sample_that_is_not_whole_is_no_part_of_a_reading(
    driven: CanopenArm, bus: FakeArmBus, fault: str
) -> None:
    start = bus.syncs

    def disturb(sync: int) -> None:
        joints = getattr(bus, fault)
        joints.clear()
        if sync == start + 3:
            joints.add(2)
            bus.drives[6].counts += 1000
        elif sync == start + 4:
            bus.drives[6].counts -= 1000

    bus.on_sync = disturb
    reading = driven.capture(6)
    assert bus.syncs - start == 7
    assert reading.mean_counts[5] == 6000
    assert reading.sd_rad[5] == 0.0


# ---- what goes silent ------------------------------------------------------------------------------


def test_a_joint_that_stops_answering_is_named_and_nothing_hangs(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    bus.silent = {6}
    with pytest.raises(BusError, match="no answer to SYNC from node 6"):
        driven.move({2: 0.5}, speed_rad_per_s=0.5)
    assert bus.drives[2].target < 0.1 * PER_RAD
    bus.silent = set()
    driven_again = driven.snapshot()
    assert driven_again.joints[5].age_s > driven_again.joints[0].age_s


def test_lost_heartbeats_are_named(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.dead = {16}
    with pytest.raises(BusError, match="no heartbeat from node 16"):
        capture_for_ever(driven)


def test_a_broken_bus_is_a_bus_error_everywhere(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.broken = can.CanOperationError("cable cut")
    with pytest.raises(BusError, match="cable cut"):
        driven.capture(5)
    with pytest.raises(BusError):
        driven.active_parameters()
    with pytest.raises(BusError, match="emergency stop"):
        driven.stop()
    driven.close()


def test_a_node_that_restarts_is_named(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.say(0x703, b"\x00")
    bus.say(0x703, b"\x7f")
    with pytest.raises(BusError, match="Node 3 has left operation"):
        capture_for_ever(driven)


def test_a_target_the_drive_refuses_is_no_trip(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.say(0x82, struct.pack("<HB5x", 0x8612, 0x81))
    with pytest.raises(CommandRefused, match="joint 2: target refused"):
        capture_for_ever(driven)
    bus.say(0x82, struct.pack("<HB5x", 0x0000, 0x00))
    wait_for(lambda: driven.snapshot().faults == ())
    driven.capture(1)


def test_one_lost_answer_does_not_end_a_move(driven: CanopenArm, bus: FakeArmBus) -> None:
    start = bus.syncs

    def lose_one(sync: int) -> None:
        bus.silent = {4} if sync == start + 20 else set()

    bus.on_sync = lose_one
    assert driven.move({2: 0.2}, speed_rad_per_s=0.5).reached


def test_frames_that_mean_nothing_are_passed_over(driven: CanopenArm, bus: FakeArmBus) -> None:
    for identifier, data in (
        (0x181, b""),  # a TPDO1 of another length
        (0x703, b"\x05\x05"),
        (0x083, b"\x11"),
        (0x583, b"\x00"),
        (0x585, bytes(8)),
        (0x7FF, bytes(8)),
        (0x730, b"\x05"),  # heartbeat and emergency of a stranger
        (0x0B0, bytes(8)),
    ):
        bus.say(identifier, data)
    reading = driven.capture(5)
    assert reading.mean_counts.tolist()[:6] == [1000.0 * j for j in range(1, 7)]
    assert driven.snapshot().faults == ()
    assert driven.active_parameters() == b""


# ---- STOP ------------------------------------------------------------------------------------------


def test_stop_reaches_all_drives_and_latches(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    assert driven.snapshot().stopped
    for refused in (
        lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1),
        driven.take_control,
        driven.hold,
    ):
        with pytest.raises(Stopped):
            refused()
    assert {drive.status for drive in bus.drives.values()} == {0x07}


def test_after_stop_during_a_move_the_last_word_is_quick_stop(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    start = bus.syncs
    bus.on_sync = lambda sync: driven.stop() if sync == start + 30 else None
    with pytest.raises(Stopped):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    last = {i: struct.unpack("<Hib", data)[0] for i, data in frames(bus, 0x200)}
    assert last == {0x200 + j: 0x0002 for j in range(1, JOINTS + 1)}
    assert {drive.status for drive in bus.drives.values()} == {0x07}


def test_a_command_under_way_when_stop_comes_is_followed_by_quick_stop(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP strikes between the loop's look at the latch and its frame."""
    loop = driven._link.loop
    send = loop._wire.send
    struck = []

    def late_send(identifier: int, data: bytes) -> None:
        if identifier == 0x202 and bus.drives[2].target > 0.1 * PER_RAD and not struck:
            struck.append(identifier)
            driven.stop()
        send(identifier, data)

    monkeypatch.setattr(loop._wire, "send", late_send)
    with pytest.raises(Stopped):
        driven.move({2: 1.0}, speed_rad_per_s=0.5)
    assert struck
    words = [struct.unpack("<Hib", data)[0] for i, data in bus.sent if i == 0x202]
    late = len(words) - 1 - words[::-1].index(0x000F)
    assert words[late - 1] == 0x0002, "the late frame of this test did not come late"
    assert set(words[late + 1 :]) == {0x0002}


STAGES = {
    "listening": lambda identifier, _: identifier == -1,
    "the reset": lambda identifier, data: identifier == 0x000 and data[0] == 0x82,
    "reading": lambda identifier, data: identifier == 0x604 and data[1:3] == b"\x00\x1a",
    "the start": lambda identifier, data: identifier == 0x000 and data[0] == 0x01,
    "SYNC": lambda identifier, _: identifier == 0x080,
}


@pytest.mark.parametrize("stage", STAGES)
def test_stop_while_connecting_is_latched_and_sent_and_ends_it(
    stage: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """By the time a STOP is pressed the bus may be open, and a drive may be moving for whoever was before us."""

    class Pressed(FakeArmBus):
        pressed = False

        def _handle(self, identifier: int, data: bytes) -> None:
            super()._handle(identifier, data)
            if STAGES[stage](identifier, data) and not self.pressed:
                self.pressed = True
                arm.stop()

        def _recv_internal(self, timeout: float | None) -> tuple[can.Message | None, bool]:
            if stage == "listening" and not self.pressed:
                self.pressed = True
                arm.stop()
            return super()._recv_internal(timeout)

    monkeypatch.setattr("hardware.connection.LISTEN_S", 30.0 if stage == "listening" else 0.02)
    bus = Pressed()
    bus.drives[7].counts = 100
    arm = make(bus)
    begun = time.monotonic()
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert time.monotonic() - begun < 10.0
    assert [data[:2] for _, data in frames(bus, 0x200)] == [b"\x02\x00"] * JOINTS
    with pytest.raises(BusError, match="not connected"):
        arm.stop()
    arm.connect()
    assert arm.snapshot().stopped
    with pytest.raises(Stopped):
        arm.take_control()
    arm.close()


def test_stop_before_the_bus_is_open_is_latched_and_ends_connecting(bus: FakeArmBus) -> None:
    def opened(_: BusSettings) -> can.BusABC:
        arm.stop()
        return bus

    arm = CanopenArm(
        describe(),
        BusSettings(channel="fake"),
        sarcos(),
        openers=BusOpeners(main=opened, stop=lambda _: bus.stop_handle()),
    )
    with pytest.raises(Stopped, match="STOP was pressed while connecting"):
        arm.connect()
    assert bus.sent == []


def test_stop_needs_no_lock(driven: CanopenArm) -> None:
    with driven._link._wire._send_lock:
        driven.stop()
    assert driven.snapshot().stopped


def test_reset_clears_the_latch_and_moves_nothing(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    bus.trip(3, 0x7305)
    positions = [drive.counts for drive in bus.drives.values()]
    driven.reset_stop()
    assert {drive.status for drive in bus.drives.values()} == {0x40}
    snapshot = driven.snapshot()
    assert not snapshot.stopped
    assert snapshot.faults == ()
    assert [drive.counts for drive in bus.drives.values()] == positions
    with pytest.raises(CommandRefused):
        driven.move({2: 0.1}, speed_rad_per_s=0.1)
    driven.take_control()
    assert {drive.status for drive in bus.drives.values()} == {0x27}
    assert [drive.counts for drive in bus.drives.values()] == positions


def test_an_external_stop_is_a_stop(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.say(0x90, struct.pack("<HB5x", 0x5441, 0x81))
    with pytest.raises(Stopped, match="external stop"):
        capture_for_ever(driven)


def test_a_stop_between_reset_and_its_turn_stays(
    driven: CanopenArm, bus: FakeArmBus, monkeypatch: pytest.MonkeyPatch
) -> None:
    """STOP strikes after RESET was asked for and before the loop comes to it."""
    driven.stop()
    loop = driven._link.loop
    run = loop.run

    def late_run(asked: Steps, **options: Any) -> Any:
        driven.stop()
        return run(asked, **options)

    with monkeypatch.context() as patched:
        patched.setattr(loop, "run", late_run)
        with pytest.raises(Stopped, match="again"):
            driven.reset_stop()
    assert driven.snapshot().stopped
    assert {drive.status for drive in bus.drives.values()} == {0x07}
    driven.reset_stop()
    assert not driven.snapshot().stopped
    assert {drive.status for drive in bus.drives.values()} == {0x40}


def test_a_stop_while_being_reset_stays(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    start = bus.syncs
    bus.on_sync = lambda sync: driven.stop() if sync == start + 2 else None
    with pytest.raises(Stopped):
        driven.reset_stop()
    assert driven.snapshot().stopped


def test_one_reset_lifts_all_stops_before_it(driven: CanopenArm) -> None:
    for _ in range(3):
        driven.stop()
    driven.reset_stop()
    assert not driven.snapshot().stopped


def test_a_stop_outlives_the_connection(driven: CanopenArm, bus: FakeArmBus) -> None:
    driven.stop()
    driven.close()
    driven.connect()
    assert driven.snapshot().stopped
    for refused in (driven.take_control, lambda: driven.move({2: 0.1}, speed_rad_per_s=0.1)):
        with pytest.raises(Stopped):
            refused()
    driven.reset_stop()
    assert not driven.snapshot().stopped
    driven.take_control()
    driven.set_modes(TWO_DRIVEN)
    assert driven.move({2: 0.1}, speed_rad_per_s=0.1).reached


def test_a_connected_arm_is_not_connected_again(arm: CanopenArm) -> None:
    with pytest.raises(ValueError, match="already"):
        arm.connect()


# ---- parameters ------------------------------------------------------------------------------------

DOCUMENT = ("schema: sarcal/parameters/1\n" + "x: 1.0\n" * 600).encode()


def test_an_upload_is_staged_read_back_and_committed(driven: CanopenArm, bus: FakeArmBus) -> None:
    receipt = driven.upload_parameters(DOCUMENT)
    assert bus.document == DOCUMENT
    assert receipt.sha256 == hashlib.sha256(DOCUMENT).hexdigest()
    assert (receipt.slot, receipt.length) == ("A", len(DOCUMENT))
    assert receipt.home_offset_counts == tuple(-11 * j for j in range(1, JOINTS + 1))
    assert driven.active_parameters() == DOCUMENT


@pytest.mark.parametrize("document", [b"", b"abc", b"abcd", b"abcdefg", bytes(range(256))])
def test_any_length_survives(driven: CanopenArm, bus: FakeArmBus, document: bytes) -> None:
    if document:
        driven.upload_parameters(document)
    assert driven.active_parameters() == document


def test_a_refusal_carries_the_controllers_words(driven: CanopenArm, bus: FakeArmBus) -> None:
    bus.document, bus.refusal = b"the one before", "serial SDA-0007 is another arm"
    with pytest.raises(UploadRefused, match="serial SDA-0007 is another arm"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


def test_a_document_that_comes_back_different_is_dropped(
    driven: CanopenArm, bus: FakeArmBus
) -> None:
    bus.document, bus.corrupts = b"the one before", True
    with pytest.raises(UploadRefused, match=f"byte {len(DOCUMENT) - 1} differs"):
        driven.upload_parameters(DOCUMENT)
    assert driven.active_parameters() == b"the one before"


def test_uploading_needs_control(arm: CanopenArm) -> None:
    with pytest.raises(CommandRefused, match="control"):
        arm.upload_parameters(DOCUMENT)


# ---- pace, closing, recording ----------------------------------------------------------------------


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
