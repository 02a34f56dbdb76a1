"""Alarms that end a command, in order of priority."""

from collections.abc import Iterator, Sequence

from hardware import errors
from hardware.canopen.cia402 import FAULT_STATES, conditions
from hardware.canopen.objects import OPERATOR_NODE, EmergencyCode
from hardware.control.sampling import Sampler
from hardware.monitors.following import Divergence
from hardware.monitors.joint_monitor import JointMonitor
from hardware.monitors.node_monitor import NodeMonitor


def stop_error(cause: Divergence | None) -> errors.HardwareError:
    """Return the error for a latched STOP; `cause` is the uncommanded motion that caused STOP, or None."""
    if cause is None:
        return errors.StopLatched("STOP is latched: reset it before anything moves again")
    return errors.DriveDiverged(
        cause.joint,
        cause.counts,
        cause.sync_count,
        stopped=cause.stopped,
        angle_rad=cause.angle_rad,
    )


def _nodes(numbers: Sequence[int]) -> str:
    return f"node{'s' if len(numbers) > 1 else ''} {', '.join(map(str, numbers))}"


def alarms(
    nodes: NodeMonitor, watch: JointMonitor, sampler: Sampler, *, stop_latched: bool
) -> Iterator[errors.HardwareError]:
    """Yield all alarms, highest priority first."""
    tripped_joints = sampler.view.sample.joints_in(FAULT_STATES)
    if watch.divergence is not None:  # the cause of a STOP comes before the STOP
        yield stop_error(watch.divergence)
    if stop_latched:
        yield stop_error(None)
    for fault in nodes.faults:
        if fault.joint is None:
            yield errors.Stopped(f"the supervisor reports: {fault.text} ({fault.code:04X}h)")
        elif fault.code == EmergencyCode.REFERENCE_LIMIT:
            yield errors.TargetRefused(f"joint {fault.joint}: {fault.text}")
        else:
            tripped = fault.joint in tripped_joints
            yield errors.DriveFault(fault.joint, fault.code, fault.text, tripped=tripped)
    if nodes.foreign_command:  # before the NMT states, which that program may have changed
        yield errors.OtherMaster(
            f"Another program commands this arm: it sent {nodes.foreign_command}. End that program, check what it "
            "changed, then connect again."
        )
    if down := nodes.not_operational():
        has = "has" if len(down) == 1 else "have"
        yield errors.BusError(
            f"{_nodes(down).capitalize()} {has} left operation, as after a loss of power"
        )
    if nodes.restarted:
        restarted = tuple(sorted(nodes.restarted))
        yield errors.NodeRestarted(restarted, [nodes.profile.who(node) for node in restarted])
    drives = nodes.profile.drives
    if duplicates := sampler.duplicates():
        yield errors.DuplicateNodeId(tuple(drives[j - 1] for j in duplicates))
    if watch.jump is not None:
        yield errors.SensorFault(
            watch.jump.joint,
            f"jumped by {watch.jump.counts:+d} counts between two SYNCs, and no other joint moved: "
            "its sensor lost counts, or its coupling slipped. No pose has been captured since",
            since_sync=watch.jump.sync_count,
        )
    yield from _silence(nodes, sampler)
    if nodes.other_operator(nodes.heartbeat_timeout_s):
        yield errors.ControlDenied(OPERATOR_NODE)
    for each in watch.dropout.dropouts:  # last: all of the above may be the cause
        yield errors.DriveDropout(
            each.joint,
            each.state.value,
            not_following=each.not_following,
            conditions=conditions(each.status),
        )


def _silence(nodes: NodeMonitor, sampler: Sampler) -> Iterator[errors.BusError]:
    drives, lost_joints = nodes.profile.drives, sampler.lost()
    wrong_lengths = sampler.wrong_lengths()
    if wrong := [
        f"node {drives[j - 1]}: {wrong_lengths[j]}" for j in lost_joints if j in wrong_lengths
    ]:
        yield errors.BusError(
            f"Answers to SYNC are not as the bus profile states: {'; '.join(wrong)}. Compare the drive's map with "
            "the profile (`sarcal probe`); if they agree, its maker must find out why it sends something else."
        )
    unanswered = tuple(drives[j - 1] for j in lost_joints if j not in wrong_lengths)
    silent = (("no heartbeat from", nodes.silent()), ("no answer to SYNC from", unanswered))
    if silence := " and ".join(f"{what} {_nodes(numbers)}" for what, numbers in silent if numbers):
        yield errors.BusError(f"The arm has gone silent: {silence}")
