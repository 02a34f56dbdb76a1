"""Alarms that end a command, in order of priority. Reads the monitors' state and changes nothing."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass

from hardware.canopen.objects import OPERATOR_NODE, EmergencyCode
from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveDiverged,
    DriveDropout,
    DriveFault,
    DuplicateNodeId,
    HardwareError,
    NodeRestarted,
    OtherMaster,
    SensorFault,
    StopLatched,
    Stopped,
)
from hardware.monitors.continuity import CountJump
from hardware.monitors.dropout import Dropout
from hardware.monitors.following import Divergence
from hardware.monitors.node_monitor import NodeMonitor


@dataclass(frozen=True, slots=True, kw_only=True)
class Observations:
    """What the control loop observed in the samples.

    Attributes
    ----------
    stop_latched
        STOP is latched.
    lost_joints, duplicate_joints
        Joints without answers to SYNC, and joints with two answers to each.
    jump, divergence
        The first count jump and the first uncommanded motion, if any.
    dropouts
        Drives that left *operation enabled* or stopped following, the most likely cause first.
    """

    stop_latched: bool
    lost_joints: tuple[int, ...] = ()
    duplicate_joints: tuple[int, ...] = ()
    jump: CountJump | None = None
    divergence: Divergence | None = None
    dropouts: tuple[Dropout, ...] = ()


def find_alarm(
    nodes: NodeMonitor,
    observed: Observations,
    *,
    now_s: float,
    heartbeat_timeout_s: float,
    despite: tuple[type[HardwareError], ...] = (),
) -> HardwareError | None:
    """Return the alarm of highest priority, without the types in `despite`; None if there is none."""
    found = _alarms(nodes, observed, now_s, heartbeat_timeout_s)
    return next((alarm for alarm in found if not isinstance(alarm, despite)), None)


def stop_latched_error() -> StopLatched:
    """Error for a latched STOP."""
    return StopLatched("STOP is latched: reset it before anything moves again")


def divergence_error(found: Divergence) -> DriveDiverged:
    """Error for the divergence for which the control loop latched STOP itself."""
    return DriveDiverged(found.joint, found.counts, found.sync_count, stopped=found.stopped)


def _alarms(
    nodes: NodeMonitor, observed: Observations, now_s: float, heartbeat_timeout_s: float
) -> Iterator[HardwareError]:
    """All alarms, highest priority first."""
    if observed.divergence is not None:  # the cause of a STOP comes before the STOP
        yield divergence_error(observed.divergence)
    if observed.stop_latched:
        yield stop_latched_error()
    for fault in nodes.faults:
        if fault.joint is None:
            yield Stopped(f"the supervisor reports: {fault.text} ({fault.code:04X}h)")
        elif fault.code == EmergencyCode.REFERENCE_LIMIT:
            yield CommandRefused(f"joint {fault.joint}: {fault.text}")
        else:
            yield DriveFault(fault.joint, fault.code, fault.text)
    if nodes.foreign_command:  # before the NMT states, which that program may have changed
        yield OtherMaster(
            f"Somebody else commands this arm: {nodes.foreign_command} came from another program on the "
            "bus. End that program, check what it changed, then connect again."
        )
    down = nodes.not_operational()
    if down:
        numbers = ", ".join(map(str, down))
        yield BusError(f"Node {numbers} has left operation, as after a loss of power. Reconnect.")
    if nodes.restarted:
        restarted = tuple(sorted(nodes.restarted))
        yield NodeRestarted(restarted, [nodes.profile.who(node) for node in restarted])
    drives = nodes.profile.drives
    if observed.duplicate_joints:
        yield DuplicateNodeId(tuple(drives[j - 1] for j in observed.duplicate_joints))
    if observed.jump is not None:
        yield SensorFault(
            observed.jump.joint,
            f"jumped by {observed.jump.counts:+d} counts between two SYNCs, and no other joint moved: "
            "its sensor lost counts, or its coupling slipped. No pose was captured since",
            since_sync=observed.jump.sync_count,
        )
    silence = _silence(
        nodes.silent(now_s, heartbeat_timeout_s), tuple(drives[j - 1] for j in observed.lost_joints)
    )
    if silence is not None:
        yield BusError(silence)
    if nodes.other_operator(now_s, heartbeat_timeout_s):
        yield ControlDenied(OPERATOR_NODE)
    for each in observed.dropouts:  # last: all of the above may be the cause
        yield DriveDropout(each.joint, each.state.value, not_following=each.not_following)


def _silence(nodes: tuple[int, ...], drives: tuple[int, ...]) -> str | None:
    parts = []
    if nodes:
        parts.append(f"no heartbeat from node {', '.join(map(str, nodes))}")
    if drives:
        parts.append(f"no answer to SYNC from node {', '.join(map(str, drives))}")
    if not parts:
        return None
    return f"The arm has gone silent: {' and '.join(parts)}. Check power and cable, then reconnect."
