"""Effects that act along a joint, as shapes over the poses.

They are harmonics of encoders, gains and curves of analogue sensors, sides of play, and sag, in this order. A curve
depends on the corrected angle; all other shapes are constant during a fit.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.estimators.layout import Layout
from solver.estimators.load_shapes import Shapes


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointPoses:
    """Readings q (m, n), rad, with their sides of play and shapes of sag."""

    q: FloatArray
    play: Shapes
    sags: Shapes


class JointShapes:
    """Shapes of the effects of `layout` that act along a joint.

    `joint_of`: 0-based joint (c,) along which each shape acts.
    """

    def __init__(self, layout: Layout, at: JointPoses | None = None) -> None:
        self._layout = layout
        self._poses = (
            JointPoses(q=layout.q, play=layout.play, sags=layout.sags) if at is None else at
        )
        turning = np.flatnonzero(layout.accuracy)
        joints: list[int] = np.repeat(turning, 4).tolist()
        self._curves = []
        for a in layout.errors.analogue:
            if a.curve is not None:
                first = len(joints)
                joints += [a.joint - 1] * a.curve.width
                self._curves.append((a.curve, slice(first, len(joints))))
        joints += np.repeat(layout.play_joints, layout.play.width).tolist()
        if len(layout.sag_joints):
            joints += np.repeat(layout.sag_joints, layout.sags.width).tolist()
        self.joint_of: IntArray = np.array(joints, dtype=np.int64)
        self._along = np.zeros((len(joints), layout.q.shape[1]))
        self._along[np.arange(len(joints)), self.joint_of] = 1.0
        # Poses and angles of the last request, which a fit repeats, with their shapes.
        self._constant: tuple[slice, FloatArray] | None = None
        self._last: tuple[FloatArray, FloatArray] | None = None

    def at(self, angle: FloatArray, poses: slice) -> FloatArray:
        """Shapes (m, c) at the poses of a slice; `angle` (m, n): their corrected joint angles, rad."""
        if self._constant is None or self._constant[0] != poses:
            self._constant, self._last = (poses, self._constant_shapes(poses)), None
        if self._last is None or not np.array_equal(self._last[0], angle):
            shapes = self._constant[1].copy()
            for curve, where in self._curves:
                shapes[:, where] = curve.basis(angle[:, curve.joint - 1])
            self._last = (angle, shapes)
        return self._last[1]

    def shift(self, b: FloatArray, angle: FloatArray, poses: slice) -> FloatArray:
        """Joint corrections (m, n), rad, from coefficients b (c,)."""
        return np.asarray(self.at(angle, poses) @ (self._along * b[:, None]))

    def _constant_shapes(self, poses: slice) -> FloatArray:
        """Shapes (m, c); those that depend on the corrected angles (linearity deviations) are zero."""
        layout, readings = self._layout, self._poses
        turning = np.flatnonzero(layout.accuracy)
        turn = readings.q[poses, turning] if len(turning) else np.zeros((len(readings.q[poses]), 0))
        waves = np.stack((np.sin(turn), np.cos(turn), np.sin(2 * turn), np.cos(2 * turn)), axis=-1)
        m = len(turn)
        shapes = [(layout.accuracy[turning, None] * waves).reshape(m, -1)]
        shapes += [np.zeros((m, where.stop - where.start)) for _, where in self._curves]
        play = layout.play_joints
        shapes.append(
            (layout.backlash[play, None] * readings.play.columns[poses][:, play]).reshape(m, -1)
        )
        sag = layout.sag_joints
        if len(sag):
            shapes.append(
                (layout.sag[sag, None] * readings.sags.columns[poses][:, sag]).reshape(m, -1)
            )
        return np.concatenate(shapes, axis=-1)
