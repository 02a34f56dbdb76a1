"""What on the bus should end a command, in order of urgency. Pure: looks at bookkeeping, changes nothing."""

from __future__ import annotations

from hardware.errors import (
    BusError,
    CommandRefused,
    ControlDenied,
    DriveFault,
    HardwareError,
    Stopped,
)
from hardware.node_watch import NodeWatch
from hardware.objects import OPERATOR_NODE, SUPERVISOR_NODE, EmergencyCode


def find_alarm(
    nodes: NodeWatch,
    *,
    stop_latched: bool,
    lost_joints: tuple[int, ...],
    now_s: float,
    heartbeat_timeout_s: float,
    despite: tuple[type[HardwareError], ...] = (),
) -> HardwareError | None:
    """Find the first reason why nothing should move on, leaving out the kinds in `despite`."""
    if stop_latched and Stopped not in despite:
        return Stopped("STOP is latched: reset it before anything moves again")
    for fault in nodes.faults:
        if fault.node == SUPERVISOR_NODE:
            if Stopped not in despite:
                return Stopped(f"the supervisor reports: {fault.text} ({fault.code:04X}h)")
        elif fault.code == EmergencyCode.REFERENCE_LIMIT:
            if CommandRefused not in despite:
                return CommandRefused(f"joint {fault.node}: {fault.text}")
        elif DriveFault not in despite:
            return DriveFault(fault.node, fault.code, fault.text)
    if BusError not in despite:
        down = nodes.not_operational()
        if down:
            numbers = ", ".join(map(str, down))
            return BusError(
                f"Node {numbers} has left operation, as after a loss of power. Reconnect."
            )
        silence = _silence(nodes.silent(now_s, heartbeat_timeout_s), lost_joints)
        if silence is not None:
            return BusError(silence)
    if ControlDenied not in despite and nodes.other_operator(now_s, heartbeat_timeout_s):
        return ControlDenied(OPERATOR_NODE)
    return None


def _silence(nodes: tuple[int, ...], joints: tuple[int, ...]) -> str | None:
    parts = []
    if nodes:
        parts.append(f"no heartbeat from node {', '.join(map(str, nodes))}")
    if joints:
        parts.append(f"no answer to SYNC from node {', '.join(map(str, joints))}")
    if not parts:
        return None
    return f"The arm has gone silent: {' and '.join(parts)}. Check power and cable, then reconnect."
