"""Records sensor faults in the journal and excludes the poses that they may have affected. Moves nothing."""

from collections.abc import Iterator
from contextlib import contextmanager
from itertools import takewhile

import numpy as np

from hardware.arm import ArmInterface, Fault, Reading
from hardware.canopen.objects import EmergencyCode
from hardware.errors import DriveDiverged, DriveFault, SensorFault
from operator_app.calibration.failure_analysis import turned_unread
from operator_app.errors import GuardError
from operator_app.session.store.logbook import Logbook
from operator_app.session.store.state import SessionState
from operator_app.units import WHOLE_DEGREES
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import nominal_vector
from solver.chain.sensors import NoSensor, Rvdt

TURNED_RAD = float(np.deg2rad(2.0))
"""Smallest turn, computed from the other joints, at which a constant reading means a stuck sensor."""


def require_no_sensor_fault(state: SessionState, refusal: str) -> None:
    """Raise GuardError if no repeat of the first pose has agreed since a sensor fault; `refusal` begins its text."""
    if state.sensor_jump:
        raise GuardError(
            f"{refusal}: {state.sensor_jump}",
            "use the automatic capture, which measures the first pose again and goes on if it is unchanged; "
            "otherwise start a new session",
        )


class SensorFaults:
    """Records the sensor faults of a session's arm and excludes the affected poses.

    `read_until`: number of the SYNC at the end of the last capture; -1 before the first capture. A fault that began at
    or before this SYNC affects the pose captured last.
    """

    def __init__(self, logbook: Logbook, arm: ArmInterface) -> None:
        self._logbook, self._arm = logbook, arm
        self._recorded: tuple[str, int | None] = ("", None)
        self._failed: list[Fault] = []
        self.read_until = -1

    @contextmanager
    def recorded(self) -> Iterator[None]:
        """Context that records a sensor fault raised in it, excludes the affected poses, and re-raises the fault."""
        try:
            yield
        except SensorFault as fault:
            # A fault that persists is raised again by every call: record it once.
            if fault.since_sync is None or (str(fault), fault.since_sync) != self._recorded:
                self._recorded = str(fault), fault.since_sync
                self._record(fault.joint, str(fault))
                self._exclude(self._affected_poses(fault), fault.joint)
            raise
        except DriveFault as fault:
            if fault.code == EmergencyCode.FOLLOWING:
                self._exclude(self._poses_with_present_reading(fault.joint), fault.joint)
            raise

    def record_stop_cause(self) -> None:
        """Record the sensors that have failed; if the arm has stopped by itself, record and raise the cause."""
        snapshot = self._arm.snapshot()
        for fault in snapshot.faults:
            sensor_failed = fault.code == EmergencyCode.SENSOR and fault not in self._failed
            if sensor_failed and fault.joint is not None:
                self._failed.append(fault)
                self._record(fault.joint, f"joint {fault.joint}: {fault.text}")
        if snapshot.stopped_for:
            with self.recorded():
                self._arm.capture(1)

    def require_no_stuck_sensor(self, reading: Reading) -> None:
        """Record and raise SensorFault if a joint has turned, according to the loop, but reads as at the last pose."""
        state, arm, fixture = self._logbook.state, self._logbook.model, self._logbook.fixture
        if not state.poses_here or not fixture.holds_hand:
            # On an open arm every joint is driven, and its drive detects a stuck sensor.
            return
        last = state.poses_here[-1]
        turned_rad = reading.mean_rad - last.mean_rad
        still = [
            j for j in range(1, arm.joint_count + 1) if _stands_still(arm, j, turned_rad, reading)
        ]
        if not still or np.abs(turned_rad).max() < TURNED_RAD:
            return
        model = fixture.model(arm)
        x = nominal_vector(model.parameters)
        turned = turned_unread(model, x, last.mean_rad, reading.mean_rad, still)
        if turned is not None and abs(turned[1]) > TURNED_RAD:
            joint, turn = turned
            with self.recorded():
                raise SensorFault(
                    joint,
                    f"reads the same count as at pose {last.number}, but according to the other joints it has turned "
                    f"by about {WHOLE_DEGREES(abs(turn)).with_unit}: its sensor is stuck. Poses with this reading are "
                    f"excluded. Repair the sensor, or calibrate without it: --unsensed {joint}",
                    stuck=True,
                )

    def _record(self, joint: int, text: str) -> None:
        self._logbook.record("sensor_fault", {"joint": joint, "text": text})

    def _exclude(self, numbers: tuple[int, ...], joint: int) -> None:
        for number in numbers:
            self._logbook.exclude(number, f"joint {joint} read wrong at that time")

    def _affected_poses(self, fault: SensorFault) -> tuple[int, ...]:
        if fault.stuck:
            return self._poses_with_same_reading(fault.joint)
        if isinstance(fault, DriveDiverged) and (
            alike := self._poses_with_present_reading(fault.joint)
        ):
            return alike
        if fault.since_sync is None or fault.since_sync > self.read_until:
            return ()
        return tuple(pose.number for pose in self._logbook.state.poses[-1:])

    def _poses_with_present_reading(self, joint: int) -> tuple[int, ...]:
        """Return the numbers of the latest consecutive poses at which `joint` had the reading that it has now.

        Used if the drive of `joint` did not follow its command: the sensor may have been stuck at these poses.
        """
        poses = self._logbook.state.poses_here
        if not poses:
            return ()
        last_rad = poses[-1].mean_rad[joint - 1]
        now_rad = self._arm.snapshot().positions_rad[joint - 1]
        same = abs(now_rad - last_rad) <= _resolution_rad(self._logbook.model, joint)
        return self._poses_with_same_reading(joint) if same else ()

    def _poses_with_same_reading(self, joint: int) -> tuple[int, ...]:
        poses, near = self._logbook.state.poses_here, _resolution_rad(self._logbook.model, joint)
        alike = takewhile(
            lambda pose: abs(pose.mean_rad[joint - 1] - poses[-1].mean_rad[joint - 1]) <= near,
            reversed(poses),
        )
        return tuple(pose.number for pose in alike)


def _stands_still(arm: ArmModel, joint: int, turned_rad: FloatArray, reading: Reading) -> bool:
    sensor = arm.joints[joint - 1].sensor
    if isinstance(sensor, NoSensor):
        return False
    if isinstance(sensor, Rvdt) and sensor.noise_lsb > 0.0:
        # A working converter has noise; a stuck one has a spread of zero.
        return bool(
            reading.sd_rad[joint - 1] == 0.0 and abs(turned_rad[joint - 1]) < sensor.resolution_rad
        )
    return bool(abs(turned_rad[joint - 1]) <= sensor.resolution_rad)


def _resolution_rad(arm: ArmModel, joint: int) -> float:
    return float(getattr(arm.joints[joint - 1].sensor, "resolution_rad", 0.0))
