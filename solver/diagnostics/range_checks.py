"""Checks readings against the ranges of the arm file before anything is solved; finds wrong units and signs."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from enum import Enum
from itertools import combinations

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.poses import PoseSet
from solver.chain.sensors import Rvdt
from solver.diagnostics import limits
from solver.errors import SolverError


class ReadingFault(Enum):
    """How the readings of one joint are wrong."""

    OUTSIDE = "outside its range"
    WHOLE_TURN = "whole turns from its range"
    SATURATED = "at the end of full scale"


@dataclass(frozen=True, slots=True, kw_only=True)
class RangeFinding:
    """Readings of one joint that its sensor or its stops make impossible.

    `joint`: 1-based. `poses`: indices of the poses, the farthest outside first.
    """

    joint: int
    fault: ReadingFault
    poses: tuple[int, ...]


class ReadingsOutOfRangeError(SolverError):
    """The readings cannot be from this arm.

    `findings`: joints and poses with readings outside the range. `causes`: simple mistakes that would explain the
    readings; may be empty. `code`: code of the first cause; without a cause, ``RANGE_`` and a joint number.
    """

    def __init__(
        self,
        findings: tuple[RangeFinding, ...],
        arm: ArmModel,
        poses: PoseSet,
        causes: tuple[Mistake, ...],
    ) -> None:
        worst = max(findings, key=lambda f: len(f.poses))
        self.code = causes[0].code if causes else f"RANGE_{worst.joint}"
        joint, reading_rad = (
            arm.joints[worst.joint - 1],
            poses.q_rad[worst.poses[0], worst.joint - 1],
        )
        lower, upper = np.rad2deg((joint.lower_rad, joint.upper_rad))
        text = (
            f"joint {worst.joint} reads {np.rad2deg(reading_rad):.2f} deg in pose "
            f"{poses.label[worst.poses[0]]}, outside its range {lower:g} to {upper:g} deg "
            f"(outside in {len(worst.poses)} of {len(poses)} poses); "
        )
        text += "; or ".join(f"{m.text}: {m.remedy}" for m in causes) or (
            "check that poses and arm file belong together, and "
            f"range_deg of joint {worst.joint} in the arm file"
        )
        super().__init__(text)


@dataclass(frozen=True, slots=True, kw_only=True)
class Mistake:
    """A simple mistake that would explain the readings, and its remedy; `q_rad`: the readings without the mistake."""

    code: str
    text: str
    remedy: str
    q_rad: FloatArray


def mistakes(arm: ArmModel, q: FloatArray) -> Iterator[Mistake]:
    """Yield possible simple mistakes in readings (m, n), rad: a wrong unit or sign, whole turns, columns exchanged."""
    n, rows, columns = q.shape[1], rows_in_radians(arm, q), _like_radians(arm, q)
    # Where the readings are in radians: everywhere, in some columns, or in some rows.
    radians = [
        ("RADIANS", "", "its angles by 57.29578, or use sarcal import --rad", np.full(n, True))
    ]
    for some in dict.fromkeys((tuple(columns), *((j,) for j in columns))):
        if 0 < len(some) < n:
            code, of = "_".join(("RADIANS", *(str(j + 1) for j in some))), f" of {_joints(some)}"
            where = np.isin(np.arange(n), some)
            radians.append((code, of, f"the angles{of} by 57.29578", where))
    if 0 < len(rows) < len(q):
        of = f" of {len(rows)} of {len(q)} poses (the first is number {rows[0] + 1})"
        where = np.isin(np.arange(len(q)), rows)[:, None]
        radians.append(("RADIANS_POSES", of, "the angles of these rows by 57.29578", where))
    for code, of, factor, where in radians:
        yield Mistake(
            code=code,
            text=f"the readings{of} are in range if taken as radians",
            remedy=f"a poses file has degrees (multiply {factor})",
            q_rad=np.where(where, np.rad2deg(q), q),
        )
    middle = np.array([joint.middle_rad for joint in arm.joints])
    wrapped = q - 2.0 * np.pi * np.round((q - middle) / (2.0 * np.pi))
    if far := np.flatnonzero((np.abs(wrapped - q) > np.pi).any(axis=0)).tolist():
        yield Mistake(
            code="_".join(("WHOLE_TURNS", *(str(j + 1) for j in far))),
            text=f"the readings of {_joints(far)} are in range without whole turns",
            remedy=f"add or subtract 360 deg where a reading of {_joints(far)} is outside its range",
            q_rad=wrapped,
        )
    for j in range(n):
        # The sign is reversed about zero, or about the middle of the joint's range.
        for centre in {0.0, 2.0 * arm.joints[j].middle_rad}:
            turned = q.copy()
            turned[:, j] = centre - q[:, j]
            yield Mistake(
                code=f"SIGN_JOINT_{j + 1}",
                text=f"the readings are in range if the sign of joint {j + 1} is reversed",
                remedy=f"reverse the sign of joint {j + 1}'s sensor in its drive, or of its column",
                q_rad=turned,
            )
    for i, j in combinations(range(n), 2):
        order = np.arange(n)
        order[[i, j]] = j, i
        yield Mistake(
            code=f"EXCHANGED_{i + 1}_{j + 1}",
            text=f"the readings are in range if the columns of joints {i + 1} and {j + 1} are exchanged",
            remedy=f"exchange their columns, or the nodes of joints {i + 1} and {j + 1}",
            q_rad=q[:, order],
        )


def _joints(columns: Sequence[int]) -> str:
    return f"joint{'s' if len(columns) > 1 else ''} {', '.join(str(j + 1) for j in columns)}"


def _like_radians(arm: ArmModel, q: FloatArray) -> list[int]:
    """Return joints (0-based) whose readings are small but, taken as radians, vary and lie inside the joint's range."""
    as_degrees = np.rad2deg(q)
    inside = 10 * (_outside(arm, as_degrees) > 0.0).sum(axis=0) <= len(q)
    small = (np.abs(q) < np.deg2rad(2.0 * np.pi)).all(axis=0)
    moving = np.ptp(as_degrees, axis=0) > limits.RADIANS_SPAN_RAD
    return [int(j) for j in np.flatnonzero(inside & small & moving)]


def rows_in_radians(arm: ArmModel, q: FloatArray) -> list[int]:
    """Return the poses (0-based) in which several readings are out of range, but all are in range as radians."""
    outside = (_outside(arm, q) > 0.0).sum(axis=1) > 1
    inside = ~(_outside(arm, np.rad2deg(q)) > 0.0).any(axis=1)
    small = (np.abs(q) < np.deg2rad(2.0 * np.pi)).all(axis=1)
    return [int(k) for k in np.flatnonzero(outside & inside & small)]


def mostly_in_range(arm: ArmModel, q: FloatArray) -> bool:
    """Whether all readings lie inside their ranges in at least nine of ten poses."""
    return 10 * int((_outside(arm, q) > 0.0).any(axis=1).sum()) <= len(q)


def range_findings(
    arm: ArmModel, poses: PoseSet, *, unsensed_joints: tuple[int, ...] = ()
) -> tuple[RangeFinding, ...]:
    """Return a finding for each joint whose readings are outside its range in the arm file, or are saturated.

    Readings of `unsensed_joints` are not checked. Raises `ReadingsOutOfRangeError` if at least half of the poses have a
    reading that is far outside its range and that no wrong turn count explains.
    """
    q = poses.q_rad
    outside = _outside(arm, q)
    outside[:, [j - 1 for j in unsensed_joints]] = 0.0
    findings = []
    for j, joint in enumerate(arm.joints, 1):
        if j in unsensed_joints:
            continue
        beyond = outside[:, j - 1]
        order = np.argsort(-beyond, kind="stable")[: np.count_nonzero(beyond > 0.0)]
        fault = ReadingFault.OUTSIDE
        if len(order):
            if _whole_turns(arm, q, j):
                fault = ReadingFault.WHOLE_TURN
        elif isinstance(joint.sensor, Rvdt):
            order = _saturated_poses(q[:, j - 1], joint.middle_rad, joint.sensor)
            fault = ReadingFault.SATURATED
        if len(order):
            findings.append(RangeFinding(joint=j, fault=fault, poses=tuple(order.tolist())))
    refused = tuple(f for f in findings if f.fault is ReadingFault.OUTSIDE)
    far = outside > limits.FAR_OUT_OF_RANGE_SHARE * (arm.upper_rad - arm.lower_rad)
    far[:, [f.joint - 1 for f in findings if f.fault is ReadingFault.WHOLE_TURN]] = False
    if refused and 2 * int(far.any(axis=1).sum()) >= len(poses):
        known = {m.code: m for m in mistakes(arm, q) if mostly_in_range(arm, m.q_rad)}
        raise ReadingsOutOfRangeError(refused, arm, poses, tuple(known.values()))
    return tuple(findings)


def _outside(arm: ArmModel, q: FloatArray) -> FloatArray:
    """Distance (m, n), rad, of each reading from its range, which is widened by the sensor's error; 0 inside."""
    slack = (
        limits.RANGE_SLACK_RAD + limits.RANGE_SLACK_SIGMAS * arm.sigma_rad() + arm.linearity_rad()
    )
    beyond = np.maximum(arm.lower_rad - q, q - arm.upper_rad) - slack
    beyond[:, [j - 1 for j in arm.unsensed_joints]] = 0.0
    return np.asarray(np.maximum(beyond, 0.0))


def _whole_turns(arm: ArmModel, q: FloatArray, joint: int) -> bool:
    """Whether a wrong turn count explains why the encoder readings of `joint` (1-based) are outside its range."""
    if isinstance(arm.joints[joint - 1].sensor, Rvdt):
        return False
    middle = arm.joints[joint - 1].middle_rad
    turns = np.round((float(np.median(q[:, joint - 1])) - middle) / (2.0 * np.pi))
    shifted = q.copy()
    shifted[:, joint - 1] -= 2.0 * np.pi * turns
    return turns != 0.0 and not bool(np.any(_outside(arm, shifted)[:, joint - 1]))


def _saturated_poses(reading: FloatArray, middle_rad: float, sensor: Rvdt) -> IntArray:
    """Return the poses in which an RVDT reads one end of full scale; empty if fewer than `SATURATED_POSES` do."""
    end = 0.5 * sensor.full_scale_rad
    near = limits.SATURATED_SIGMAS * sensor.sigma_rad
    for side in (-1.0, 1.0):
        saturated = np.flatnonzero(np.abs(reading - (middle_rad + side * end)) <= near)
        if len(saturated) >= limits.SATURATED_POSES:
            return saturated
    return np.zeros(0, dtype=np.int64)
