import pytest

from hardware.arm import DriveState
from hardware.canopen.cyclic import Setpoint
from hardware.monitors.dropout import CONFIRMED_SYNCS, NOT_FOLLOWING_SYNCS, Dropout, DropoutMonitor
from tests.oracles.samples import sample

FOLLOWS, DEAF, LIMITED = 0x1627, 0x0627, 0x0E27
SWITCHED_ON, READY, OFF, STOPPED, FAULT = 0x1623, 0x1621, 0x1640, 0x1607, 0x1608
CSP, CST = 8, 10
ENABLE, SWITCH_ON, QUICK_STOP, DISABLE = 0x0F, 0x07, 0x02, 0x00


def see(
    staying: DropoutMonitor,
    *statuswords: int,
    times: int = 1,
    word: int = ENABLE,
    mode: int = CSP,
    missing: tuple[int, ...] = (),
    stopped: bool = False,
) -> None:
    """Let drives say this, some times, while they are told to be enabled."""
    told = (Setpoint(word, 0, mode),) * len(statuswords)
    for _ in range(times):
        staying.update(sample(statuswords, sync=77, missing=missing), told, stopped=stopped)


@pytest.fixture
def staying():
    """Three drives that have been enabled for a while."""
    made = DropoutMonitor()
    see(made, FOLLOWS, FOLLOWS, FOLLOWS, times=CONFIRMED_SYNCS)
    assert made.dropouts == ()
    return made


@pytest.mark.parametrize(
    ("status", "state", "kept_by"),
    [
        (SWITCHED_ON, DriveState.SWITCHED_ON, DISABLE),
        (READY, DriveState.READY_TO_SWITCH_ON, DISABLE),
        (OFF, DriveState.SWITCH_ON_DISABLED, DISABLE),
        (FAULT, DriveState.FAULT, DISABLE),
        (STOPPED, DriveState.QUICK_STOP_ACTIVE, QUICK_STOP),
    ],
)
@pytest.mark.parametrize("mode", [CSP, CST])
def test_a_drive_that_is_enabled_no_more_is_named_at_once_and_all_are_stopped(
    staying, status, state, kept_by, mode
):
    see(staying, FOLLOWS, status, FOLLOWS, mode=mode)
    assert staying.dropouts == (Dropout(joint=2, state=state, sync_count=77),)
    words = [staying.command(j, Setpoint(ENABLE, 5, mode)).controlword for j in (1, 2, 3)]
    assert words == [QUICK_STOP, kept_by, QUICK_STOP]


def test_one_that_comes_back_by_itself_has_left_all_the_same_until_it_is_reset(staying):
    see(staying, FOLLOWS, SWITCHED_ON, FOLLOWS)
    see(staying, FOLLOWS, FOLLOWS, FOLLOWS, times=100)
    assert [left.joint for left in staying.dropouts] == [2]
    assert staying.command(2, Setpoint(ENABLE, 5, CSP)) == Setpoint(DISABLE, 5, CSP)
    staying.reset()
    assert staying.dropouts == ()
    assert staying.command(2, Setpoint(ENABLE, 5, CSP)) == Setpoint(ENABLE, 5, CSP)


def test_those_that_are_stopped_for_it_have_not_left(staying):
    see(staying, FOLLOWS, SWITCHED_ON, FOLLOWS)
    see(staying, STOPPED, OFF, STOPPED, times=100)
    assert [left.joint for left in staying.dropouts] == [2]


def test_of_several_the_one_is_named_first_that_may_be_why(staying):
    see(staying, STOPPED, SWITCHED_ON, FAULT)
    assert [left.joint for left in staying.dropouts] == [3, 2, 1]


@pytest.mark.parametrize("word", [SWITCH_ON, QUICK_STOP, DISABLE])
def test_what_was_told_from_here_is_no_leaving_and_is_sent_as_it_is(staying, word):
    see(staying, OFF, STOPPED, READY, word=word)
    assert staying.dropouts == ()
    see(staying, FOLLOWS, OFF, FOLLOWS)  # enabled again, seen on the way
    assert staying.dropouts == ()
    see(staying, FOLLOWS, FOLLOWS, FOLLOWS, times=CONFIRMED_SYNCS)
    see(staying, FOLLOWS, OFF, FOLLOWS)
    assert [left.joint for left in staying.dropouts] == [2]
    assert staying.command(2, Setpoint(word, 5, CSP)).controlword == word


def test_a_stop_is_no_leaving(staying):
    see(staying, STOPPED, STOPPED, STOPPED, stopped=True, times=100)
    assert staying.dropouts == ()
    staying.update(sample((OFF,) * 3), None, stopped=False)
    assert staying.dropouts == ()


def test_one_that_does_not_answer_has_said_nothing(staying):
    see(staying, FOLLOWS, OFF, FOLLOWS, missing=(2,))
    assert staying.dropouts == ()


def test_an_answer_from_before_it_was_enabled_may_still_come():
    """A drive that is switched off, for all that is known, is told nothing before it has answered once more."""
    staying, told = DropoutMonitor(), Setpoint(ENABLE, 5, CSP)
    see(staying, FOLLOWS)
    see(staying, SWITCHED_ON)
    see(staying, SWITCHED_ON, missing=(1,))
    assert (staying.dropouts, staying.command(1, told)) == ((), None)
    assert staying.command(1, Setpoint(DISABLE, 5, CSP)) == Setpoint(DISABLE, 5, CSP)
    see(staying, FOLLOWS)
    assert (staying.dropouts, staying.command(1, told)) == ((), told)


@pytest.mark.parametrize("seen", range(1, CONFIRMED_SYNCS))
def test_one_that_was_enabled_just_now_has_left_when_it_says_so_twice(seen):
    staying = DropoutMonitor()
    see(staying, FOLLOWS, FOLLOWS, times=seen)
    see(staying, FOLLOWS, SWITCHED_ON, times=2)
    assert [left.joint for left in staying.dropouts] == [2]
    words = [staying.command(j, Setpoint(ENABLE, 5, CSP)) for j in (1, 2)]
    assert words == [Setpoint(QUICK_STOP, 5, CSP), Setpoint(DISABLE, 5, CSP)]


def test_one_that_was_never_enabled_has_not_left():
    staying = DropoutMonitor()
    see(staying, SWITCHED_ON, times=100)
    assert staying.dropouts == ()
    assert staying.command(1, Setpoint(ENABLE, 5, CSP)) == Setpoint(ENABLE, 5, CSP)


def test_one_that_flickers_from_the_beginning_is_named_as_well():
    staying = DropoutMonitor()
    for _ in range(CONFIRMED_SYNCS):
        assert staying.dropouts == ()
        see(staying, FOLLOWS)
        see(staying, SWITCHED_ON)
    assert [left.joint for left in staying.dropouts] == [1]


def test_a_drive_that_follows_no_more_is_named_and_all_hold(staying):
    see(staying, FOLLOWS, DEAF, FOLLOWS, times=NOT_FOLLOWING_SYNCS - 1)
    assert staying.dropouts == ()
    see(staying, FOLLOWS, DEAF, FOLLOWS)
    (left,) = staying.dropouts
    assert (left.joint, left.not_following) == (2, True)
    assert staying.command(2, Setpoint(ENABLE, 5, CSP)).controlword == QUICK_STOP


@pytest.mark.parametrize(("status", "mode"), [(LIMITED, CSP), (DEAF, CST)])
def test_a_limit_and_another_mode_are_reasons_not_to(staying, status, mode):
    see(staying, FOLLOWS, status, FOLLOWS, mode=mode, times=4 * NOT_FOLLOWING_SYNCS)
    assert staying.dropouts == ()


def test_as_it_changes_modes_it_may_say_either_and_one_that_never_says_is_not_watched():
    staying = DropoutMonitor()
    see(staying, FOLLOWS, mode=CST, times=100)
    see(staying, FOLLOWS, times=2)  # of the torque still
    see(staying, DEAF, times=4 * NOT_FOLLOWING_SYNCS)
    assert staying.dropouts == ()
