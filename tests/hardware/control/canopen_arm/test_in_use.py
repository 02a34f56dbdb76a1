"""An arm in use by another program, which sends nothing just now, is not reset by connecting."""

from collections.abc import Callable
from contextlib import closing
from typing import Any

import pytest

from hardware.arm import DriveState
from hardware.control.canopen_arm import CanopenArm
from hardware.errors import ArmInUse, CommandRefused, ControlDenied, NodeMissing, OtherMaster
from hardware.timing import Pace
from tests.hardware.control.canopen_arm.conftest import make, short_timing
from tests.hardware.fake_arm import FakeArmBus, FrameLoss, capture_for_ever

ENABLED, QUICK_STOP, TRIPPED = 0x27, 0x07, 0x08
STATUSWORD, TOKEN = b"\x41\x60\x00", b"\x10\x20\x00"


class ReadingBus(FakeArmBus):
    """Calls `on_read` at every SDO read."""

    def __init__(self) -> None:
        super().__init__()
        self.reads: list[bytes] = []
        self.on_read: Callable[[list[bytes]], None] = lambda _reads: None
        self.on_send = self._note_read

    def _note_read(self, identifier: int, data: bytes) -> None:
        if 0x600 < identifier < 0x680 and data[0] == 0x40:
            self.reads.append(data[1:4])
            self.on_read(self.reads)

    @property
    def resets(self) -> int:
        return sum(frame[0] == 0x000 for frame in self.sent)

    def when_read_more_often(self, times: int, what: bytes, act: Callable[[], None]) -> None:
        self.on_read = lambda reads: act() if reads.count(what) > times else None


@pytest.fixture
def bus():
    return ReadingBus()


def real_time_arm(bus: FakeArmBus) -> CanopenArm:
    timing = short_timing(speed=10.0, operator_timeout_s=0.2, sdo_timeout_s=0.5)
    return make(bus, pace=Pace.REAL_TIME, timing=timing)


@pytest.fixture
def arm(bus):
    with closing(real_time_arm(bus)) as arm:
        yield arm


def refused(bus: ReadingBus, error: type[Exception], match: str | None = None) -> Any:
    """Return the error of a connection that resets nothing."""
    with pytest.raises(error, match=match) as refusal:
        real_time_arm(bus).connect()
    assert bus.resets == 0
    return refusal.value


@pytest.mark.parametrize("state", [ENABLED, QUICK_STOP])
def test_late_operator_heartbeat_prevents_reset(bus, state):
    bus.drives[2].status = state
    heartbeat = ((0x77F, b"\x05"),)
    bus.when_read_more_often(7, STATUSWORD, lambda: setattr(bus, "other_master", heartbeat))
    assert refused(bus, ControlDenied).holder == 127


@pytest.mark.parametrize("during_first_read", [False, True])
def test_command_of_other_master_prevents_reset(bus, during_first_read):
    if during_first_read:
        bus.on_read = lambda reads: bus.inject(0x202, bytes(7)) if len(reads) == 1 else None
    else:
        bus.drives[2].status = ENABLED
        frames = ((0x202, bytes(7)),)
        bus.when_read_more_often(7, STATUSWORD, lambda: setattr(bus, "other_master", frames))
    refused(bus, OtherMaster, r"Another program .* a command to joint 2 \(COB-ID 202h\)")


def test_drives_tripped_after_operator_loss_accept_connection(arm, bus):
    for drive in bus.drives.values():
        drive.status = ENABLED
    bus.token = 127

    def lose_operator() -> None:
        bus.token = 0
        for drive in bus.drives.values():
            drive.status = TRIPPED

    bus.when_read_more_often(3 * 7, STATUSWORD, lose_operator)
    arm.connect()
    assert bus.reads.count(TOKEN) > 3


def test_enabled_drives_raise_arm_in_use_with_remedy(bus):
    """After the longest heartbeat time-out of a drive."""
    bus.set_heartbeat_consumers(2, (127, 400))
    bus.drives[2].status, bus.drives[5].status = ENABLED, QUICK_STOP
    error = refused(bus, ArmInUse)
    assert error.listened_s == pytest.approx(0.6)
    for part in (
        "joint 2 (node 2) is in state 'operation enabled', joint 5 (node 5) is in state 'quick stop active'",
        "sarcal monitor",
        "sarcal reset",
        "Nothing was reset",
    ):
        assert part in str(error)


def test_own_stopped_drives_accept_reconnection(arm, bus):
    arm.connect()
    arm.take_control()
    arm.stop()
    arm.close()
    assert bus.drives[2].status == QUICK_STOP
    for _ in range(2):
        arm.connect()
        arm.close()
    before = bus.reads.count(STATUSWORD)
    # Another program cannot know whose they are: it listens, and connects as nobody is active.
    with closing(real_time_arm(bus)) as other:
        other.connect()
        assert bus.reads.count(STATUSWORD) == before + 7 * (1 + 10)


def test_drives_enabled_by_another_program_are_in_use(arm, bus):
    arm.connect()
    bus.drives[2].status = ENABLED
    bus.inject(0x202, bytes.fromhex("0f000500000008"))
    with pytest.raises(OtherMaster, match="Another program commands this arm"):
        capture_for_ever(arm)
    arm.close()
    resets = bus.resets
    with pytest.raises(ArmInUse):
        arm.connect()
    assert bus.resets == resets


def test_take_over_resets_enabled_drives_once(arm, bus):
    bus.drives[2].status = ENABLED
    arm.take_over()
    arm.connect()
    assert bus.resets > 0
    assert arm.found_powered == {2: DriveState.OPERATION_ENABLED}
    arm.close()
    arm.take_over()
    bus.offline = {3}
    with pytest.raises(NodeMissing):
        arm.connect()
    bus.offline, resets = set(), bus.resets
    bus.drives[2].status = ENABLED
    with pytest.raises(ArmInUse):
        arm.connect()
    assert bus.resets == resets


def test_stopped_drives_with_token_held_are_in_use(bus):
    bus.drives[5].status, bus.token = QUICK_STOP, 127
    refused(bus, ArmInUse, r"joint 5 \(node 5\) is in state 'quick stop active'")


@pytest.mark.parametrize("read", [1, 3])
def test_lost_statusword_response_keeps_last_state(bus, read):
    bus.drives[2].status = ENABLED
    bus.drops = FrameLoss(0x582, b"\x4b" + STATUSWORD, skip=read - 1)
    refused(bus, ArmInUse, r"joint 2 \(node 2\) is in state 'operation enabled'")
    assert bus.drops.lost == 1


@pytest.mark.parametrize("read", [1, 3])
def test_lost_token_response_keeps_holder(bus, read):
    bus.token = 99
    bus.drops = FrameLoss(0x590, b"\x43" + TOKEN, skip=read - 1)
    heartbeat = ((0x700 + 99, b"\x05"),)
    bus.when_read_more_often(5, TOKEN, lambda: setattr(bus, "other_master", heartbeat))
    assert refused(bus, ControlDenied).holder == 99


def test_listening_time_covers_supervisor_heartbeat_timeout(arm, bus):
    """The holder was killed; this program's heartbeat has the same node, and must not keep the token alive."""
    bus.set_heartbeat_consumers(16, (127, 400))
    bus.token = 127
    # 30 reads in 0.6 s; without 1016h there are 10.
    bus.when_read_more_often(20, TOKEN, lambda: setattr(bus, "token", 0))
    arm.connect()
    assert arm.snapshot().token == 0


def test_token_of_predecessor_grants_no_control(arm, bus):
    bus.token = 127
    arm.connect()
    assert arm.snapshot().token == 127
    with pytest.raises(CommandRefused, match="take control"):
        arm.upload_parameters(b"schema: x")
    since = len(bus.sent)
    assert arm.close()
    assert not [data for i, data in bus.sent[since:] if 0x200 < i < 0x280 or i == 0x610]


def test_disabled_arm_is_read_once_before_reset(arm, bus):
    arm.connect()
    before = [data[1:4] for identifier, data in bus.sent[: 7 + 1] if 0x600 < identifier < 0x680]
    assert sorted(before) == sorted([STATUSWORD] * 7 + [TOKEN])
