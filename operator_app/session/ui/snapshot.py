"""The snapshot of a session for user interfaces: state of arm, session and running task, messages.

An alarm stays until a task that resolves it has succeeded, or until the operator acknowledges it.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import TYPE_CHECKING

from fixtures.base import SetupCheck
from hardware import errors
from hardware.arm import ArmIdentity, ArmSnapshot, DriveState, UploadReceipt
from operator_app.calibration.cross_validation import Checks
from operator_app.calibration.result import Solution
from operator_app.calibration.verification import VerificationResult
from operator_app.config.procedure import Procedure
from operator_app.errors import ConnectAgainError
from operator_app.planning.live import Forecast, LiveQuality
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.export import Exported
from solver.design.actions import GoTo
from solver.design.drive_joints import RankedDrives

if TYPE_CHECKING:
    from operator_app.session.ui.supervisor import Motion

STALE_S = 0.1
"""Data older than this are marked as stale and not used."""
LOST_S = 1.0
"""If the arm sends no data for longer than this, an alarm is raised and the arm is stopped."""
HUNG_S = 10.0
"""Limit that replaces `LOST_S` while the host is late."""


class DataState(Enum):
    """State of the joint data, determined by the joint with the oldest data."""

    NONE = "no data"
    FRESH = "ok"
    STALE = "stale"
    LOST = "lost"


class Level(Enum):
    """Severity of a message."""

    INFO = "info"
    WARNING = "warning"
    ALARM = "alarm"


class TaskKind(Enum):
    """Kind of task; the value describes the running task to the operator."""

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
    """A message, numbered from 1; `time`: UTC, HH:MM:SS. Success of one of `resolving_tasks` resolves an alarm."""

    number: int
    time: str
    level: Level
    text: str
    resolving_tasks: frozenset[TaskKind] = frozenset()


@dataclass(frozen=True, slots=True, kw_only=True)
class RunningTask:
    """The running task.

    `moves`: whether the arm may move; if so, any key cancels the task. `planning`: whether the next poses are being
    planned; the arm then stands still. `ending`: whether the task was cancelled and has not ended yet.
    """

    kind: TaskKind
    text: str
    moves: bool
    started_s: float
    planning: bool = False
    ending: bool = False

    @property
    def progress(self) -> str:
        """What the task does now."""
        now = "planning the next poses; the arm stands still" if self.planning else self.text
        return f"ending: {now}" if self.ending else now


@dataclass(frozen=True, slots=True, kw_only=True)
class StopReport:
    """A software STOP.

    `asked_s`: time of the request (monotonic clock). `acknowledged_after_s`: time from the request until no drive
    was in the state Operation enabled; None until then. `drives_stopped`: number of drives that are not in this
    state. `problem`: why STOP could not be sent; empty if it was sent.
    """

    asked_s: float
    acknowledged_after_s: float | None = None
    drives_stopped: int = 0
    problem: str = ""


@dataclass(frozen=True, slots=True, kw_only=True)
class DiffRow:
    """One calibrated parameter, rad or m: `new` value, and the controller's `active` value (None if it has none)."""

    name: str
    is_angle: bool
    active: float | None
    new: float


@dataclass(frozen=True, slots=True, kw_only=True)
class SessionSnapshot:
    """Everything a user interface shows.

    Attributes
    ----------
    arm
        Latest snapshot of the arm; None before there is one.
    data, oldest_s, stale_joints
        State of the data, age of the oldest joint data (s), and joints with data older than `STALE_S`.
    motion
        Motion of the joints; None without fresh data.
    simulated, bus
        Whether the arm is simulated; name of the bus, for texts to the operator.
    unstopped_joints
        Joints whose drives report, `UNSTOPPED_S` after STOP, that they are still enabled.
    stop_tested, ticked
        Confirmations of the operator in this run: test of the hardware stop; items of the check list (from 0).
    selected_joints
        Joints selected for position mode, ascending; the others become free.
    next_waypoint, best_waypoint, at_waypoint
        Indices (from 0) of the next waypoint, the most informative one, and the one where the arm is.
    heading
        Current move of a planned capture; otherwise None.
    estimator, unsensed_joints
        Options of the next calibration.
    iterations
        Number and cost of each iteration of the estimator.
    messages, alarms
        Messages, oldest first, and the alarms that are neither resolved nor acknowledged.
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
    unstopped_joints: tuple[int, ...] = ()
    stop_tested: bool = False
    checks: tuple[SetupCheck, ...] = ()
    ticked: frozenset[int] = frozenset()
    selected_joints: tuple[int, ...] = ()
    ranked: tuple[RankedDrives, ...] = ()
    wiggle: str = ""
    plan: tuple[Mapping[int, float], ...] = ()
    forecast: Forecast | None = None
    next_waypoint: int | None = None
    best_waypoint: int | None = None
    at_waypoint: int | None = None
    heading: GoTo | None = None
    live: LiveQuality | None = None
    iterations: tuple[tuple[int, float], ...] = ()
    solution: Solution | None = None
    cross_checks: Checks | None = None
    written: Exported | None = None
    diff: tuple[DiffRow, ...] = ()
    receipt: UploadReceipt | None = None
    report: Path | None = None
    verification: VerificationResult | None = None
    stop: StopReport | None = None
    task: RunningTask | None = None
    messages: tuple[Message, ...] = ()
    alarms: tuple[Message, ...] = ()

    @property
    def connected(self) -> bool:
        """Whether an arm is connected and checked."""
        return self.identity is not None

    @property
    def sync_rate_hz(self) -> float:
        """SYNC messages per second; 0 without fresh data."""
        return 0.0 if self.motion is None else self.motion.sync_rate_hz

    @property
    def stopped(self) -> bool:
        """Whether STOP is latched."""
        return self.arm is not None and self.arm.stopped

    @property
    def stopped_for(self) -> str:
        """Why the arm stopped by itself; "" if it did not, or if STOP was pressed."""
        return "" if self.arm is None else self.arm.stopped_for

    @property
    def drive_faults(self) -> dict[int, str]:
        """Error code and meaning of each fault of a drive, by joint; "" for a drive that has reported no code."""
        if self.arm is None:
            return {}
        reported = {f.joint: f"{f.code:04X}h: {f.text}" for f in self.arm.faults if f.code}
        in_fault = (DriveState.FAULT, DriveState.FAULT_REACTION_ACTIVE)
        return {j.joint: reported.get(j.joint, "") for j in self.arm.joints if j.drive in in_fault}

    @property
    def required_poses(self) -> int:
        """Number of poses that the procedure requires."""
        return self.state.required_poses(self.procedure.capture)

    @property
    def chooses_by_plan(self) -> bool:
        """Whether a plan chooses the next target: the capture is planned, and no task but AUTOMATIC is running."""
        by_hand = self.task is not None and self.task.kind is not TaskKind.AUTOMATIC
        return self.procedure.capture.strategy == "planned" and not by_hand

    @property
    def drives_ready(self) -> bool:
        """Whether every drive is enabled and in its confirmed mode."""
        return (
            self.arm is not None
            and len(self.state.modes) == len(self.arm.joints)
            and all(
                joint.drive is DriveState.OPERATION_ENABLED and joint.mode is mode
                for joint, mode in zip(self.arm.joints, self.state.modes, strict=True)
            )
        )

    @property
    def needs_reconnect(self) -> bool:
        """Whether there is an alarm that only a new connection resolves."""
        return any(
            TaskKind.CONNECT in alarm.resolving_tasks
            and TaskKind.RESET not in alarm.resolving_tasks
            for alarm in self.alarms
        )

    def with_message(
        self,
        level: Level,
        text: str,
        *,
        time: str,
        resolving_tasks: frozenset[TaskKind] = frozenset(),
    ) -> SessionSnapshot:
        """Return the snapshot with another message; an alarm replaces an existing alarm with the same text.

        An alarm is resolved when one of its `resolving_tasks` succeeds; without such tasks it stays until acknowledged.
        """
        number = self.messages[-1].number + 1 if self.messages else 1
        message = Message(
            number=number, time=time, level=level, text=text, resolving_tasks=resolving_tasks
        )
        if level is not Level.ALARM:
            return replace(self, messages=(*self.messages, message)[-MAX_MESSAGES:])
        repeated = {standing.number for standing in self.alarms if standing.text == text}
        messages, alarms = (
            (*(m for m in before if m.number not in repeated), message)[-MAX_MESSAGES:]
            for before in (self.messages, self.alarms)
        )
        return replace(self, messages=messages, alarms=alarms)

    def without_resolved(self, kind: TaskKind) -> SessionSnapshot:
        """Return the snapshot without the alarms that a task of this kind resolves."""
        return replace(self, alarms=tuple(a for a in self.alarms if kind not in a.resolving_tasks))

    def without_alarm(self, number: int) -> SessionSnapshot:
        """Return the snapshot without the alarm with this number; its cause may persist."""
        return replace(self, alarms=tuple(a for a in self.alarms if a.number != number))


Change = Callable[[SessionSnapshot], SessionSnapshot]
"""Function that returns a changed snapshot: ``lambda s: replace(s, field=value)``."""


# -- messages --------------------------------------------------------------------------------------

MAX_MESSAGES = 100

ARM_RECOVERY = frozenset({TaskKind.RESET, TaskKind.CONNECT})
"""Tasks that resolve an alarm about the arm."""


CONNECT_AGAIN = (
    ConnectAgainError,
    errors.ControlDenied,
    errors.OtherMaster,
    errors.MappingChanged,
    errors.NodeRestarted,
    errors.DuplicateNodeId,
)
"""Errors that persist until the arm is connected again."""


def resolving_tasks(error: Exception, kind: TaskKind) -> frozenset[TaskKind]:
    """Return the kinds of task whose success resolves the alarm about `error`, raised in a task of `kind`."""
    # After a jump, all later readings are doubtful; with a stuck sensor, only readings of the excluded poses are.
    jumped = isinstance(error, errors.SensorFault) and not (
        isinstance(error, errors.DriveDiverged) or error.stuck
    )
    if jumped or isinstance(error, CONNECT_AGAIN):
        return frozenset({TaskKind.CONNECT, kind}) - {TaskKind.RESET}
    return (ARM_RECOVERY if isinstance(error, errors.HardwareError) else frozenset()) | {kind}
