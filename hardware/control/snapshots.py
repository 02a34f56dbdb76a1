"""Builds the immutable snapshot of the arm from what the loop has last published. Knows no bus."""

from __future__ import annotations

from collections.abc import Sequence
from types import MappingProxyType

from hardware.arm import ArmSnapshot, Fault, JointMode, JointState
from hardware.canopen.cia402 import state_of
from hardware.control.sampling import CyclicView
from hardware.monitors.dropout import Dropout
from hardware.monitors.latency import LatencyMonitor
from hardware.monitors.node_monitor import NodeMonitor
from hardware.scale import JointScale


def build_snapshot(
    view: CyclicView,
    nodes: NodeMonitor,
    left: Sequence[Dropout],
    *,
    scales: Sequence[JointScale],
    rated_torques_nm: Sequence[float],
    modes: Sequence[JointMode | None],
    token: int,
    stopped: bool,
    stopped_for: str,
    moving: bool,
    period_s: float,
    now_s: float,
    latency: LatencyMonitor,
) -> ArmSnapshot:
    """Snapshot at a time. Speeds are means over the last few control periods."""
    listened_s = latency.listened_s
    sample, earlier = view.sample, view.earlier
    elapsed_s = (sample.sync_count - earlier.sync_count) * period_s
    joints = tuple(
        JointState(
            joint=joint + 1,
            position_counts=counts,
            position_rad=scale.to_rad(counts),
            speed_rad_per_s=(
                (counts - earlier.counts[joint]) / scale.counts_per_rad / elapsed_s
                if elapsed_s > 0.0
                else 0.0
            ),
            torque_nm=sample.torques_per_mille[joint] * 1e-3 * rated_torques_nm[joint],
            drive=state_of(sample.statuswords[joint]),
            mode=modes[joint],
            age_s=now_s - view.answered_at_s[joint],
        )
        for joint, (scale, counts) in enumerate(zip(scales, sample.counts, strict=True))
    )
    return ArmSnapshot(
        sync_count=sample.sync_count,
        joints=joints,
        late_s=max(0.0, latency.late_s - min(view.late_at_s, default=0.0)),
        heartbeat_age_s=MappingProxyType(
            {node: listened_s - heard for node, heard in dict(nodes.heard_at_s).items()}
        ),
        token=token,
        faults=nodes.faults or tuple(_fault(nodes, each) for each in left),
        stopped=stopped,
        stopped_for=stopped_for,
        moving=moving,
        lateness=latency.lateness,
    )


def _fault(nodes: NodeMonitor, left: Dropout) -> Fault:
    """What is known where no emergency says why."""
    return Fault(
        node=nodes.profile.drives[left.joint - 1],
        joint=left.joint,
        code=0,
        text="the drive does not follow its target"
        if left.not_following
        else f"the drive is in {left.state.value}",
        sync_count=left.sync_count,
    )
