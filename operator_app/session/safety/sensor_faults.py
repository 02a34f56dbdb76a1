"""What a sensor did that it should not: kept in the journal, and poses that it may have read wrong do not count.

Which poses those are follows from the journal and from where the arm stands; nothing here moves it.
Knows no bus and no screen.
"""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager

import numpy as np

from hardware.arm import Arm, Reading
from hardware.canopen.objects import EmergencyCode
from hardware.errors import DriveDiverged, DriveFault, SensorFault
from operator_app.calibration.stuck_joint import turned_unread
from operator_app.config.procedure import Procedure
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import SessionState
from operator_app.units.figure import WHOLE_DEGREES
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import NoSensor, Rvdt

TURNED_RAD = float(np.deg2rad(2.0))
"""What a joint that stands still must have turned by, if the others are right."""


class SensorFaults:
    """The sensor faults of one arm, for as long as a session has it.

    Attributes
    ----------
    read_until
        SYNC up to which the last pose was read, -1 before there is one: what began before it spoils that pose.
    """

    def __init__(self, logbook: Logbook, arm: Arm) -> None:
        self._logbook, self._arm = logbook, arm
        self._kept: tuple[str, int | None] = ("", None)
        self.read_until = -1

    @contextmanager
    def kept(self) -> Iterator[None]:
        """Keep what a sensor does meanwhile, leave out the poses it read wrong, and raise it."""
        try:
            yield
        except SensorFault as fault:
            # Whoever asks again while it lasts is told the same.
            if fault.since_sync is None or (str(fault), fault.since_sync) != self._kept:
                self._kept = str(fault), fault.since_sync
                self._logbook.record("sensor_fault", {"joint": fault.joint, "text": str(fault)})
                self._leave_out(self._read_wrong(fault), fault.joint)
            raise
        except DriveFault as fault:
            if fault.code == EmergencyCode.FOLLOWING:
                self._leave_out(self._stood_still(fault.joint), fault.joint)
            raise

    def heed(self) -> None:
        """Keep, and raise, what the arm was stopped for by itself while nothing was asked of it."""
        if self._arm.snapshot().stopped_for:
            with self.kept():
                self._arm.capture(1)

    def require_moving(self, reading: Reading) -> None:
        """Refuse a reading in which a joint stands still, though the others say that it turned."""
        with self.kept():
            require_moving(self._logbook.state, self._logbook.procedure, reading)

    def _leave_out(self, numbers: tuple[int, ...], joint: int) -> None:
        for number in numbers:
            self._logbook.exclude(number, f"joint {joint} read wrong by then")

    def _read_wrong(self, fault: SensorFault) -> tuple[int, ...]:
        """Numbers of the poses that do not count for what a sensor did."""
        state = self._logbook.state
        if fault.stuck:
            return read_alike(state, self._logbook.model, fault.joint)
        if isinstance(fault, DriveDiverged) and (
            indistinguishable_placements := self._stood_still(fault.joint)
        ):
            return indistinguishable_placements
        if fault.since_sync is None or fault.since_sync > self.read_until:
            return ()
        return tuple(pose.number for pose in state.poses[-1:])

    def _stood_still(self, joint: int) -> tuple[int, ...]:
        """Numbers of the poses in which a joint that did not go where it was led reads what it reads now.

        Its sensor may have stood still before the last of them, and the joint gone on.
        """
        state, model = self._logbook.state, self._logbook.model
        if not state.poses_here:
            return ()
        last = state.poses_here[-1].mean_rad[joint - 1]
        here = self._arm.snapshot().positions_rad[joint - 1]
        indistinguishable_placements = abs(here - last) <= _resolution_rad(model, joint)
        return read_alike(state, model, joint) if indistinguishable_placements else ()


def require_moving(state: SessionState, procedure: Procedure, reading: Reading) -> None:
    """Refuse a reading in which a joint stands still to the count, though the others say that it turned.

    Raises
    ------
    SensorFault
    """
    if not state.poses_here or not procedure.fixture.fixture.holds_hand:
        # Where every joint is driven, its drive sees that it does not move.
        return
    last, arm = state.poses_here[-1], procedure.arm
    moved = reading.mean_rad - last.mean_rad
    still = [j for j in range(1, arm.joint_count + 1) if _stands_still(arm, j, moved, reading)]
    if not still or np.abs(moved).max() < TURNED_RAD:
        return
    model = procedure.fixture.fixture.model(arm)
    x: FloatArray = np.array([p.nominal for p in model.parameters])
    found = turned_unread(model, x, last.mean_rad, reading.mean_rad, still)
    if found is not None and abs(found[1]) > TURNED_RAD:
        joint, turn = found
        raise SensorFault(
            joint,
            f"reads as it did at pose {last.number}, to the count, but the others moved as if it had "
            f"turned by about {WHOLE_DEGREES(abs(turn)).with_unit}: its sensor is stuck. No pose counts that "
            f"reads so. Mend the sensor, or calibrate without it: --unsensed {joint}",
            stuck=True,
        )


def read_alike(state: SessionState, arm: ArmModel, joint: int) -> tuple[int, ...]:
    """Numbers of the poses just before, in which a joint reads to the count what it reads in the last one."""
    near = _resolution_rad(arm, joint)
    here = state.poses_here
    indistinguishable_placements = []
    for pose in reversed(here):
        if abs(pose.mean_rad[joint - 1] - here[-1].mean_rad[joint - 1]) > near:
            break
        indistinguishable_placements.append(pose.number)
    return tuple(indistinguishable_placements)


def _stands_still(arm: ArmModel, joint: int, moved: FloatArray, reading: Reading) -> bool:
    sensor = arm.joints[joint - 1].sensor
    if isinstance(sensor, NoSensor):
        return False
    if isinstance(sensor, Rvdt) and sensor.noise_lsb > 0.0:
        # A converter that is alive is never quite still.
        return bool(
            reading.sd_rad[joint - 1] == 0.0 and abs(moved[joint - 1]) < sensor.resolution_rad
        )
    return bool(abs(moved[joint - 1]) <= sensor.resolution_rad)


def _resolution_rad(arm: ArmModel, joint: int) -> float:
    return float(getattr(arm.joints[joint - 1].sensor, "resolution_rad", 0.0))
