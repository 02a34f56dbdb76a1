"""A planned session on the virtual plant without a bus: carries out what a `Campaign` proposes.

Drives the plant period by period as the controller would and keeps the record that the acceptance of
planning is about: limits met, trips, loops that close. The plant's truth is used for judging only.
"""

from __future__ import annotations

from dataclasses import dataclass, field

import numpy as np

from hardware.arm import JointMode
from hardware.virtual.axis import JointCommand, PlantReading
from hardware.virtual.plant import Plant
from hardware.virtual.scenarios import Scenario
from solver.chain.arm_model import ArmModel
from solver.design.actions import Capture, ChangeDrives, Finished, GoTo, path_watch
from solver.design.campaign import Campaign

PERIOD_S = 0.01
SPEED_RAD_PER_S = np.deg2rad(20.0)
SETTLE_PERIODS = 40
SAMPLES = 16
TRIP_SHARE = 0.8
"""The session stops a move at this share of the trip limits (speed, torque)."""


@dataclass
class Record:
    """What happened in one session."""

    periods: int = 0
    trips: list[str] = field(default_factory=list)
    stops: list[str] = field(default_factory=list)
    planned: int = 0
    explored: int = 0
    changes: int = 0
    worst_closure: float = 0.0
    least_room_rad: float = np.inf
    top_speed_rad_per_s: float = 0.0
    top_torque_nm: float = 0.0
    finished: Finished | None = None
    planned_true_rad: list[np.ndarray] = field(default_factory=list)


class PlantSession:
    """An arm on the plant, in the terms a session uses."""

    def __init__(self, scenario: Scenario, arm: ArmModel, drives: tuple[int, ...]) -> None:
        self.arm = scenario.arm(arm)
        self.plant: Plant = scenario.build(arm)
        self.truth = scenario.true_loop()
        self.record = Record()
        self._resolution = np.array([s.resolution_rad for s in self.plant.sensors.sensors])
        self._targets = self.truth_reading()
        self._drives = drives
        self.q = self._period()[0]
        self.set_drives(drives)

    def truth_reading(self) -> np.ndarray:
        return self.plant.true_angles_rad[1:] - self.truth.offsets_rad

    def set_drives(self, drives: tuple[int, ...]) -> None:
        """Position mode where the joints are measured to be, the rest free; let it settle."""
        self._drives = drives
        self._targets = self.q.copy()
        for _ in range(SETTLE_PERIODS):
            self._period()

    def move(self, targets: dict[int, float], watch) -> str:
        """Go straight and in step; the reason when it ended early, else nothing."""
        columns = [j - 1 for j in targets]
        start = self._targets[columns].copy()
        goal = np.array(list(targets.values()))
        longest = float(np.abs(goal - start).max())
        steps = max(1, int(np.ceil(longest / (SPEED_RAD_PER_S * PERIOD_S))))
        for k in range(1, steps + 1):
            self._targets[columns] = start + (goal - start) * (k / steps)
            q, reading = self._period()
            reason = watch(q) or self._near_a_trip(reading)
            if reason:
                self._targets[columns] = q[columns]
                for _ in range(SETTLE_PERIODS):
                    self._period()
                self.record.stops.append(reason)
                return str(reason)
        return ""

    def capture(self) -> np.ndarray:
        for _ in range(SETTLE_PERIODS):
            self._period()
        mean = np.mean([self._period()[0] for _ in range(SAMPLES)], axis=0)
        error = float(np.abs(self.plant.closure_error).max())
        self.record.worst_closure = max(self.record.worst_closure, error)
        return mean

    def _period(self) -> tuple[np.ndarray, PlantReading]:
        commands = [
            JointCommand(
                mode=JointMode.POSITION if j in self._drives else JointMode.FREE,
                target_rad=float(self._targets[j - 1]),
            )
            for j in range(1, 8)
        ]
        reading = self.plant.step(commands)
        self.q = np.array(reading.position_counts) * self._resolution
        self._check(reading)
        return self.q, reading

    def _check(self, reading: PlantReading) -> None:
        record, joints = self.record, self.arm.joints
        record.periods += 1
        true = self.truth_reading()
        room = np.minimum(true - self.arm.lower_rad, self.arm.upper_rad - true)
        record.least_room_rad = min(record.least_room_rad, float(room.min()))
        speed, torque = np.abs(reading.speed_rad_per_s), np.abs(reading.torque_nm)
        record.top_speed_rad_per_s = max(record.top_speed_rad_per_s, float(speed.max()))
        record.top_torque_nm = max(record.top_torque_nm, float(torque.max()))
        for j, joint in enumerate(joints):
            if room[j] < 0.0:
                record.trips.append(f"joint {j + 1} left its range")
            if speed[j] > joint.max_speed_rad_per_s:
                record.trips.append(f"joint {j + 1} tripped on speed")
            if torque[j] > joint.max_torque_nm:
                record.trips.append(f"joint {j + 1} tripped on torque")

    def _near_a_trip(self, reading: PlantReading) -> str:
        for j, joint in enumerate(self.arm.joints):
            if abs(reading.speed_rad_per_s[j]) > TRIP_SHARE * joint.max_speed_rad_per_s:
                return f"joint {j + 1} runs too fast"
            if abs(reading.torque_nm[j]) > TRIP_SHARE * joint.max_torque_nm:
                return f"joint {j + 1} needs too much torque"
        return ""


def run_campaign(session: PlantSession, campaign: Campaign, *, most_actions: int = 2000) -> Record:
    """Carry out the campaign to its end."""
    record = session.record
    watched = campaign.task.ranges.within(np.deg2rad(2.0))
    for _ in range(most_actions):
        match campaign.propose():
            case GoTo() as action:
                watch = path_watch(action.trace_rad, action.tolerance_rad, watched)
                stopped = session.move(dict(action.targets_rad), watch)
                campaign.observe(session.q, stopped)
            case ChangeDrives() as action:
                session.set_drives(action.drives)
                record.changes += 1
                campaign.observe(session.q)
            case Capture() as action:
                mean = session.capture()
                record.planned += action.planned
                record.explored += not action.planned
                if action.planned:
                    record.planned_true_rad.append(session.truth_reading())
                campaign.captured(mean)
            case Finished() as action:
                record.finished = action
                return record
    return record
