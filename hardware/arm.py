"""The `ArmInterface` protocol, which the workflow uses, and the data types of its calls.

Joints are numbered from 1. Angles are sensor coordinates (the measured theta of the paper, without offsets),
continuous and never wrapped; counts are the drive's 6064h.
"""

from collections.abc import Callable, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from pathlib import Path
from typing import Protocol, Self, runtime_checkable

import numpy as np
from numpy.typing import NDArray

FloatArray = NDArray[np.float64]

SIMULATED_NAME = "sarcal virtual "
"""Prefix of the device name (1008h) of simulated nodes."""


class JointMode(Enum):
    """Control mode of a joint."""

    POSITION = "position"
    """Combined position and force loop: the joint follows its target (CiA 402 CSP, 6060h = 8)."""

    FREE = "free"
    """Force loop at zero torque: the joint follows the closed chain (CST with 6071h = 0, 6060h = 10)."""


class DriveState(Enum):
    """States of a drive, named as in CiA 402."""

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
    """Identity of a node (1000h, 1008h, 1018h)."""

    node: int
    role: str
    device_name: str
    vendor_id: int
    product_code: int
    revision: int
    serial_number: int


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmIdentity:
    """The arm as found on the bus.

    Attributes
    ----------
    serial_number
        Serial number of the supervisor, e.g. ``SDA-0007``.
    speaks
        Protocol of the arm's nodes, as text for the operator.
    by_hand
        Whether a person, not drives, moves the arm. If so, no hardware stop is required, and `ArmInterface.move` waits
        until the person has moved the joints to their targets.
    unwatching
        Joints whose drives do not monitor the operator's heartbeat, or take no action when this heartbeat is lost.
    configured, zeroed
        `configured` has a sentence for each PDO, torque or offset written into a drive. `zeroed` has only the sentences
        about torques and offsets, which were set to 0. A communication reset may fail to restore the former values.
    keeps_parameters
        Whether a controller stores a parameter document; if not, nothing is uploaded.
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
        """Whether every node identifies itself as simulated; false for an arm without nodes."""
        return bool(self.nodes) and all(
            node.device_name.startswith(SIMULATED_NAME) for node in self.nodes
        )


@dataclass(frozen=True, slots=True, kw_only=True)
class Fault:
    """A fault of a drive or of the supervisor (`joint` is None), usually reported by an emergency message.

    Code 0 means that a drive left *operation enabled*, or stopped following its target, and sent no message.
    """

    node: int
    joint: int | None
    code: int
    text: str
    sync_count: int


@dataclass(frozen=True, slots=True, kw_only=True)
class JointState:
    """State of one joint, latched on the last SYNC that the joint answered; the answer came `age_s` ago.

    `mode` is the mode that the drive reports in 6061h; None if that is neither position nor free.
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
    """Number of host latencies above the reporting limit, with the last and the longest of them, s."""

    times: int = 0
    last_s: float = 0.0
    longest_s: float = 0.0

    def with_event(self, by_s: float, *, new: bool) -> Self:
        """Return a copy with one more latency, `by_s`. If not `new`, raise the last latency to at least `by_s`."""
        last_s = by_s if new else max(by_s, self.last_s)
        longest_s = max(last_s, self.longest_s)
        return replace(self, times=self.times + new, last_s=last_s, longest_s=longest_s)


NO_LATENCY = HostLatency()


@dataclass(frozen=True, slots=True, kw_only=True)
class ArmSnapshot:
    """State of the arm at one moment.

    Attributes
    ----------
    heartbeat_age_s
        Time since each node's last heartbeat, s, by node number.
    token
        Number of the node in control; 0 if none.
    stopped, stopped_for
        Whether STOP is latched, and why; the reason is empty if a person pressed STOP.
    late_s
        Host latency, s, since the oldest joint state was received. The `age_s` of that state includes this latency.
    lateness
        Host latencies since the connection began.
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
        """Measured angles of all joints, rad, shape (n,)."""
        return np.array([joint.position_rad for joint in self.joints])

    @property
    def torques_nm(self) -> FloatArray:
        """Measured torques of all joints, N m, shape (n,)."""
        return np.array([joint.torque_nm for joint in self.joints])


@dataclass(frozen=True, slots=True, kw_only=True)
class Reading:
    """A captured pose: mean and standard deviation over samples, each latched on one SYNC; shapes (n,)."""

    mean_counts: FloatArray
    mean_rad: FloatArray
    sd_rad: FloatArray
    samples: int
    first_sync: int


@dataclass(frozen=True, slots=True, kw_only=True)
class MoveResult:
    """Result of a move; `reason`: why the move ended before the joints reached their targets."""

    reached: bool
    reason: str
    positions_rad: FloatArray
    syncs: int


@dataclass(frozen=True, slots=True, kw_only=True)
class UploadReceipt:
    """Parameters stored in the controller after an upload, as read back from it."""

    slot: str
    sha256: str
    length: int
    home_offset_counts: tuple[int, ...]


Watch = Callable[[ArmSnapshot], str | None]
"""Function called on every SYNC of a move; returns None to continue, or the reason to end the move and hold the arm."""


class ArmInterface(Protocol):
    """An arm that can be connected, moved, read and given parameters.

    Calls raise `hardware.errors.HardwareError` only. Only `stop` and `snapshot` may be called from any thread; all
    other calls must come from one thread.
    """

    def connect(self) -> ArmIdentity:
        """Find the arm's nodes, check that they agree with the arm file, and start heartbeats and SYNC."""

    def snapshot(self) -> ArmSnapshot:
        """Return the latest state; never blocks."""

    def take_control(self) -> None:
        """Take the control token and enable all drives in position mode at their current positions."""

    def set_modes(self, modes: Sequence[JointMode]) -> None:
        """Set one mode per joint; return when every drive reports the requested mode (6061h), or raise an error."""

    def move(
        self,
        targets_rad: Mapping[int, float],
        *,
        speed_rad_per_s: float,
        watch: Watch | None = None,
    ) -> MoveResult:
        """Move joints in position mode to their targets, in a straight line in joint space."""

    def settle(self, *, window: int, spread_rad: Sequence[float], timeout_syncs: int) -> bool:
        """Wait until each joint's last `window` positions span no more than `spread_rad`; false on time-out."""

    def capture(self, samples: int) -> Reading:
        """Average `samples` samples, each latched on one SYNC."""

    def hold(self) -> None:
        """Put all joints into position mode; joints that were free hold their measured positions."""

    def stop(self) -> None:
        """Send quick stop to all drives and latch STOP; waits for no lock and no queue."""

    def reset_stop(self) -> None:
        """Clear the STOP latch and the drives' faults; causes no motion, and the drives stay disabled."""

    def upload_parameters(self, document: bytes) -> UploadReceipt:
        """Stage a parameter document in the controller, read it back and commit it; the drives may be off.

        May raise `UploadRefused` with the reason. After any error but `UploadUnknown`, the previous document stays
        active.
        """

    def active_parameters(self) -> bytes:
        """Read the controller's active parameter document; empty if there is none."""

    def close(self) -> bool:
        """Hold the arm, switch its drives off, release control and stop the heartbeats. May be called twice.

        Returns true if no drive follows commands, so that the arm may be touched; false if the arm did not answer or
        a drive still follows commands.
        """


@runtime_checkable
class PowerReporting(Protocol):
    """An arm that reports, after `close`, which of its drives did not switch off."""

    @property
    def left_powered(self) -> tuple[int, ...]:
        """Joints whose drives reported power at `close`, including those that hold after STOP."""


@runtime_checkable
class Recordable(Protocol):
    """An arm that can record its bus. `record_to`: file for connections made from now on; None for no recording."""

    record_to: Path | None
