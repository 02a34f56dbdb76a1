"""An arm that somebody works with who is not heard just now is not reset under his hands."""

import struct
from collections.abc import Callable
from typing import TypeVar

import pytest

from hardware.control.canopen_arm import CanopenArm
from hardware.errors import ArmInUse, CommandRefused, ControlDenied, NodeMissing, OtherMaster
from hardware.monitors.joint_monitor import JointMonitor, alarms
from hardware.monitors.node_monitor import NodeMonitor
from hardware.timing import Pace
from tests.hardware.fake_arm import FakeArmBus
from tests.hardware.on_fake_bus import capture_for_ever, hasty, make
from tests.oracles.profiles import sarcos

ENABLED, QUICK_STOP, TRIPPED = 0x27, 0x07, 0x08
SDO_TIMEOUT_S = 0.5
E = TypeVar("E", bound=BaseException)
STATUSWORD, TOKEN = b"\x41\x60\x00", b"\x10\x20\x00"


class Asked(FakeArmBus):
    """Something happens as an object is read for the n-th time."""

    def __init__(self) -> None:
        super().__init__()
        self.reads: list[bytes] = []
        self.on_read: Callable[[list[bytes]], None] = lambda _reads: None
        self.lost: dict[tuple[int, bytes], int] = {}

    def _handle(self, identifier: int, data: bytes) -> None:
        if 0x600 < identifier < 0x680 and data[0] == 0x40:
            self.reads.append(data[1:4])
            self.on_read(self.reads)
            asked = identifier - 0x600, data[1:4]
            if asked in self.lost:
                self.lost[asked] -= 1
                if self.lost[asked] == 0:
                    return  # nobody heard the answer
        super()._handle(identifier, data)

    @property
    def resets(self) -> int:
        return sum(frame[0] == 0x000 for frame in self.sent)


@pytest.fixture
def bus():
    return Asked()


def real(bus: FakeArmBus) -> CanopenArm:
    timing = hasty(speed=10.0, operator_timeout_s=0.2, sdo_timeout_s=SDO_TIMEOUT_S)
    return make(bus, pace=Pace.REAL_TIME, timing=timing)


@pytest.fixture
def arm(bus):
    made = real(bus)
    yield made
    made.close()


def refused(bus: Asked, error: type[E], match: str | None = None) -> E:
    """With what a connection ends that has reset nothing."""
    with pytest.raises(error, match=match) as told:
        real(bus).connect()
    assert bus.resets == 0
    return told.value


def after(bus: Asked, looks: int, what: bytes, happens: Callable[[], None]) -> None:
    """Let something happen once an object was looked at more often than so."""
    bus.on_read = lambda reads: happens() if reads.count(what) > looks else None


@pytest.mark.parametrize("state", [ENABLED, QUICK_STOP])
def test_late_operator_heartbeat_prevents_reset(bus, state):
    bus.drives[2].status = state
    after(bus, 7, STATUSWORD, lambda: setattr(bus, "other_operator", True))
    assert refused(bus, ControlDenied).holder == 127


def test_late_command_of_other_master_prevents_reset(bus):
    bus.drives[2].status = ENABLED
    after(bus, 7, STATUSWORD, lambda: setattr(bus, "other_master", ((0x202, bytes(7)),)))
    refused(bus, OtherMaster, r"Another program .* a command to joint 2 \(COB-ID 202h\)")


def test_drives_tripped_after_operator_loss_accept_connection(arm, bus):
    for drive in bus.drives.values():
        drive.status = ENABLED
    bus.token = 127

    def miss_the_operator() -> None:
        bus.token = 0
        for drive in bus.drives.values():
            drive.status = TRIPPED

    after(bus, 3 * 7, STATUSWORD, miss_the_operator)
    arm.connect()
    assert bus.reads.count(TOKEN) > 3


def test_enabled_drives_raise_arm_in_use_with_remedy(bus):
    bus.drives[2].status, bus.drives[5].status = ENABLED, QUICK_STOP
    said = str(refused(bus, ArmInUse))
    assert (
        "joint 2 (node 2) is in state operation enabled, joint 5 (node 5) is in state quick stop active"
        in said
    )
    for way in ("sarcal monitor", "sarcal reset", "Nothing was reset"):
        assert way in said


def test_listening_time_covers_drive_heartbeat_timeout(bus):
    for sub, value in ((0, b"\x01"), (1, struct.pack("<L", 127 << 16 | 400))):
        bus.objects[2, 0x1016, sub] = value
    bus.drives[2].status = ENABLED
    assert refused(bus, ArmInUse).listened_s == pytest.approx(0.6)


def test_take_over_resets_enabled_drives(arm, bus):
    bus.drives[2].status = ENABLED
    arm.take_over()
    arm.connect()
    assert bus.resets > 0


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
    # Another program does not know whose they are: it listens, and goes on, as nobody is at work.
    again = real(bus)
    again.connect()
    assert bus.reads.count(STATUSWORD) == before + 7 * (1 + 10)
    again.close()


def test_drives_enabled_by_another_program_are_in_use(arm, bus):
    arm.connect()
    bus.drives[2].status = ENABLED
    bus.say(0x202, bytes.fromhex("0f000500000008"))
    with pytest.raises(OtherMaster, match="Another program commands this arm"):
        capture_for_ever(arm)
    arm.close()
    resets = bus.resets
    with pytest.raises(ArmInUse):
        arm.connect()
    assert bus.resets == resets


def test_take_over_applies_to_one_connection_only(arm, bus):
    arm.take_over()
    bus.dead = {3}
    with pytest.raises(NodeMissing):
        arm.connect()
    bus.dead, resets = set(), bus.resets
    bus.drives[2].status = ENABLED  # by whomever, meanwhile
    with pytest.raises(ArmInUse):
        arm.connect()
    assert bus.resets == resets


def test_stopped_drives_with_token_held_are_in_use(bus):
    bus.drives[5].status, bus.token = QUICK_STOP, 127
    refused(bus, ArmInUse, r"joint 5 \(node 5\) is in state quick stop active")


@pytest.mark.parametrize("look", [1, 3])
def test_lost_statusword_response_keeps_last_state(bus, look):
    bus.drives[2].status = ENABLED
    bus.lost[2, STATUSWORD] = look
    refused(bus, ArmInUse, r"joint 2 \(node 2\) is in state operation enabled")
    assert bus.lost[2, STATUSWORD] <= 0


@pytest.mark.parametrize("look", [1, 3])
def test_lost_token_response_keeps_holder(bus, look):
    bus.token = 99
    bus.lost[16, TOKEN] = look
    after(bus, 5, TOKEN, lambda: setattr(bus, "other_master", ((0x700 + 99, b"\x05"),)))
    assert refused(bus, ControlDenied).holder == 99


def test_listening_time_covers_supervisor_heartbeat_timeout(arm, bus):
    """Its holder was killed: this program's heartbeat has the same node, and must not keep his token alive."""
    for sub, value in ((0, b"\x01"), (1, struct.pack("<L", 127 << 16 | 400))):
        bus.objects[16, 0x1016, sub] = value
    bus.token = 127
    # Of 30 looks; of drives that do not say there are 10.
    after(bus, 20, TOKEN, lambda: setattr(bus, "token", 0))
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


def test_command_during_state_check_raises_other_master(bus):
    bus.on_read = lambda reads: bus.say(0x202, bytes(7)) if len(reads) == 1 else None
    refused(bus, OtherMaster, r"Another program .* a command to joint 2 \(COB-ID 202h\)")


def test_token_with_live_holder_denies_control(bus):
    bus.token = 99
    bus.other_master = ((0x700 + 99, b"\x05"),)
    assert refused(bus, ControlDenied).holder == 99


def test_disabled_arm_is_read_once_before_reset(arm, bus):
    arm.connect()
    before = [data[1:4] for identifier, data in bus.sent[: 7 + 1] if 0x600 < identifier < 0x680]
    assert sorted(before) == sorted([STATUSWORD] * 7 + [TOKEN])


def test_other_master_alarm_precedes_stopped_node_alarm():
    nodes = NodeMonitor(sarcos())
    nodes.note(0x703, b"\x05", 0.0, 0)
    nodes.note_command(0x000, b"\x80\x00")
    nodes.note(0x703, b"\x7f", 0.1, 1)
    (found, *_) = alarms(
        nodes, JointMonitor(), stop_latched=False, now_s=0.1, heartbeat_timeout_s=1.0
    )
    assert isinstance(found, OtherMaster)
    assert "the NMT command 'enter pre-operational' to all nodes (COB-ID 000h)" in str(found)
