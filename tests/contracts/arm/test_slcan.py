import os
from contextlib import closing

import pytest

from hardware.arm import DriveState
from hardware.buses.python_can import BusSettings, open_bus
from tests.contracts.arm.conftest import controller_on, operator_on
from tests.hardware.control.canopen_arm.conftest import drive, wait_for
from tests.oracles.slcan_adapter import slcan_adapter


def test_arm_moves_and_stops_over_slcan():
    inside = BusSettings(interface="loopback", channel=f"slcan-{os.getpid()}")
    with open_bus(inside) as bus, controller_on(inside), slcan_adapter(bus) as (port, commands):
        line = BusSettings(
            interface="slcan", channel=port, bitrate=1_000_000, options={"sleep_after_open": 0.0}
        )
        with closing(operator_on(line, answers_s=2.0)) as arm:
            arm.connect()
            drive(arm)
            start = arm.snapshot().positions_rad
            assert arm.move({2: start[1] + 0.05}, speed_rad_per_s=0.5).reached
            assert arm.capture(10).mean_rad[1] == pytest.approx(start[1] + 0.05, abs=5e-3)
            arm.stop()
            wait_for(lambda: arm.snapshot().joints[1].drive is DriveState.QUICK_STOP_ACTIVE)
            arm.reset_stop()
            arm.take_control()
            # The line was not closed in between: STOP went over the only handle.
            assert commands.count("O") <= 2
            assert commands[-1] == "O"
        assert "S8" in commands
