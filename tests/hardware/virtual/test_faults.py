import pytest

from hardware.arm import JointMode
from hardware.virtual.faults import ScriptedFault, inject
from tests.hardware.virtual.conftest import wait_for_heartbeats
from tests.oracles.virtual_rig import Rig, rig

STATE, FAULT, QUICK_STOPPED = 0x006F, 0x08, 0x07


def emergency_codes(arm: Rig, node: int) -> list[int]:
    return [int.from_bytes(data[:2], "little") for data in arm.peer.seen(0x80 + node)]


def expect_trip(arm: Rig, joint: int, code: int) -> None:
    """The joint trips with the code, its valve blocked; all others do a quick stop and hold."""
    for _ in range(8):
        states = arm.peer.sync()
    assert emergency_codes(arm, joint) == [code]
    for j, (word, _, _) in enumerate(states, start=1):
        if j == joint:
            assert word & 0x4F == FAULT
        else:
            assert word & STATE == QUICK_STOPPED
            assert emergency_codes(arm, j) == []
    modes = [mode for mode, _ in arm.plant.commands]
    assert modes[joint - 1] is None
    assert {m for k, m in enumerate(modes) if k != joint - 1} == {JointMode.POSITION}


@pytest.mark.parametrize(
    ("quantity", "joint", "value", "code"),
    [
        ("torque_nm", 5, -150.0, 0x8311),
        ("speed_rad_per_s", 3, 3.2, 0x8400),
        ("angles_rad", 6, 1.3, 0x7305),
    ],
    ids=["excess torque", "overspeed of a free joint", "RVDT at the end of its converter"],
)
def test_trip_sends_its_code_and_stops_other_drives(arm, quantity, joint, value, code):
    arm.operational([8, 10, 10, 10, 8, 10, 10])
    arm.run_in_loop(lambda: getattr(arm.plant, quantity).__setitem__(joint - 1, value))
    expect_trip(arm, joint, code)
    assert (arm.peer.unsigned(joint, 0x1001), arm.peer.unsigned(joint, 0x603F)) == (0x21, code)


def test_lost_enable_shows_only_in_the_statusword(arm):
    states = arm.operational()
    arm.inject_fault("lost-enable", 3)
    words = [word for word, _, _ in arm.peer.sync()]
    assert [word & STATE for word in words] == [0x23 if j == 3 else 0x27 for j in range(1, 8)]
    assert emergency_codes(arm, 3) == []
    # Repeating the last command enables the drive again, so an operator must not repeat it.
    arm.peer.command(3, 0x0F, states[2][1], 8)
    arm.peer.sync()
    assert arm.peer.sync()[2][0] & STATE == 0x27


@pytest.mark.parametrize(("kind", "joint"), [("deaf-drive", 1), ("frozen-sensor", 2)])
def test_joint_at_fault_keeps_its_count(arm, kind, joint):
    """The statusword of a deaf drive shows it by bit 12, a frozen sensor causes a following error."""
    start = target = arm.operational()[joint - 1][1]
    assert {word & 0x1000 for word, _, _ in arm.peer.sync()} == {0x1000}
    arm.inject_fault(kind, joint)
    for _ in range(3):
        target += 90
        arm.peer.command(joint, 0x0F, target, 8)
        states = arm.peer.sync()
        assert states[joint - 1][1] == start
        if kind == "deaf-drive":
            cleared = [j for j, (word, _, _) in enumerate(states, 1) if not word & 0x1000]
            assert (states[0][0] & STATE, cleared) == (0x27, [1])
    if kind == "frozen-sensor":
        arm.peer.command(joint, 0x0F, target + 90, 8)
        expect_trip(arm, joint, 0x8611)
        arm.clear_fault("frozen-sensor", joint)
        assert arm.peer.sync()[joint - 1][1] != start


def test_broken_sensor_trips_7305h_and_reset_needs_repair(arm):
    arm.operational()
    arm.inject_fault("broken-sensor", 7)
    expect_trip(arm, 7, 0x7305)
    arm.peer.command(7, 0x80, 0, 8)
    assert arm.peer.sync()[6][0] & 0x4F == FAULT
    arm.clear_fault("broken-sensor", 7)
    arm.peer.command(7, 0x00, 0, 8)
    arm.peer.command(7, 0x80, 0, 8)
    assert arm.peer.sync()[6][0] & 0x4F == 0x40
    assert emergency_codes(arm, 7) == [0x7305, 0]


def test_no_drive_is_enabled_while_one_is_in_fault(arm):
    arm.operational()
    arm.run_in_loop(lambda: arm.plant.speed_rad_per_s.__setitem__(2, 9.9))
    arm.peer.sync()
    arm.peer.command_all(0x00)
    states = arm.peer.enable([8] * 7)
    assert all(word & STATE != 0x27 for word, _, _ in states)


def test_external_stop_trips_all_drives_until_released(arm):
    arm.operational()
    arm.inject_fault("external-stop")
    states = arm.peer.sync()
    assert [word & 0x4F for word, _, _ in states] == [FAULT] * 7
    assert {mode for mode, _ in arm.plant.commands} == {None}
    assert [emergency_codes(arm, node) for node in (*range(1, 8), 16)] == [[0x5441]] * 8
    arm.peer.command_all(0x80)
    assert [word & 0x4F for word, _, _ in arm.peer.sync()] == [FAULT] * 7
    for joint in range(1, 8):
        arm.clear_fault("external-stop", joint)
    arm.peer.command_all(0x00, 0x80)
    assert [word & 0x4F for word, _, _ in arm.peer.sync()] == [0x40] * 7


def test_refused_mode_switch_keeps_6061h(arm):
    arm.operational()
    arm.inject_fault("refused-modes", 3)
    for joint in (2, 3):
        arm.peer.command(joint, 0x0F, 0, 10)
    for _ in range(20):
        arm.peer.sync()
    assert [arm.peer.signed(joint, 0x6061) for joint in (1, 2, 3)] == [8, 10, 8]
    arm.clear_fault("refused-modes", 3)
    arm.peer.sync()
    assert arm.peer.signed(3, 0x6061) == 10


def test_restart_clears_token_power_and_nmt_state(arm):
    arm.operational()
    arm.peer.log.clear()
    inject(arm.controller, "restart", 1)
    wait_for_heartbeats(arm, 0)
    assert arm.peer.unsigned(16, 0x2010) == 0
    arm.peer.send(0x080)
    arm.peer.read(1, 0x1000)
    assert arm.peer.seen(0x181) == []
    arm.peer.start()
    assert [word & 0x4F for word, _, _ in arm.peer.sync()] == [0x40] * 7
    assert {mode for mode, _ in arm.plant.commands} == {None}


def test_scripted_faults_occur_at_their_sync():
    script = [
        ScriptedFault(kind="broken-sensor", joint=2, at_sync=12),
        ScriptedFault(kind="missed-answers", joint=5, at_sync=14),
    ]

    def run() -> list[tuple[int, bytes]]:
        with rig(script=script) as arm:
            arm.peer.start()
            for _ in range(14):
                arm.peer.send(0x080)
            arm.run_in_loop()
            return [frame for frame in arm.peer.log if frame[0] < 0x200]

    frames = run()
    assert frames == run()
    numbers = [number for number, _ in frames]
    assert numbers.count(0x185) == 13
    assert numbers[: numbers.index(0x82)].count(0x181) == 11


def test_fault_of_unknown_joint_is_refused(arm):
    with pytest.raises(ValueError, match="joint 8"):
        inject(arm.controller, "broken-sensor", 8)
