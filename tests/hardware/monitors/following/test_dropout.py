import pytest

from hardware.arm import DriveState, JointMode
from hardware.canopen.cyclic import Setpoint
from hardware.monitors.following import (
    CONFIRMED_SYNCS,
    NOT_FOLLOWING_SYNCS,
    Dropout,
    DropoutMonitor,
)
from tests.oracles.samples import sample

FOLLOWS, NOT_FOLLOWING, LIMITED, FOLLOWING_ERROR = 0x1627, 0x0627, 0x0E27, 0x3627
SWITCHED_ON, READY, OFF, STOPPED, FAULT = 0x1623, 0x1621, 0x1640, 0x1607, 0x1608
CSP, CST = JointMode.POSITION, JointMode.FREE
ENABLE, SWITCH_ON, QUICK_STOP, DISABLE = 0x0F, 0x07, 0x02, 0x00
TARGET = Setpoint(ENABLE, 5, CSP)


def update(
    monitor: DropoutMonitor,
    *statuswords: int,
    times: int = 1,
    word: int = ENABLE,
    mode: JointMode = CSP,
    missing: tuple[int, ...] = (),
    stopped: bool = False,
) -> list[int]:
    """Pass the same sample and commands several times; return the joints of the dropouts."""
    commands = (Setpoint(word, 0, mode),) * len(statuswords)
    for _ in range(times):
        monitor.update(sample(statuswords, sync=77, missing=missing), commands, stopped=stopped)
    return [dropout.joint for dropout in monitor.dropouts]


@pytest.fixture
def monitor():
    """A monitor of three drives, enabled and confirmed."""
    monitor = DropoutMonitor()
    assert update(monitor, FOLLOWS, FOLLOWS, FOLLOWS, times=CONFIRMED_SYNCS) == []
    return monitor


@pytest.mark.parametrize(
    ("status", "state", "word"),
    [
        (SWITCHED_ON, DriveState.SWITCHED_ON, DISABLE),
        (READY, DriveState.READY_TO_SWITCH_ON, DISABLE),
        (OFF, DriveState.SWITCH_ON_DISABLED, DISABLE),
        (FAULT, DriveState.FAULT, DISABLE),
        (STOPPED, DriveState.QUICK_STOP_ACTIVE, QUICK_STOP),
    ],
)
@pytest.mark.parametrize("mode", [CSP, CST])
def test_dropout_is_reported_at_once_and_stops_all_drives(monitor, status, state, word, mode):
    update(monitor, FOLLOWS, status, FOLLOWS, mode=mode)
    assert monitor.dropouts == (Dropout(joint=2, status=status, sync_count=77),)
    assert monitor.dropouts[0].state is state
    words = [monitor.command(j, Setpoint(ENABLE, 5, mode)).controlword for j in (1, 2, 3)]
    assert words == [QUICK_STOP, word, QUICK_STOP]


@pytest.mark.parametrize("later", [(FOLLOWS, FOLLOWS, FOLLOWS), (STOPPED, OFF, STOPPED)])
def test_dropout_stays_the_only_one_until_reset(monitor, later):
    update(monitor, FOLLOWS, SWITCHED_ON, FOLLOWS)
    assert update(monitor, *later, times=100) == [2]
    assert monitor.command(2, TARGET) == Setpoint(DISABLE, 5, CSP)
    monitor.reset()
    assert (monitor.dropouts, monitor.command(2, TARGET)) == ((), TARGET)


def test_dropouts_are_sorted_by_likely_cause(monitor):
    assert update(monitor, STOPPED, SWITCHED_ON, FAULT) == [3, 2, 1]


@pytest.mark.parametrize("word", [SWITCH_ON, QUICK_STOP, DISABLE])
def test_commanded_state_change_is_no_dropout(monitor, word):
    assert update(monitor, OFF, STOPPED, READY, word=word) == []
    assert update(monitor, FOLLOWS, OFF, FOLLOWS) == []  # on the way to enabled
    assert update(monitor, FOLLOWS, FOLLOWS, FOLLOWS, times=CONFIRMED_SYNCS) == []
    assert update(monitor, FOLLOWS, OFF, FOLLOWS) == [2]
    assert monitor.command(2, Setpoint(word, 5, CSP)).controlword == word


@pytest.mark.parametrize(
    ("status", "options"),
    [
        (STOPPED, {"stopped": True, "times": 100}),
        (OFF, {"missing": (2,)}),
        (LIMITED | 0x1000, {"times": 4 * NOT_FOLLOWING_SYNCS}),
        (NOT_FOLLOWING, {"mode": CST, "times": 4 * NOT_FOLLOWING_SYNCS}),
        (FOLLOWING_ERROR, {"mode": CST, "times": 4 * NOT_FOLLOWING_SYNCS}),
    ],
    ids=["stop", "missing answer", "internal limit", "free mode", "bit 13 in free mode"],
)
def test_status_with_another_reason_is_no_dropout(monitor, status, options):
    assert update(monitor, FOLLOWS, status, FOLLOWS, **options) == []


def test_drive_with_suspected_dropout_gets_no_command_that_enables():
    """A single answer from before the drive was enabled may still arrive."""
    monitor = DropoutMonitor()
    update(monitor, FOLLOWS)
    update(monitor, SWITCHED_ON)
    assert update(monitor, SWITCHED_ON, missing=(1,)) == []
    assert monitor.command(1, TARGET) is None
    assert monitor.command(1, Setpoint(DISABLE, 5, CSP)) == Setpoint(DISABLE, 5, CSP)
    assert update(monitor, FOLLOWS) == []
    assert monitor.command(1, TARGET) == TARGET


@pytest.mark.parametrize("enabled_syncs", range(1, CONFIRMED_SYNCS))
def test_dropout_of_a_drive_just_enabled_needs_two_answers(enabled_syncs):
    monitor = DropoutMonitor()
    update(monitor, FOLLOWS, FOLLOWS, times=enabled_syncs)
    assert update(monitor, FOLLOWS, SWITCHED_ON, times=2) == [2]
    commands = [monitor.command(j, TARGET) for j in (1, 2)]
    assert commands == [Setpoint(QUICK_STOP, 5, CSP), Setpoint(DISABLE, 5, CSP)]


def test_drive_with_alternating_status_is_a_dropout_once_confirmed():
    monitor = DropoutMonitor()
    for _ in range(CONFIRMED_SYNCS):
        assert update(monitor, FOLLOWS) == []
        update(monitor, SWITCHED_ON)
    assert [dropout.joint for dropout in monitor.dropouts] == [1]


@pytest.mark.parametrize("status", [NOT_FOLLOWING, LIMITED, FOLLOWING_ERROR])
def test_drive_that_stops_following_is_a_dropout(monitor, status):
    answers = (FOLLOWS, status, FOLLOWS)
    assert update(monitor, *answers, times=NOT_FOLLOWING_SYNCS - 1) == []
    update(monitor, *answers)
    (dropout,) = monitor.dropouts
    assert (dropout.joint, dropout.not_following) == (2, True)
    assert monitor.command(2, TARGET).controlword == QUICK_STOP


def test_bit_12_is_not_checked_before_it_was_set_in_position_mode():
    monitor = DropoutMonitor()
    update(monitor, FOLLOWS, mode=CST, times=100)
    update(monitor, FOLLOWS, times=2)  # still of free mode
    assert update(monitor, NOT_FOLLOWING, times=4 * NOT_FOLLOWING_SYNCS) == []
