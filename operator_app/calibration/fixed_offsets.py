"""Joint offsets that a calibration did not look for: what the hand's accuracy then holds for. Knows no file.

A procedure holds an offset, or it is dropped as unseen: it stays as the arm's file has it. What it is off
moves the hand by itself and by what the other parameters took over of it in the loops.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from operator_app.calibration.calibrated_arm import CalibratedArm, even_poses, with_entries
from operator_app.calibration.tool_accuracy import HandAccuracy, HeldOffset, spread_of
from solver.arrays import FloatArray
from solver.chain.arm_model import ArmModel
from solver.chain.parameters import DhEntry, DhKind
from solver.chain.sensors import NoSensor
from solver.estimators.linear_fit import LinearFit
from solver.loops.closure import ClosureModel

STEP_RAD = 1e-4
"""Of the differences that give rates."""

NOTHING = 2e-3
"""Rate (m/rad) of the hand below which an offset does not matter to it: 0.03 mm a degree."""


def offsets_not_sought(model: ClosureModel, arm: ArmModel) -> tuple[int, ...]:
    """Joints (1-based) that are read and whose offset is no parameter of a loop."""
    sought = {p.name.partition("[")[0] for p in model.parameters}
    return tuple(
        j
        for j, joint in enumerate(arm.joints, 1)
        if DhEntry(DhKind.THETA_OFF, j).name not in sought
        and j not in model.unsensed_joints
        and not isinstance(joint.sensor, NoSensor)
    )


def with_held(
    accuracy: HandAccuracy, after_m: FloatArray, found: CalibratedArm, arm: ArmModel, fit: LinearFit
) -> HandAccuracy:
    """Return the accuracy with what is known of offsets that were not sought, and of which nothing is.

    Parameters
    ----------
    after_m
        One standard deviation of the hand (m,) at `even_poses` without that.
    fit
        The calibration at its last linearisation.
    """
    model = fit.design.model
    joints = offsets_not_sought(model, arm)
    if not joints:
        return accuracy
    q = even_poses(arm)
    names, known, held = [p.name for p in model.parameters], arm.offset_tolerance_rad, []
    square = after_m**2
    B = fit.whole.B
    for j in joints:
        taken_over = dict(zip(names, fit.moved_by(B[..., [j - 1]])[:, 0].tolist(), strict=True))
        rate = _rate(found, j, taken_over, q)
        if known is not None:
            square = square + (known * rate) ** 2
        elif (rms := spread_of(rate).rms) > NOTHING:
            name = DhEntry(DhKind.THETA_OFF, j).name
            value = float(arm.table.theta_off_rad[j - 1])
            held.append(HeldOffset(name=name, value_rad=value, rate_m_per_rad=rms))
    return replace(accuracy, after=spread_of(np.sqrt(square)), holds_for=tuple(held))


def _rate(
    found: CalibratedArm, joint: int, taken_over: dict[str, float], q: FloatArray
) -> FloatArray:
    """How far the hand moves with an offset (m/rad) at readings `q`, the others following it: (m,)."""
    moved = {name.partition("[")[0]: rate for name, rate in reversed(taken_over.items())}
    rows = found.hand.stacked()
    offset = DhEntry(DhKind.THETA_OFF, joint)
    changes = {offset.name: 1.0} | {e: moved.get(e, 0.0) for e in found.entries}
    places = []
    for step in (-STEP_RAD, STEP_RAD):
        values = {}
        for name, rate in changes.items():
            entry = DhEntry.parse(name)
            values[name] = float(rows[entry.kind, entry.row - 1]) + step * rate
        tip = [moved.get(name, 0.0) for name in ("tip_x", "tip_y", "tip_z")]
        there = replace(
            found,
            hand=with_entries(found.hand, values),
            best=None,
            tip_m=found.tip_m + step * np.array(tip),
        )
        places.append(there.T_base(q)[:, :3, 3])
    return np.asarray(np.linalg.norm(places[1] - places[0], axis=-1) / (2.0 * STEP_RAD))
