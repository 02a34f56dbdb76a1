"""`sarcal reset`: remaining faults, once for the whole arm or by joint."""

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace

import pytest

from hardware.timing import Pace
from operator_app.commands import reset
from operator_app.commands.reset import report
from tests.hardware.control.canopen_arm.conftest import make, short_timing
from tests.hardware.fake_arm import FakeArmBus

STOP, TORQUE = "external stop, contact 1 (5441h)", "excess torque (8311h)"


@pytest.mark.parametrize(
    "remaining",
    [{}, dict.fromkeys(range(1, 8), STOP), {2: TORQUE, 5: TORQUE, 6: STOP}],
    ids=["nothing", "a stop contact that is still pressed", "some joints' own"],
)
def test_remaining_faults_are_reported_for_arm_or_joint(remaining, capsys, approve):
    report({}, remaining, arm_joints=7, in_json=False)
    approve("".join(capsys.readouterr()))


def test_drives_left_enabled_are_named_when_switched_off(monkeypatch, run_command, approve):
    """Another program died, and its drives have no heartbeat time-out."""
    bus = FakeArmBus()
    for joint in (2, 3):
        bus.drives[joint].status = 0x27
    reset_nodes = bus._nmt

    def nmt(command: int, number: int) -> None:
        reset_nodes(command, number)
        if command == 0x82 and number in bus.drives:
            bus.drives[number].status = 0x40

    bus._nmt = nmt
    arm = make(bus, pace=Pace.REAL_TIME, timing=short_timing(operator_timeout_s=0.1))

    @contextmanager
    def opened(*_: object, **__: object) -> Iterator[SimpleNamespace]:
        yield SimpleNamespace(arm=arm, simulated=False)
        arm.close()

    monkeypatch.setattr(reset, "open_arm", opened)
    approve(run_command(0, "reset", "-i", "loopback").words)
    assert bus.statuses == {0x40}
