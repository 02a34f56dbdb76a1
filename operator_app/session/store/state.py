"""What a session amounts to: the immutable state that replaying its journal gives. No I/O, no arm."""

from __future__ import annotations

from collections.abc import Mapping, Sequence
from dataclasses import dataclass, field, replace
from typing import TYPE_CHECKING, Any

import numpy as np

from hardware.arm import NO_LATENCY, HostLatency, JointMode
from operator_app.calibration.repeat_measurement import Reread
from solver.chain.poses import PoseSet

if TYPE_CHECKING:
    from operator_app.config.procedure import CapturePlan
    from solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True)
class CapturedPose:
    """One captured pose; `planned` when a plan chose it.

    `number` counts captures from 1 and is never used twice; `waypoint` is the index in the plan it
    was taken for, -1 for none; `mean_rad` and `sd_rad` have shape (n,), sensor coordinates. `placement`
    counts how often the fixture was mounted, from 1; `endpoint` what an instrument measured (m and rad; else empty).
    """

    number: int
    waypoint: int
    mean_rad: FloatArray
    sd_rad: FloatArray
    samples: int
    utc: str
    note: str = ""
    excluded: str = ""
    planned: bool = False
    placement: int = 1
    endpoint: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class CheckReading:
    """A pose that was read to check the calibration, and is no part of it.

    `kind` is ``verification`` or ``return``: pose number `of` read once more, after `after` captures.
    `number` counts such readings from 1; `mean_rad` and `sd_rad` have shape (n,), sensor coordinates.
    """

    kind: str
    number: int
    mean_rad: FloatArray
    sd_rad: FloatArray
    samples: int
    utc: str
    note: str = ""
    of: int = 0
    after: int = 0
    placement: int = 1
    endpoint: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True)
class Return:
    """A pose that counts, and the reading of it after the arm came back to it."""

    first: CapturedPose
    again: CheckReading


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignLog:
    """A planned capture as the journal has it: what it began with and what happened since, in order.

    `begun` is empty before there is one. `steps` are the names and data of the events that the policy
    was told of; `ended` is the data of its end, empty before.
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
"""Of other poses nothing was concluded yet."""


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionState:
    """Everything that was decided and measured so far.

    Attributes
    ----------
    order
        Which session of its folder it is, from 1; 0 in journals of earlier versions.
    after
        In those: folder name of the session begun before this one, where the clock has been set back since; else empty.
    imported
        File that the poses were read from; empty where an arm took them.
    sources
        The arm, fixture and procedure documents the session was opened with, as text by kind.
    serial_number
        Of the arm; empty until connected.
    node_serials
        Of its nodes (1018h), by node; those that the poses were taken with.
    start_rad
        Joint angles when the session first took control (n,), or None.
    home_rad
        Round where its boxes are (n,): the procedure's home, or, in journals of earlier versions, where
        it started.
    modes
        ``position``/``free`` per joint as last confirmed; empty until set.
    poses
        All captured poses that were not undone, excluded ones included.
    undone
        Those that were, as they were then.
    visited
        Waypoints of the plan that are done with: captured, or passed over with a reason.
    passed_over
        Those of them that were: what kept the arm from them may have gone when the session is resumed.
    captured
        How many captures there were, undone ones included: the next pose is number captured + 1.
    drives, drive_sets
        Joints chosen to drive, and all sets a plan may change between; empty until chosen.
    readings
        Poses that were read to check the calibration.
    resumed
        Whether the session was resumed, or the arm found again, since the last of them: something may
        have slipped meanwhile.
    placement
        Which mounting of the fixture the arm is in, from 1. Where it started, its waypoints and its modes
        are of this one.
    mounted
        Whether it is: False from when the fixture was to come off until somebody says that it is mounted.
    return_missed
        Why the first pose could not be read once more, since it last was; empty: nobody tried in vain.
    slipped
        What a joint's reading did that no motion explains: no pose counts until the first one, read
        again, reads as it did. Empty: nothing.
    verifications
        How many times it was verified with new poses.
    campaign
        The planned capture.
    solved, exported
        Summary data of the solve, and of the export of what was solved; empty until there is one.
    solved_utc
        When it was solved; empty before.
    solution, checks
        Records (`operator_app.calibration.serialization`) of the last solve and of the second opinions on
        it; empty until there is one, and in journals of earlier versions.
    late
        How late the computer itself was, all connections together.
    """

    opened_utc: str = ""
    order: int = 0
    after: str = ""
    imported: str = ""
    return_missed: str = ""
    sources: Mapping[str, str] = field(default_factory=dict)
    settings: Mapping[str, Any] = field(default_factory=dict)
    serial_number: str = ""
    node_serials: Mapping[int, int] = field(default_factory=dict)
    start_rad: FloatArray | None = None
    home_rad: FloatArray | None = None
    modes: tuple[str, ...] = ()
    poses: tuple[CapturedPose, ...] = ()
    undone: tuple[CapturedPose, ...] = ()
    visited: frozenset[int] = frozenset()
    passed_over: frozenset[int] = frozenset()
    captured: int = 0
    drives: tuple[int, ...] = ()
    drive_sets: tuple[tuple[int, ...], ...] = ()
    readings: tuple[CheckReading, ...] = ()
    resumed: bool = False
    placement: int = 1
    mounted: bool = True
    slipped: str = ""
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
        return tuple(j for j, m in enumerate(self.modes, 1) if m == JointMode.POSITION.value)

    @property
    def next_waypoint(self) -> int:
        """First waypoint of the plan that has not been visited."""
        return next(k for k in range(len(self.visited) + 1) if k not in self.visited)

    @property
    def used_poses(self) -> tuple[CapturedPose, ...]:
        """Poses that count: captured, not undone, not excluded."""
        return tuple(p for p in self.poses if not p.excluded)

    @property
    def poses_here(self) -> tuple[CapturedPose, ...]:
        """Those of them that were taken in the present placement of the fixture."""
        return tuple(p for p in self.used_poses if p.placement == self.placement)

    @property
    def unseen(self) -> bool:
        """Whether nothing is known of the present placement but that it was to come."""
        return self.placement > 1 and not self.poses_here

    @property
    def here(self) -> SessionState:
        """What is known of the present placement alone: the others say nothing of where the arm stands."""
        if all(p.placement == self.placement == 1 for p in self.poses):
            return self
        number = self.placement
        poses = tuple(replace(p, placement=1) for p in self.poses if p.placement == number)
        readings = tuple(replace(r, placement=1) for r in self.readings if r.placement == number)
        return replace(self, poses=poses, readings=readings, placement=1, **UNSOLVED)

    @property
    def returns(self) -> tuple[Return, ...]:
        """Readings of poses that the arm came back to, as far as those still count."""
        known = {p.number: p for p in self.used_poses}
        return tuple(
            Return(first=known[r.of], again=r)
            for r in self.readings
            if r.kind == "return" and r.of in known
        )

    @property
    def rereads(self) -> tuple[Reread, ...]:
        """The same as a calibration is tested with."""
        return tuple(
            Reread(
                label=str(r.first.number),
                after=r.again.after,
                first_rad=r.first.mean_rad,
                again_rad=r.again.mean_rad,
                samples=r.first.samples,
                samples_again=r.again.samples,
            )
            for r in self.returns
        )

    def wanted_poses(self, capture: CapturePlan) -> int:
        """How many poses the procedure asks for; a plan's come beside those of its exploration."""
        used = self.used_poses
        if capture.strategy != "planned":
            # As many in every placement.
            return capture.poses + len(used) - len(self.poses_here)
        if self.campaign.ended.get("complete"):
            return len(used)
        return capture.poses + sum(not p.planned for p in used)

    def pose_set(self) -> PoseSet:
        """Return the used poses as the estimators take them."""
        used = self.used_poses
        placement = np.array([p.placement for p in used], dtype=np.int64)
        return replace(pose_set_of(used), placement=placement)


def pose_set_of(poses: Sequence[CapturedPose | CheckReading]) -> PoseSet:
    """Return poses as the estimators take them."""
    joints = len(poses[0].mean_rad) if poses else 1
    measured = {len(p.endpoint) for p in poses} in ({3}, {6})
    return PoseSet(
        placement=np.ones(len(poses), dtype=np.int64),
        label=tuple(str(p.number) for p in poses),
        q_rad=np.array([p.mean_rad for p in poses]).reshape(len(poses), joints),
        sd_rad=np.array([p.sd_rad for p in poses]).reshape(len(poses), joints),
        samples=np.array([p.samples for p in poses], dtype=np.int64),
        endpoint=np.array([p.endpoint for p in poses]) if measured else None,
        utc=tuple(p.utc for p in poses),
        notes=tuple(p.note for p in poses),
    )
