"""Columns of effects, with one value per pose: errors of sensors, sides of play, sag and deflection.

Sag follows gravity (`solver.estimators.load_effects`). The columns' coefficients are ~ N(0, 1). The part of a stated
variance that the columns leave out is noise, independent from pose to pose.

The smooth functions are a low-rank Gaussian process over joint space, with several length scales and a linear part. The
values of the process at all poses are ``Phi b`` with b ~ N(0, I); ``Phi`` (m, k) is computed from poses far apart
(Nystroem), so the cost is proportional to the number of poses and not to its square.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray, IntArray, pose_slices
from solver.chain.sensors import WAVES, SensorCurve, encoder_waves
from solver.estimators.error_model import ErrorModel
from solver.estimators.load_effects import UNMODELLED_SHARE, farthest

BY_APPROACH = 0.5
"""Probability that the direction of approach determines the side of a joint's play; otherwise the load does."""

CENTRES = 64
"""Number of poses, chosen far apart, from which the others are interpolated."""

SCALES_RAD = (np.deg2rad(60.0), np.deg2rad(120.0))
WEIGHTS = (0.5, 0.5)
"""Length scales of the smooth functions, and the share of the variance at each of them."""

CONSTANT, LINEAR = 0.5, 0.5
"""Variances of the process's constant and linear parts, in addition to the variance at the length scales."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class PoseBasis:
    """A smooth random function of the pose: sum of k columns with coefficients ~ N(0, 1).

    `phi` (m, k): values of the columns. `missed` (m,): part of the function's variance that the sum leaves out.
    """

    phi: FloatArray
    missed: FloatArray


def pose_process(q: FloatArray, columns: int, *, group: IntArray | None = None) -> PoseBasis:
    """Return a smooth random function of joint angles `q` (m, n), rad; each placement in `group` (m,) has its own.

    `columns`: largest number of columns; they are orthogonal, and those of largest variance are kept.
    """
    spread = np.maximum(q.std(axis=0), 1e-9)
    moving = np.ptp(q, axis=0) > np.deg2rad(0.5)
    angle = q[:, moving]
    linear = (angle - angle.mean(axis=0)) / (spread[moving] * np.sqrt(max(1, moving.sum())))
    group = np.zeros(len(q), dtype=np.int64) if group is None else group
    far = farthest(np.column_stack((angle, 10.0 * group)), CENTRES)

    def kernel(one: IntArray | slice, two: IntArray) -> FloatArray:
        a, b = angle[one], angle[two]
        d2 = np.maximum((a**2).sum(-1)[:, None] + (b**2).sum(-1)[None, :] - 2.0 * (a @ b.T), 0.0)
        k = CONSTANT + LINEAR * (linear[one] @ linear[two].T)
        for scale, weight in zip(SCALES_RAD, WEIGHTS, strict=True):
            k = k + weight * np.exp(-0.5 * d2 / scale**2)
        return np.asarray(k * (group[one][:, None] == group[two][None, :]))

    values, vectors = np.linalg.eigh(kernel(far, far))
    good = values > 1e-8 * values[-1]
    if len(far) == len(q):
        # Every pose is a centre: the columns are orthogonal already.
        values_at_poses = vectors[:, good] * np.sqrt(values[good])
        turn = np.eye(values_at_poses.shape[1])
    else:
        root = vectors[:, good] / np.sqrt(values[good])
        values_at_poses = np.concatenate([kernel(cut, far) @ root for cut in pose_slices(len(q))])
        turn = np.linalg.eigh(values_at_poses.T @ values_at_poses)[1]
    phi = values_at_poses @ turn[:, ::-1][:, :columns]
    variance = CONSTANT + sum(WEIGHTS) + LINEAR * (linear**2).sum(-1)
    return PoseBasis(phi=phi, missed=np.maximum(variance - (phi**2).sum(-1), 0.0))


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Shapes:
    """An effect that repeats at the same pose: the play, or the sag, of d of the n joints.

    `joints` (d,): indices, from 0, of the d joints. `expected` (m, n): expected value of play or sag, rad.
    `columns` (m, d, c), rad: c columns for each of these joints. A coefficient of 1 adds its column to `expected`.
    `missed` (m, n): part of the variance that the columns leave out, rad^2.
    """

    joints: IntArray
    columns: FloatArray
    missed: FloatArray
    expected: FloatArray

    @classmethod
    def of(
        cls, sd_rad: FloatArray, columns: FloatArray, missed: FloatArray, expected: FloatArray
    ) -> Shapes:
        """Return the effect for the joints whose standard deviation of play or sag, `sd_rad` (n,), is not 0.

        `columns` (m, n, c) and `expected` (m, n) are in units of `sd_rad`. `missed` (m, n) is in units of its square.
        """
        joints = np.flatnonzero(sd_rad)
        return cls(
            joints=joints,
            columns=sd_rad[joints, None] * columns[:, joints],
            missed=sd_rad**2 * missed,
            expected=sd_rad * expected,
        )

    @property
    def width(self) -> int:
        """Number c of columns for each joint."""
        return int(self.columns.shape[-1])


def sides_of_play(q: FloatArray, errors: ErrorModel, sd_rad: FloatArray) -> Shapes:
    """Return the effect of play: a column for the side of the load, and one for the side of the approach if known.

    The side, 1 or -1, is where the link rests in its play. With probability p = 1 - `BY_APPROACH`, the load (gravity)
    determines it. Otherwise the direction of approach does; either link or drive may lead, so both sides are equally
    likely. Hence, in units of `sd_rad`, the expected value is p times the side of the load, with a variance of 1 - p^2.
    It is 0 if the side of the load is unknown (no loads, or `errors.signed` is False).

    `sd_rad` (n,): standard deviation of each joint's play. `q` (m, n): readings, rad.
    """
    by_load = np.zeros_like(q) if errors.loads is None else errors.loads.joints.side
    expected = (1.0 - BY_APPROACH if errors.signed else 0.0) * by_load
    shares, sides = [1.0], [by_load]
    if errors.approach is not None:
        shares, sides = [1.0 - BY_APPROACH, BY_APPROACH], [by_load, errors.approach]
    if errors.signed:
        shares[0] -= (1.0 - BY_APPROACH) ** 2
    columns = np.sqrt(shares) * np.stack(sides, axis=-1)
    return Shapes.of(sd_rad, columns, 1.0 - (columns**2).sum(-1) - expected**2, expected)


def shapes_of_sag(q: FloatArray, errors: ErrorModel, sd_rad: FloatArray) -> Shapes:
    """Return the effect of every joint's twist under gravity; without loads, no joint sags.

    `sd_rad` (n,): standard deviation of each joint's sag. `q` (m, n): readings, rad.
    """
    nothing = np.zeros_like(q)
    if errors.loads is None:
        return Shapes.of(np.zeros_like(sd_rad), nothing[..., None], nothing, nothing)
    loads = errors.loads.joints
    columns, expected = loads.columns, loads.expected
    if not errors.signed:
        # With the expected value as a further column, the second moments about zero stay the same.
        columns, expected = np.concatenate((columns, expected[..., None]), axis=-1), nothing
    modelled = np.sqrt(1.0 - UNMODELLED_SHARE)
    missed = (1.0 - UNMODELLED_SHARE) * loads.missed + UNMODELLED_SHARE
    return Shapes.of(sd_rad, modelled * columns, missed, modelled * expected)


class JointShapes:
    """The columns of the effects that change joint angles (c of them), for poses with readings `q` (m, n), rad.

    The first columns are harmonics of encoders, with standard deviations `accuracy_rad` (n,).
    Next are gain and linearity deviation of analogue sensors (`curves`), at corrected angles, which change in a fit.
    The last are play and sag (`effects`). `joint_of` (c,): index, from 0, of the joint that each column changes.
    """

    def __init__(
        self,
        q: FloatArray,
        accuracy_rad: FloatArray,
        curves: Sequence[SensorCurve],
        effects: Sequence[Shapes],
    ) -> None:
        turning = np.flatnonzero(accuracy_rad)
        self._q, self._turning, self._accuracy_rad = q, turning, accuracy_rad[turning, None]
        self._effects = effects
        joints = np.repeat(turning, WAVES).tolist()
        self._curves = []
        for curve in curves:
            self._curves.append((curve, slice(len(joints), len(joints) + curve.width)))
            joints += [curve.joint - 1] * curve.width
        for effect in effects:
            joints += np.repeat(effect.joints, effect.width).tolist()
        self.joint_of: IntArray = np.array(joints, dtype=np.int64)
        self._along = np.zeros((len(joints), q.shape[1]))
        self._along[np.arange(len(joints)), self.joint_of] = 1.0
        # Poses and angles of the last request, which a fit repeats, with their shapes.
        self._constant: tuple[slice, FloatArray] | None = None
        self._last: tuple[FloatArray, FloatArray] | None = None

    def at(self, angle: FloatArray, poses: slice) -> FloatArray:
        """Return the columns (m, c) for a slice `poses`, at corrected joint angles `angle` (m, n), rad."""
        if self._constant is None or self._constant[0] != poses:
            self._constant, self._last = (poses, self._constant_shapes(poses)), None
        if self._last is None or not np.array_equal(self._last[0], angle):
            shapes = self._constant[1].copy()
            for curve, where in self._curves:
                shapes[:, where] = curve.basis(angle[:, curve.joint - 1])
            self._last = (angle, shapes)
        return self._last[1]

    def shift(self, b: FloatArray, angle: FloatArray, poses: slice) -> FloatArray:
        """Return the joint corrections (m, n), rad, for coefficients `b` (c,) of the columns that `at` returns."""
        return np.asarray(self.at(angle, poses) @ (self._along * b[:, None]))

    def _constant_shapes(self, poses: slice) -> FloatArray:
        """Return the columns (m, c); those that depend on corrected angles (analogue sensors) are left at zero."""
        turn = self._q[poses, self._turning]
        m = len(turn)
        shapes = [(self._accuracy_rad * encoder_waves(turn)).reshape(m, -1)]
        shapes += [np.zeros((m, curve.width)) for curve, _ in self._curves]
        shapes += [effect.columns[poses].reshape(m, -1) for effect in self._effects]
        return np.concatenate(shapes, axis=-1)
