"""Poses excluded from a fit: readings out of range, rows in radians, poses on the flipped branch."""

from __future__ import annotations

from operator_app.messages.finding import Finding, FindingKind
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.range_checks import RangeFinding, ReadingFault, rows_in_radians

MANY = 3
"""So many joints outside their ranges are a row that is wrong; fewer may be where a hand upside down led them."""


def excluded_poses(
    left_out: tuple[int, ...],
    out_of_range: tuple[RangeFinding, ...],
    arm: ArmModel,
    poses: PoseSet,
) -> tuple[Finding, ...]:
    """Return why each of the poses (indices) was left out; several for one reason in one finding."""
    joints = {
        k: [f.joint for f in out_of_range if f.fault is ReadingFault.OUTSIDE and k in f.poses]
        for k in left_out
    }
    radians = _in_radians(left_out, arm, poses)
    wrong = tuple(k for k in left_out if len(joints[k]) >= MANY and k not in radians)
    flipped = tuple(k for k in left_out if len(joints[k]) < MANY and k not in radians)
    found = []
    if radians:
        labels = tuple(poses.label[k] for k in sorted(radians))
        found.append(Finding(kind=FindingKind.POSES_IN_RADIANS, poses=labels))
    found.extend(
        Finding(
            kind=FindingKind.POSE_OUT_OF_RANGE, poses=(poses.label[k],), joints=tuple(joints[k])
        )
        for k in wrong
    )
    if flipped:
        found.append(
            Finding(
                kind=FindingKind.POSES_FLIPPED,
                poses=tuple(poses.label[k] for k in flipped),
                figures={"count": len(flipped), "of": len(poses)},
            )
        )
    return tuple(found)


def out_of_range_besides(
    left_out: tuple[int, ...],
    out_of_range: tuple[RangeFinding, ...],
    arm: ArmModel,
    poses: PoseSet,
) -> tuple[RangeFinding, ...]:
    """Joints out of their ranges in other poses than those left out for their unit."""
    radians = _in_radians(left_out, arm, poses)
    return tuple(f for f in out_of_range if not radians.issuperset(f.poses))


def _in_radians(left_out: tuple[int, ...], arm: ArmModel, poses: PoseSet) -> set[int]:
    """Which of the poses left out are rows in radians."""
    return set(rows_in_radians(arm, poses.q_rad)) & set(left_out) if left_out else set()
