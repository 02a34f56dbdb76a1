"""What the workflow asks of an arm, and the facts an arm gives back. Knows no bus and no calibration.

Joints are numbered from 1. Angles are sensor coordinates (the measured theta of the paper, without
offsets), continuous and never wrapped; counts are what the drive reports in 6064h.
"""

from __future__ import annotations

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass
from enum import Enum
from pathlib import Path
from typing import Protocol, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SIMULATED_NAME = "sarcal virtual "
"""How the device name (1008h) of a node begins that moves nothing real."""


class JointMode(Enum):
    """How a joint is controlled."""

    POSITION = "position"
    """Combined position and force loop: the joint goes where it is told (CiA 402 CSP, 6060h = 8)."""

    FREE = "free"
    """Force loop at zero torque: the joint follows the closed chain (CST with 6071h = 0, 6060h = 10)."""


class DriveState(Enum):
    """CiA 402 drive states, in the standard's words."""

    NOT_READY_TO_SWITCH_ON = "not ready to switch on"
    SWITCH_ON_DISABLED = "switch on disabled"
    READY_TO_SWITCH_ON = "ready to switch on"
    SWITCHED_ON = "switched on"
    OPERATION_ENABLED = "operation enabled"
    QUICK_STOP_ACTIVE = "quick stop active"
    FAULT_REACTION_ACTIVE = "fault reaction active"
    FAULT = "fault"


@dataclass(frozen=True, slots=True, kw_only=True)
class NodeIdentity:
    """Who a node says it is (1000h, 1008h, 1018h)."""

    node: int
    role: str
    device_name: str
    vendor_id: int
    product_code: int
    revision: int
    serial_number: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmIdentity:
    """The arm as found on the bus. `serial_number` is the supervisor's, e.g. ``SDA-0007``.

    `speaks` is what its nodes are, for people. `by_hand`: a person moves it, and nothing else
    can: no hardware stop is asked for. `Arm.move` waits until the joints are where they are wanted.
    `keeps_parameters`: its controller holds a parameter document; where none does, nothing is uploaded.
    `unwatching` are joints whose drives do not say that they watch the operator's heartbeat.
    `configured` is what was written into drives to have them as the bus profile says, a sentence each; `zeroed`
    are those of it that set a torque or an offset to 0: unlike PDOs they need not come back with a reset.
    """

    model: str
    serial_number: str
    nodes: tuple[NodeIdentity, ...]
    speaks: str = "CANopen"
    by_hand: bool = False
    unwatching: tuple[int, ...] = ()
    configured: tuple[str, ...] = ()
    zeroed: tuple[str, ...] = ()
    keeps_parameters: bool = True

    @property
    def simulated(self) -> bool:
        """Whether every node says of itself that nothing real moves; an arm without nodes says nothing."""
        return bool(self.nodes) and all(
            node.device_name.startswith(SIMULATED_NAME) for node in self.nodes
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """An emergency message: which node (`joint` is None for the supervisor), which code, in words.

    Code 0 is of a drive that sent none, and is not enabled, or not following, though it was told to be.
    """

    node: int
    joint: int | None
    code: int
    text: str
    sync_count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class JointState:
    """One joint as latched on the last SYNC it answered.

    `age_s` is how long ago that answer came, whether or not it then waited to be looked at. `mode` is the
    mode the drive reports (6061h), None while it is neither position nor free.
    """

    joint: int
    position_counts: int
    position_rad: float
    speed_rad_per_s: float
    torque_nm: float
    drive: DriveState
    mode: JointMode | None
    age_s: float


@dataclass(frozen=True, slots=True, kw_only=True)
class HostLatency:
    """How late the program itself was: nobody looked at the bus, or what had come waited.

    `times` so often by more than is worth telling, the last time by `last_s`, at most by `longest_s`.
    """

    times: int = 0
    last_s: float = 0.0
    longest_s: float = 0.0

    def with_event(self, by_s: float, *, new: bool) -> HostLatency:
        """With one more, or with what is the same one still."""
        last_s = by_s if new else max(by_s, self.last_s)
        return HostLatency(
            times=self.times + new, last_s=last_s, longest_s=max(last_s, self.longest_s)
        )


NO_LATENCY = HostLatency()


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmSnapshot:
    """Everything about the arm at one moment, immutable.

    `stopped` is the latch of the software STOP, and `stopped_for` says what it was latched for where nobody
    pressed it; `heartbeat_age_s` maps node numbers to the age of
    their last heartbeat; `token` is the node that holds the control token, 0 if nobody. `late_s` is how
    much of the oldest joint's age is the receiver's own lateness, not the arm's silence; `lateness` is
    that of the whole connection.
    """

    sync_count: int
    joints: tuple[JointState, ...]
    heartbeat_age_s: Mapping[int, float]
    token: int
    faults: tuple[Fault, ...]
    stopped: bool
    moving: bool
    late_s: float = 0.0
    stopped_for: str = ""
    lateness: HostLatency = NO_LATENCY

    @property
    def positions_rad(self) -> FloatArray:
        """Measured angles of all joints, shape (n,)."""
        return np.array([joint.position_rad for joint in self.joints])

    @property
    def torques_nm(self) -> FloatArray:
        """Torques of all joints, shape (n,)."""
        return np.array([joint.torque_nm for joint in self.joints])


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A pose as captured: statistics over N SYNC samples latched at the same instants.

    `mean_rad` and `sd_rad` have shape (n,); `mean_counts` likewise.
    """

    mean_counts: FloatArray
    mean_rad: FloatArray
    sd_rad: FloatArray
    samples: int
    first_sync: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveResult:
    """How a move ended. `reached` is false when `reason` (in words) stopped it short."""

    reached: bool
    reason: str
    positions_rad: FloatArray
    syncs: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadReceipt:
    """What the controller holds after an upload, as read back."""

    slot: str
    sha256: str
    length: int
    home_offset_counts: tuple[int, ...]


Watch = Callable[[ArmSnapshot], str | None]
"""Looks at every SYNC of a move; a sentence ends the move (the arm holds), None lets it go on."""


class Arm(Protocol):
    """An arm that can be connected, moved in its closed chain, read and given parameters.

    Every call raises `hardware.errors.HardwareError` subclasses only. All calls but `stop` and
    `snapshot` come from one thread; `stop` and `snapshot` may come from any, at any time.
    """

    def connect(self) -> ArmIdentity:
        """Find the arm's nodes, check them against the arm file, start heartbeats and SYNC."""
        ...

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state; never blocks."""
        ...

    def take_control(self) -> None:
        """Obtain the control token and enable all drives, holding where they are."""
        ...

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        """Ask for one mode per joint; returns when 6061h of every drive says so, else raises."""
        ...

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        """Move the position-mode joints in `targets_rad` in step, straight, to their targets."""
        ...

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        """Wait until no joint's position spreads more than `spread_rad` over `window` SYNCs."""
        ...

    def capture(self, samples: int) -> Reading:
        """Read `samples` SYNCs; all joints of a sample are latched on the same SYNC."""
        ...

    def hold(self) -> None:
        """All joints to position mode at their measured position."""
        ...

    def stop(self) -> None:
        """Quick stop to all drives at once; latches. Waits for no lock and no queue."""
        ...

    def reset_stop(self) -> None:
        """Clear the latch and drive faults; never starts motion, the drives stay disabled."""
        ...

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        """Stage, read back, commit; raises `UploadRefused` with the controller's words."""
        ...

    def active_parameters(self) -> bytes:
        """Read the parameter document that is active on the controller; empty if there is none."""
        ...

    def close(self) -> bool:
        """Leave the arm held and its drives off, give the token back, stop heartbeats. Safe to call twice.

        Whoever closed it may put a hand on it: no drive follows a command any more. False if the arm did not
        answer, so that nobody knows, or if a drive follows commands still.
        """
        ...


@runtime_checkable
class PowerReporting(Protocol):
    """An arm that knows, once it is closed, which of its drives did not switch off."""

    @property
    def left_powered(self) -> tuple[int, ...]:
        """Joints whose drives said that they were powered, those that STOP holds included."""
        ...


@runtime_checkable
class Recordable(Protocol):
    """An arm whose bus is recorded, from the next connection on: `record_to` is the file, None for none."""

    record_to: Path | None
