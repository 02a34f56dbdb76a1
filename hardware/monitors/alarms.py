"""What on the bus should end a command, in order of urgency. Pure: looks at bookkeeping, changes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hardware.canopen.objects import OPERATOR_NODE, EmergencyCode
from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveAstray,
    DriveFault,
    DriveLeft,
    HardwareError,
    Intruder,
    NodeRestarted,
    SensorFault,
    StopLatched,
    Stopped,
    TwoDevices,
)
from hardware.monitors.continuity import Jump
from hardware.monitors.dropout import Left
from hardware.monitors.following import Astray
from hardware.monitors.node_watch import NodeWatch


@dataclass(frozen=True, slots=True, kw_only=True)
class Seen:
    """What the loop has seen beside the nodes' own words.

    Attributes
    ----------
    stop_latched
        STOP was pressed.
    lost_joints, doubled_joints
        Joints that do not answer any more, and those that answer twice.
    jump, astray
        A reading that jumped, and a joint that is not where it was told to be.
    left
        Drives that did not stay enabled, or not following, those first that may be why others did not.
    """

    stop_latched: bool
    lost_joints: tuple[int, ...] = ()
    doubled_joints: tuple[int, ...] = ()
    jump: Jump | None = None
    astray: Astray | None = None
    left: tuple[Left, ...] = ()


def find_alarm(
    nodes: NodeWatch,
    seen: Seen,
    *,
    now_s: float,
    heartbeat_timeout_s: float,
    despite: tuple[type[HardwareError], ...] = (),
) -> HardwareError | None:
    """Find the first reason why nothing should move on, leaving out the kinds in `despite`."""
    reasons = (
        *_stopped_by_itself(seen),
        *_told(nodes, seen),
        *_noticed(nodes, seen),
        *_missing(nodes, seen, now_s, heartbeat_timeout_s),
        *_not_as_put(seen),
    )
    return next((reason for reason in reasons if not isinstance(reason, despite)), None)


def pressed() -> StopLatched:
    """Say that STOP is latched."""
    return StopLatched("STOP is latched: reset it before anything moves again")


def stopped_for(astray: Astray) -> DriveAstray:
    """Say why the loop has latched STOP by itself."""
    return DriveAstray(astray.joint, astray.counts, astray.sync_count, stopped=astray.stopped)


def _stopped_by_itself(seen: Seen) -> Iterator[HardwareError]:
    """Why STOP is latched though nobody pressed it: before the words that it is."""
    if seen.astray is not None:
        yield stopped_for(seen.astray)


def _told(nodes: NodeWatch, seen: Seen) -> Iterator[HardwareError]:
    """What somebody said: the operator, the supervisor, a drive."""
    if seen.stop_latched:
        yield pressed()
    for fault in nodes.faults:
        if fault.joint is None:
            yield Stopped(f"the supervisor reports: {fault.text} ({fault.code:04X}h)")
        elif fault.code == EmergencyCode.REFERENCE_LIMIT:
            yield CommandRefused(f"joint {fault.joint}: {fault.text}")
        else:
            yield DriveFault(fault.joint, fault.code, fault.text)


def _noticed(nodes: NodeWatch, seen: Seen) -> Iterator[HardwareError]:
    """What nobody says of himself; who made nodes leave operation before that they have."""
    if nodes.intrusion:
        yield Intruder(
            f"Somebody else commands this arm: {nodes.intrusion} came from another program on the bus. "
            "End that program, look at what it did, then connect again."
        )
    down = nodes.not_operational()
    if down:
        numbers = ", ".join(map(str, down))
        yield BusError(f"Node {numbers} has left operation, as after a loss of power. Reconnect.")
    if nodes.restarted:
        restarted = tuple(sorted(nodes.restarted))
        yield NodeRestarted(restarted, [nodes.profile.who(node) for node in restarted])
    if seen.doubled_joints:
        yield TwoDevices(tuple(nodes.profile.drives[j - 1] for j in seen.doubled_joints))
    if seen.jump is not None:
        yield SensorFault(
            seen.jump.joint,
            f"jumped by {seen.jump.counts:+d} counts between two SYNCs, and no other joint moved with it: "
            "it has lost counts, or its coupling slipped. No pose was captured since",
            since_sync=seen.jump.sync_count,
        )


def _missing(
    nodes: NodeWatch, seen: Seen, now_s: float, heartbeat_timeout_s: float
) -> Iterator[HardwareError]:
    """Who is not there as he should be, and who is there that should not."""
    drives = nodes.profile.drives
    silence = _silence(
        nodes.silent(now_s, heartbeat_timeout_s), tuple(drives[j - 1] for j in seen.lost_joints)
    )
    if silence is not None:
        yield BusError(silence)
    if nodes.other_operator(now_s, heartbeat_timeout_s):
        yield ControlDenied(OPERATOR_NODE)


def _not_as_put(seen: Seen) -> Iterator[HardwareError]:
    """Which drives did not stay enabled and following: after all that may be why."""
    for left in seen.left:
        yield DriveLeft(left.joint, left.state.value, deaf=left.deaf)


def _silence(nodes: tuple[int, ...], drives: tuple[int, ...]) -> str | None:
    parts = []
    if nodes:
        parts.append(f"no heartbeat from node {', '.join(map(str, nodes))}")
    if drives:
        parts.append(f"no answer to SYNC from node {', '.join(map(str, drives))}")
    if not parts:
        return None
    return f"The arm has gone silent: {' and '.join(parts)}. Check power and cable, then reconnect."
