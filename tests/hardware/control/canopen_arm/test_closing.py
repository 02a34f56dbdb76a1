import threading

import pytest

from hardware.errors import BusError, DriveFault
from tests.hardware.control.canopen_arm.conftest import wait_for
from tests.hardware.fake_arm import JOINTS, capture_for_ever


def test_fast_forward_sends_no_sync_when_idle(driven, bus):
    before = bus.syncs
    for _ in range(50):
        driven.active_parameters()
    assert bus.syncs == before


def test_close_holds_disables_and_releases_token(driven, bus):
    bus.drives[3].counts = 3333
    driven.close()
    assert bus.token == 0
    assert {drive.mode for drive in bus.drives.values()} == {8}
    assert (bus.drives[3].target, bus.statuses) == (3333, {0x40})
    driven.close()
    assert not [t for t in threading.enumerate() if t.name == "sarcal-control"]


def test_close_reports_drive_that_stays_enabled(driven, bus):
    bus.drives[1].ignores = (0x0000,)
    for _ in range(2):
        assert not driven.close()
        assert driven.left_powered == (1,)
    assert [j for j, drive in bus.drives.items() if drive.status != 0x40] == [1]
    assert bus.token == 0
    bus.drives[1].ignores = ()
    driven.connect()
    driven.take_control()
    assert driven.close()
    assert driven.left_powered == ()


@pytest.mark.parametrize("fault", ["offline", "without_heartbeat", "without_tpdo"])
def test_close_with_silent_node_disables_other_drives(driven, bus, fault):
    """They would otherwise stop only after missing this program's heartbeat."""
    setattr(bus, fault, {3})
    with pytest.raises(BusError, match=r"has gone silent: no .* from node 3"):
        capture_for_ever(driven)
    assert not driven.close(), "the state of the silent drive is unknown"
    others = [drive.status for joint, drive in bus.drives.items() if joint != 3]
    assert others == [0x40] * (JOINTS - 1)
    assert bus.token == 0


@pytest.mark.parametrize("emergency", [False, True])
def test_free_joint_of_unknown_position_is_not_held(driven, bus, emergency):
    """Joint 3 was moved on by the others while its answers were lost: at the last position known it would jump back."""
    start, axis = bus.syncs, bus.drives[3]

    def lose_answers(sync: int) -> None:
        bus.without_tpdo = {3}
        axis.counts += 100 * (sync < start + 20)
        if emergency and sync == start + 5:
            bus.emergency(6, 0x8311)

    bus.on_sync = lose_answers
    with pytest.raises(DriveFault if emergency else BusError):
        driven.move({2: 0.2}, speed_rad_per_s=0.5)
    assert not driven.close()
    assert (axis.counts, axis.status) == (3000 + 19 * 100, 0x40)


def test_close_holds_free_joint_that_misses_one_sync(driven, bus):
    start, axis = bus.syncs, bus.drives[3]

    def lose_one(sync: int) -> None:
        bus.without_tpdo = {3} if sync == start + 1 else set()
        axis.counts += 333 * (sync == start + 1)

    bus.on_sync = lose_one
    assert driven.close()
    assert (0x0F, 3333, 8) in axis.received
    assert axis.counts == 3333


@pytest.mark.parametrize(
    ("ignored", "silent", "statuses_1_and_4", "left_powered"),
    [
        ((), set(), (0x07, 0x07), (1, 2, 3, 4, 5, 6, 7)),
        ((0x0002,), set(), (0x40, 0x07), (2, 3, 4, 5, 6, 7)),
        # The state of a silent drive is unknown.
        ((0x0002,), {4}, (0x40, 0x40), None),
        ((0x0002, 0x0000), set(), (0x27, 0x07), None),
    ],
)
def test_close_after_stop_switches_off_drives_not_known_to_have_stopped(
    driven, bus, ignored, silent, statuses_1_and_4, left_powered
):
    bus.drives[1].ignores = ignored
    driven.stop()
    bus.without_tpdo = silent
    assert driven.close() is (left_powered is not None)
    assert (bus.drives[1].status, bus.drives[4].status) == statuses_1_and_4
    assert {bus.drives[joint].status for joint in (2, 3, 5, 6, 7)} == {0x07}
    if not silent:
        assert driven.left_powered == (left_powered or (1, 2, 3, 4, 5, 6, 7))
    assert bus.token == 0


@pytest.mark.parametrize(("node", "code"), [(16, 0x5441), (16, 0x1000), (2, 0x8612)])
def test_close_disables_drives_despite_reported_emergency(driven, bus, node, code):
    """A supervisor's emergency counts as a stop, but stops no drive."""
    bus.emergency(node, code)
    wait_for(lambda: bool(driven.snapshot().faults))
    assert driven.close()
    assert (driven.left_powered, bus.statuses) == ((), {0x40})


def test_close_before_first_command_releases_arm(arm, bus):
    """A drive faults between the grant of the token and the first command."""
    bus.trip(3, 0x8311)
    wait_for(lambda: bool(arm.snapshot().faults))
    with pytest.raises(DriveFault):
        arm.take_control()
    assert arm.close()
    assert (arm.left_powered, bus.token) == ((), 0)


def test_stop_while_closing_latches(driven, bus):
    bus.at(2, driven.stop)
    driven.close()
    assert (bus.statuses, bus.token) == ({0x07}, 0)
    driven.connect()
    assert driven.snapshot().stopped


def test_stop_reaches_drives_until_bus_is_closed(driven, bus):
    before: list[int] = []

    def stop() -> None:
        before.append(len(bus.sent))
        driven.stop()

    bus.on_closing = stop
    driven.close()
    assert len(bus.sent) == before[0] + JOINTS
    assert [bus.controlwords(j, before[0]) for j in bus.drives] == [[0x0002]] * JOINTS


def test_concurrent_close_waits_for_first_close(driven, bus):
    other = threading.Thread(target=driven.close)
    waited: list[bool] = []

    def close_again() -> None:
        driven.close()  # as a signal handler of this thread would
        other.start()
        other.join(0.05)
        waited.append(other.is_alive())

    bus.on_closing = close_again
    driven.close()
    other.join(60.0)
    assert waited == [True], "closed once, while the other thread waited"
    with pytest.raises(BusError, match="not connected"):
        driven.snapshot()


@pytest.mark.parametrize(("status", "held"), [(0x27, False), (0x07, True)])
def test_close_reports_drive_enabled_by_another_program(arm, bus, status, held):
    bus.drives[3].status = status
    arm.capture(1)
    assert arm.close() is held
    assert (arm.left_powered, bus.drives[3].status) == ((3,), status)
