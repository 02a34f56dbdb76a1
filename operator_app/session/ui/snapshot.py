"""What the session publishes for a screen: one immutable picture of arm, decisions and work in hand.

Polled, never awaited. Knows no thread, no screen and no bus.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import Enum
from pathlib import Path
from typing import Protocol

from fixtures.base import SetupCheck
from hardware.arm import ArmIdentity, ArmSnapshot, DriveState, JointMode, UploadReceipt
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.config.procedure import Procedure
from operator_app.planning.forecast import Forecast
from operator_app.planning.live import LiveQuality
from operator_app.session.safety.joint_motion import Motion
from operator_app.session.store.state import SessionState
from solver.design.actions import GoTo
from solver.design.drive_joints import RankedDrives

STALE_S = 0.1
"""Older data are marked, what is derived from them is blanked, and nothing is captured."""
LOST_S = 1.0
"""Silence of the arm for longer is an alarm: the arm is stopped."""
HUNG_S = 10.0
"""So are data this old although it is we who are late."""


class DataState(Enum):
    """How old the oldest joint's answer is."""

    NONE = "no data"
    FRESH = "ok"
    STALE = "stale"
    LOST = "lost"


class Level(Enum):
    """How much a message matters."""

    INFO = "info"
    WARNING = "warning"
    ALARM = "alarm"


class TaskKind(Enum):
    """What the worker is doing."""

    CONNECT = "connecting"
    CHECK = "checking the fixture"
    MODES = "setting the modes"
    MOVE = "moving"
    CAPTURE = "capturing"
    AUTOMATIC = "capturing automatically"
    WIGGLE = "trial wiggle"
    HOME = "going home"
    CALIBRATE = "calibrating"
    EXPORT = "writing"
    UPLOAD = "uploading"
    VERIFY = "verifying"
    RESET = "resetting STOP"
    HOLD = "holding"
    NOTE = "noting"


@dataclass(frozen=True, slots=True, kw_only=True)
class Message:
    """Something that happened. `time` is UTC, HH:MM:SS; `number` counts from 1.

    `until`: work that resolves an alarm when it is done.
    """

    number: int
    time: str
    level: Level
    text: str
    until: frozenset[TaskKind] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class Work:
    """Work in hand. `moves`: the arm may move, and any key ends it."""

    kind: TaskKind
    text: str
    moves: bool
    started_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class StopReport:
    """A software STOP.

    When it was asked for (monotonic), how long sending took, after how long no drive was in operation
    any more (None: not yet), how many are not, and why it could not be sent ("" if it was).
    """

    asked_s: float
    sent_after_s: float
    acknowledged_after_s: float | None
    drives_stopped: int
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class Iteration:
    """One step of an estimator."""

    number: int
    cost: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Written:
    """Where this calibration was written."""

    folder: Path
    parameters: Path
    poses: Path
    sha256: str


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffRow:
    """One parameter, rad or m: the controller's active value (None: none there) and the new one."""

    name: str
    is_angle: bool
    active: float | None
    new: float


@dataclass(frozen=True, slots=True, kw_only=True)
class Verified:
    """New poses judged by parameters that were fixed before.

    rms of the closure at the readings (of its orientation None where only positions close), chi2/dof,
    whether the parameters predict as well as they claim to, and what is named as the reason where they do not.
    """

    poses: int
    position_m: float
    orientation_rad: float | None
    chi2_per_dof: float
    holds: bool
    why: str = ""

    @property
    def verdict(self) -> str:
        """Whether they do, in words."""
        if self.holds:
            return "as expected"
        return "worse than expected" + (f" ({self.why})" if self.why else "")


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSnapshot:
    """Everything a screen shows.

    Attributes
    ----------
    arm
        Latest state of the arm; None before there is one.
    data, oldest_s, stale_joints
        Age of the data: verdict, age of the oldest joint's answer, joints older than `STALE_S`.
    motion
        How the joints moved lately; None without fresh data.
    simulated, bus
        Whether nothing real can move, and which bus this is, in words.
    stop_tested, ticked
        What the operator has confirmed in this run: the hardware stop, the fixture's check list.
    wanted_joints
        Joints marked for position mode, ascending; the others are to be free.
    plan, forecast, next_waypoint, best_waypoint, at_waypoint
        Waypoints, what the model says of them; the one that is next, that would tell most, that the
        arm is at.
    heading
        Where a planned capture takes the arm now, with the poses predicted on the way; else None.
    estimator, unsensed_joints
        How the next calibration will be made.
    messages, alarms
        What was said, oldest first, and what of it stands: neither resolved nor acknowledged.
    """

    now_s: float
    procedure: Procedure
    folder: Path
    state: SessionState
    simulated: bool
    bus: str
    mobility: int
    estimator: str
    unsensed_joints: tuple[int, ...]
    arm: ArmSnapshot | None = None
    identity: ArmIdentity | None = None
    data: DataState = DataState.NONE
    oldest_s: float = 0.0
    stale_joints: tuple[int, ...] = ()
    motion: Motion | None = None
    stop_tested: bool = False
    checks: tuple[SetupCheck, ...] = ()
    ticked: frozenset[int] = frozenset()
    wanted_joints: tuple[int, ...] = ()
    ranked: tuple[RankedDrives, ...] = ()
    wiggle: str = ""
    plan: tuple[Mapping[int, float], ...] = ()
    forecast: Forecast | None = None
    next_waypoint: int | None = None
    best_waypoint: int | None = None
    at_waypoint: int | None = None
    heading: GoTo | None = None
    live: LiveQuality | None = None
    iterations: tuple[Iteration, ...] = ()
    solution: Solution | None = None
    checks_of_it: Checks | None = None
    written: Written | None = None
    diff: tuple[DiffRow, ...] = ()
    receipt: UploadReceipt | None = None
    report: Path | None = None
    verification: Verified | None = None
    stop: StopReport | None = None
    task: Work | None = None
    messages: tuple[Message, ...] = field(default=())
    alarms: tuple[Message, ...] = ()

    @property
    def connected(self) -> bool:
        """Whether an arm has answered and was checked."""
        return self.identity is not None

    @property
    def sync_rate_hz(self) -> float:
        """SYNC messages a second; 0 without fresh data."""
        return 0.0 if self.motion is None else self.motion.sync_rate_hz

    @property
    def stopped(self) -> bool:
        """Whether STOP is latched."""
        return self.arm is not None and self.arm.stopped

    @property
    def stopped_for(self) -> str:
        """Why the arm was stopped by itself, in words; "" where it was not, or STOP was pressed."""
        return "" if self.arm is None else self.arm.stopped_for

    @property
    def wanted_poses(self) -> int:
        """How many poses the procedure asks for."""
        return self.state.wanted_poses(self.procedure.capture)

    @property
    def modes(self) -> tuple[JointMode, ...]:
        """Modes as last confirmed; empty before."""
        return tuple(JointMode(m) for m in self.state.modes)

    @property
    def position_joints(self) -> tuple[int, ...]:
        """Joints in position mode as last confirmed."""
        return tuple(k for k, m in enumerate(self.modes, 1) if m is JointMode.POSITION)

    @property
    def drives_ready(self) -> bool:
        """Whether every drive is enabled and in the mode that was confirmed."""
        return (
            self.arm is not None
            and len(self.modes) == len(self.arm.joints)
            and all(
                joint.drive is DriveState.OPERATION_ENABLED and joint.mode is mode
                for joint, mode in zip(self.arm.joints, self.modes, strict=True)
            )
        )


Change = Callable[[SessionSnapshot], SessionSnapshot]
"""How something is published: ``lambda s: replace(s, field=value)``, whose fields the type checker knows."""


class Publisher(Protocol):
    """Where operations put what they found, and hear that they should end."""

    def publish(self, change: Change) -> None:
        """Put the changed snapshot in the place of the present one."""
        ...

    def say(self, level: Level, text: str) -> None:
        """Tell the operator."""
        ...

    def cancelled(self) -> bool:
        """Whether the operator wants this ended."""
        ...
