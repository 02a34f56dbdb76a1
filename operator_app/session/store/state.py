"""Session state: immutable, computed from journal events alone."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.arm import NO_LATENCY, HostLatency, JointMode
from operator_app.calibration.repeat_measurement import RepeatedReading
from solver.chain.poses import PoseSet

if TYPE_CHECKING:
    from operator_app.config.procedure import CapturePlan
    from solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredPose:
    """Data common to captured poses and check readings.

    `mean_rad`, `sd_rad` (n,): mean and standard deviation of the joint samples, in sensor coordinates.
    `placement`: number of the mounting of the fixture, from 1.
    `endpoint`: measurement of an instrument (m and rad); empty without one.
    """

    number: int
    mean_rad: FloatArray
    sd_rad: FloatArray
    samples: int
    utc: str
    note: str = ""
    placement: int = 1
    endpoint: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedPose(MeasuredPose):
    """One captured pose.

    `number` counts captures from 1 and is never reused. `waypoint`: index of the pose in the plan; -1 if it is not in
    the plan. `excluded`: reason why the pose is not used; empty if it is used. `planned`: whether a plan chose the
    pose.
    """

    waypoint: int
    excluded: str = ""
    planned: bool = False


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckReading(MeasuredPose):
    """A pose measured for a check, not used for the calibration.

    `kind`: ``verification``, or ``return`` for a repeat of pose number `of`. `after`: number of captures before this
    reading.
    """

    kind: str
    of: int = 0
    after: int = 0


@dataclass(frozen=True, slots=True, kw_only=True)
class RepeatedPose:
    """A used pose and its second measurement."""

    first: CapturedPose
    again: CheckReading


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignLog:
    """A planned capture as recorded in the journal.

    `begun`: data recorded at the start; empty before the start. `steps`: names and data of the events reported to the
    planning policy, in order. `ended`: data recorded at the end; empty before the end.
    """

    begun: Mapping[str, Any] = field(default_factory=dict)
    steps: tuple[tuple[str, Mapping[str, Any]], ...] = ()
    ended: Mapping[str, Any] = field(default_factory=dict)

    def step(self, name: str, data: Mapping[str, Any]) -> CampaignLog:
        """Return the log with one more step."""
        return replace(self, steps=(*self.steps, (name, data)))


UNSOLVED: Mapping[str, Any] = {
    "solved": {},
    "solution": {},
    "checks": {},
    "solved_utc": "",
    "exported": {},
}
"""Values of the result fields while there are no results, e.g. after the set of poses has changed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionState:
    """State of a session.

    Attributes
    ----------
    order
        Order number among the sessions in the same folder, from 1; 0 in journals of earlier versions.
    imported
        File from which the poses were read; empty if an arm captured them.
    sources
        Texts of the procedure, arm, fixture and profile documents at opening, by kind.
    node_serials
        Serial numbers (1018h) of the nodes that captured the poses, by node.
    start_rad
        Joint angles (n,) when the drives were first enabled in this placement. None before, like `home_rad`.
    home_rad
        Centre (n,) of the drive box: the procedure's home or, in journals of earlier versions, `start_rad`.
    modes
        Mode of each joint as last confirmed by its drive; empty until set.
    poses, undone
        Captured poses, including excluded ones, and the poses removed by undo.
    visited
        Indices of the waypoints that were captured or skipped.
    skipped_waypoints
        Reason for each skipped waypoint, by index. Skipped waypoints are tried again after resuming.
    captured
        Number of captures, including undone ones: the next pose has number captured + 1.
    drives, drive_sets
        Chosen drive joints, and all sets that a plan may use; empty until chosen.
    resumed
        Whether a drift check is due, as after resuming, repairing, connecting again or a sensor fault. The next check
        reading completes it; after a sensor fault, only if the repeated pose agrees with its first reading.
    placement
        Number of the current mounting of the fixture, from 1; start, home, waypoints and modes are of this placement.
    mounted
        False while the fixture is being remounted, until the operator confirms that it is mounted.
    missed_repeat
        Why the last attempt to measure the first pose again failed; empty if it did not fail.
    sensor_jump
        Text of the last sensor fault; captures are refused until the first pose has been measured again and agrees with
        its first reading. Empty if there is no such fault.
    verifications
        Number of verifications with new poses.
    solved, solved_utc, exported
        Summary and time (UTC) of the calibration, and summary of its export; empty before there is one.
    solution, checks
        Records (`operator_app.calibration.serialization`) of the last calibration and of its cross-validation; empty
        until there is one, and in journals of earlier versions.
    late
        Delays of this computer (host latency) over all connections.
    """

    opened_utc: str = ""
    order: int = 0
    imported: str = ""
    missed_repeat: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    serial_number: str = ""
    node_serials: Mapping[int, int] = field(default_factory=dict)
    start_rad: FloatArray | None = None
    home_rad: FloatArray | None = None
    modes: tuple[JointMode, ...] = ()
    poses: tuple[CapturedPose, ...] = ()
    undone: tuple[CapturedPose, ...] = ()
    visited: frozenset[int] = frozenset()
    skipped_waypoints: Mapping[int, str] = field(default_factory=dict)
    captured: int = 0
    drives: tuple[int, ...] = ()
    drive_sets: tuple[tuple[int, ...], ...] = ()
    readings: tuple[CheckReading, ...] = ()
    resumed: bool = False
    placement: int = 1
    mounted: bool = True
    sensor_jump: str = ""
    verifications: int = 0
    campaign: CampaignLog = field(default_factory=CampaignLog)
    solved: Mapping[str, Any] = field(default_factory=dict)
    solution: Mapping[str, Any] = field(default_factory=dict)
    checks: Mapping[str, Any] = field(default_factory=dict)
    solved_utc: str = ""
    exported: Mapping[str, Any] = field(default_factory=dict)
    late: HostLatency = NO_LATENCY

    @property
    def position_joints(self) -> tuple[int, ...]:
        """Joints in position mode as last confirmed."""
        return tuple(j for j, m in enumerate(self.modes, 1) if m is JointMode.POSITION)

    @property
    def next_waypoint(self) -> int:
        """Index of the first waypoint of the plan that was not visited."""
        return next(k for k in range(len(self.visited) + 1) if k not in self.visited)

    @property
    def used_poses(self) -> tuple[CapturedPose, ...]:
        """Poses that are neither excluded nor removed by undo."""
        return tuple(p for p in self.poses if not p.excluded)

    def pose(self, number: int) -> CapturedPose | None:
        """Return the pose with this number, excluded or not; None if there is none."""
        return next((p for p in self.poses if p.number == number), None)

    @property
    def poses_here(self) -> tuple[CapturedPose, ...]:
        """Used poses of the current placement of the fixture."""
        return tuple(p for p in self.used_poses if p.placement == self.placement)

    @property
    def unconfirmed_placement(self) -> bool:
        """Whether the mounting must be confirmed: the current placement is not the first and has no used pose."""
        return self.placement > 1 and not self.poses_here

    @property
    def here(self) -> SessionState:
        """State with the poses and readings of the current placement only, as if it were the only placement."""
        if all(p.placement == self.placement == 1 for p in self.poses):
            return self
        number = self.placement
        poses = tuple(replace(p, placement=1) for p in self.poses if p.placement == number)
        readings = tuple(replace(r, placement=1) for r in self.readings if r.placement == number)
        return replace(self, poses=poses, readings=readings, placement=1, **UNSOLVED)

    @property
    def repeats(self) -> tuple[RepeatedPose, ...]:
        """Used poses that were measured again."""
        known = {p.number: p for p in self.used_poses}
        return tuple(
            RepeatedPose(first=known[r.of], again=r)
            for r in self.readings
            if r.kind == "return" and r.of in known
        )

    @property
    def repeated_since_capture(self) -> bool:
        """Whether a pose was measured again since the last capture."""
        return any(r.again.after == self.captured for r in self.repeats)

    @property
    def rereads(self) -> tuple[RepeatedReading, ...]:
        """Both readings of each repeated pose, in the form that the diagnosis of a calibration requires."""
        return tuple(
            RepeatedReading(
                label=str(r.first.number),
                after=r.again.after,
                first_rad=r.first.mean_rad,
                again_rad=r.again.mean_rad,
                samples=r.first.samples,
                samples_again=r.again.samples,
            )
            for r in self.repeats
        )

    def required_poses(self, capture: CapturePlan) -> int:
        """Return how many used poses of all placements there are when the current placement is complete.

        In a planned capture, `capture.poses` counts only the poses chosen by the plan. Explored poses come in addition.
        """
        used = self.used_poses
        if capture.strategy != "planned":
            return capture.poses + len(used) - len(self.poses_here)
        if self.campaign.ended.get("complete"):
            return len(used)
        return capture.poses + sum(not p.planned for p in used)

    def pose_set(self) -> PoseSet:
        """Return the used poses as a `PoseSet`, the input of the estimators."""
        return pose_set_of(self.used_poses)


def pose_set_of(poses: Sequence[MeasuredPose]) -> PoseSet:
    """Return these poses as a `PoseSet`, the input of the estimators."""
    joints = len(poses[0].mean_rad) if poses else 1
    measured = {len(p.endpoint) for p in poses} in ({3}, {6})
    return PoseSet(
        placement=np.array([p.placement for p in poses], dtype=np.int64),
        label=tuple(str(p.number) for p in poses),
        q_rad=np.array([p.mean_rad for p in poses]).reshape(len(poses), joints),
        sd_rad=np.array([p.sd_rad for p in poses]).reshape(len(poses), joints),
        samples=np.array([p.samples for p in poses], dtype=np.int64),
        endpoint=np.array([p.endpoint for p in poses]) if measured else None,
        utc=tuple(p.utc for p in poses),
        notes=tuple(p.note for p in poses),
    )
