"""Poses that were left out of a fit, and why: readings that no joint can have, or the hand upside down.

A row that is wrong closes no loop either way: what its readings are comes first. Knows ranges and poses; no fit.
"""

from __future__ import annotations

from operator_app.calibration.causes import Words, poses_named
from operator_app.units.numbers import names
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.diagnostics.range_checks import RangeFinding, ReadingFault, rows_in_radians

MANY = 3
"""So many joints outside their ranges are a row that is wrong; fewer may be where a hand upside down led them."""


def left_out_in_words(
    left_out: tuple[int, ...],
    out_of_range: tuple[RangeFinding, ...],
    arm: ArmModel,
    poses: PoseSet,
) -> tuple[Words, ...]:
    """Say why each of the poses (indices) was left out; several for one reason in one sentence."""
    joints = {
        k: [f.joint for f in out_of_range if f.fault is ReadingFault.OUTSIDE and k in f.poses]
        for k in left_out
    }
    radians = _in_radians(left_out, arm, poses)
    wrong = tuple(k for k in left_out if len(joints[k]) >= MANY and k not in radians)
    flipped = tuple(k for k in left_out if len(joints[k]) < MANY and k not in radians)
    found = []
    if radians:
        rows = tuple(sorted(radians))
        s, were, are = _of(rows)
        found.append(
            Words(
                "RANGE_RADIANS",
                f"{poses_named(rows, poses.label)} {are} in radians, which as degrees lie outside the arm's ranges, "
                f"and {were} left out",
                f"multiply the angles of {'these rows' if s else 'this row'} by 57.29578",
            )
        )
    found.extend(
        Words(
            "RANGE_POSE",
            f"pose {poses.label[k]} was left out: joints {names(joints[k])} are outside their ranges in it",
            "correct that row, take the pose again or remove it",
        )
        for k in wrong
    )
    if flipped:
        s, were, _ = _of(flipped)
        them = "them" if s else "it"
        found.append(
            Words(
                "FLIPPED_BRANCH",
                f"{poses_named(flipped, poses.label)} ({len(flipped)} of {len(poses)}) "
                f"close{'' if s else 's'} only with the hand upside down on the hinge and {were} left out",
                f"take {them} again with the hand the right way up, or remove {them}",
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


def _of(rows: tuple[int, ...]) -> tuple[bool, str, str]:
    several = len(rows) > 1
    return several, "were" if several else "was", "are" if several else "is"
