"""Corrections of joint readings, as numbers that a controller can apply together with the identified D-H table.

True angle = reading + theta_off + the sum of a joint's corrections, each a function of the readings q:

    harmonic   c1 sin q_j + c2 cos q_j + c3 sin 2 q_j + c4 cos 2 q_j        encoder, once and twice a turn
    linearity  sum_k c_k x^k,  x = (q_j - middle) / half, |x| <= 1.2        RVDT, gain and linearity deviation
    gravity    tau_j(q; c) of `solver.chain.statics`                        twist of joint j under load
    offset     c1                                                           mean displacement due to play

In the torque tau_j, the coefficients c take the place of the masses and first moments of the links.
`sarcal help corrections` shows a function in plain Python that applies the corrections. `JointCorrections` has the
coefficients and their covariance. The fixture's deflection is not included, because it depends on the mounting.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping
from dataclasses import dataclass, replace

import numpy as np

from solver.arrays import FloatArray, IntArray, pose_slices, select_poses
from solver.chain.kinematics import forward
from solver.chain.parameters import DhKind
from solver.chain.sensors import SATURATION, WAVES, encoder_waves, powers_of
from solver.chain.statics import LinkMasses, torque_rates
from solver.estimators.linear_fit import LinearFit
from solver.estimators.load_effects import UNMODELLED_SHARE
from solver.estimators.shapes import JointShapes

LEAST_RAD = 1e-9
"""Smaller corrections are left out."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class ReadingCorrection:
    """One correction of one joint (1-based); the module's docstring describes each `kind`.

    `source`: name of the source in an uncertainty budget.
    `coefficients` (c,): rad; for gravity (4 n,): each link's mass (kg) and first moment (kg m), both multiplied by the
    joint's compliance, rad/(N m).
    `middle_rad`, `half_scale_rad`: for linearity, the sensor's electrical zero and half of its full scale.
    `down` (3,): for gravity, its direction in the base frame, or the change of this direction by a tilt of the base.
    """

    source: str
    joint: int
    kind: str
    coefficients: FloatArray
    middle_rad: float = 0.0
    half_scale_rad: float = 0.0
    down: tuple[float, ...] = ()


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Corrections:
    """All corrections of an arm.

    `each`: the individual corrections. `rows`: D-H rows 1..n (5, n), rad and m, which give the lever arms of gravity.
    """

    each: tuple[ReadingCorrection, ...]
    rows: FloatArray

    def at(self, q: FloatArray) -> FloatArray:
        """Return the corrections (..., n), rad, to be added to readings q (..., n), rad."""
        # Torques of gravity need much memory: some poses at a time.
        poses = q.reshape(-1, q.shape[-1])
        shifts = (self._at(poses[some]) for some in pose_slices(len(poses)))
        return np.concatenate((poses[:0], *shifts)).reshape(q.shape)

    def _at(self, q: FloatArray) -> FloatArray:
        total = np.zeros_like(q)
        downs = list(dict.fromkeys(c.down for c in self.each if c.kind == "gravity"))
        if downs:
            arm = forward(q + self.rows[DhKind.THETA_OFF], *self.rows[DhKind.S :])
            rates = dict(zip(downs, torque_rates(arm, np.array(downs)), strict=True))
        for c in self.each:
            own = q[..., c.joint - 1]
            if c.kind == "gravity":
                moments = c.coefficients.reshape(-1, 4)
                shift = (rates[c.down][..., c.joint - 1, :, :] * moments).sum((-1, -2))
            elif c.kind == "harmonic":
                shift = encoder_waves(own) @ c.coefficients
            elif c.kind == "linearity":
                x = np.clip((own - c.middle_rad) / c.half_scale_rad, -SATURATION, SATURATION)
                shift = np.polynomial.polynomial.polyval(x, c.coefficients)
            else:
                shift = np.full(own.shape, c.coefficients[0])
            total[..., c.joint - 1] += shift
        return total


def corrections_of(joints: JointCorrections, readings: CorrectionShapes) -> Corrections:
    """Return a fit's corrections as functions of the readings. For play they are constant: means over `readings`."""
    design = joints.fit.design
    errors, b = design.errors, joints.coefficients
    each: list[ReadingCorrection] = []
    at = 0

    def some(count: int) -> FloatArray:
        nonlocal at
        at += count
        return b[at - count : at]

    for j in np.flatnonzero(design.accuracy):
        each.append(
            ReadingCorrection(
                source="encoder_accuracy", joint=int(j) + 1, kind="harmonic",
                coefficients=design.accuracy[j] * some(WAVES),
            )
        )  # fmt: skip
    for curve in errors.curves:
        each.append(
            ReadingCorrection(
                source="rvdt", joint=curve.joint, kind="linearity",
                coefficients=powers_of(curve, some(curve.width)),
                middle_rad=curve.middle_rad, half_scale_rad=curve.half_scale_rad,
            )
        )  # fmt: skip
    first = at
    some(len(design.play.joints) * design.play.width)
    each.extend(_play(joints, readings, slice(first, at)))
    rows = np.zeros((5, design.model.joint_count))
    if errors.loads is not None and len(design.sags.joints):
        gravity = errors.loads.gravity
        rows = gravity.part.arm_rows()
        width, sagging = design.sags.width, dict[int, FloatArray]()
        for j in design.sags.joints:
            own, scale = some(width), np.sqrt(1.0 - UNMODELLED_SHARE) * design.sag[j]
            columns = gravity.turn.shape[-1]
            shapes = gravity.turn[j] @ own[:columns]
            # If both signs of sag are equally likely, the last column is the twist that is otherwise expected.
            shapes[0] += gravity.rate[j] * (1.0 if errors.signed else own[-1])
            sagging[int(j) + 1] = scale * shapes
        each.extend(_gravity(sagging, gravity.part.masses))
    noticeable = [c for c in each if np.abs(c.coefficients).max(initial=0.0) > LEAST_RAD]
    return Corrections(each=tuple(noticeable), rows=rows)


def _play(
    joints: JointCorrections, readings: CorrectionShapes, columns: slice
) -> Iterator[ReadingCorrection]:
    """Yield a constant correction for each of the `columns` of play: the mean over `readings`.

    The first correction of each joint also includes the joint's expected play.
    """
    mean = (readings.shapes[:, columns] * joints.coefficients[columns]).mean(axis=0)
    for k, j in enumerate(joints.joint_of[columns]):
        size = float(mean[k])
        if k == 0 or joints.joint_of[columns][k - 1] != j:
            size += float(readings.play[:, j].mean())
        yield ReadingCorrection(
            source="joint_play", joint=int(j) + 1, kind="offset", coefficients=np.array([size])
        )


def _gravity(sagging: Mapping[int, FloatArray], masses: LinkMasses) -> Iterator[ReadingCorrection]:
    """Yield the corrections of each joint for gravity: one for the stated direction, and one for each tilt of the base.

    `sagging`: twist (s,) of each joint (1-based), rad per N m of each of the s torques from `ArmPoses.torques`.
    """
    n, stated, sd = len(masses.mass_kg), masses.moments, masses.moments_sd
    downs = [tuple(down) for down in (masses.down.tolist(), *masses.tilted.tolist())]
    for joint, shapes in sagging.items():
        uncertain = (sd @ shapes[1 : 1 + 4 * n].reshape(n, 4, 1))[..., 0]
        tilts = (w * stated for w in shapes[1 + 4 * n :])
        for down, moments in zip(downs, (shapes[0] * stated + uncertain, *tilts), strict=True):
            yield ReadingCorrection(
                source="sag", joint=joint, kind="gravity", coefficients=moments.reshape(-1),
                down=down,
            )  # fmt: skip


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class CorrectionShapes:
    """Corrections at readings `q` (m, n), rad, as linear functions of c coefficients, one for each effect.

    `shapes` (m, c): what a coefficient of 1 adds to the correction of its joint (`JointCorrections.joint_of`), rad.
    `expected` (m, n): corrections if all coefficients are 0: the expected sag and play, rad.
    `play` (m, n): the part of `expected` due to play, rad.
    """

    q: FloatArray
    shapes: FloatArray
    expected: FloatArray
    play: FloatArray

    def first(self, count: int) -> CorrectionShapes:
        """Return the corrections at the first `count` poses."""
        return select_poses(self, slice(count), "q", "shapes", "expected", "play")


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class JointCorrections:
    """The effects of a fit that change joint angles, c in number; `fit`: the linear fit at the solution."""

    fit: LinearFit

    @property
    def joint_of(self) -> IntArray:
        """Index (c,), from 0, of the joint that each effect changes."""
        return self.fit.design.along_joints.joint_of

    @property
    def _effects(self) -> slice:
        """Slice that selects, from all effects of the fit, those that change joint angles."""
        first = len(self.fit.design.prior_index)
        return slice(first, first + len(self.joint_of))

    @property
    def coefficients(self) -> FloatArray:
        """Posterior mean (c,) of each effect's coefficient."""
        return self.fit.b[self._effects]

    def at(self, q: FloatArray) -> CorrectionShapes:
        """Return the corrections at readings q (m, n), rad, as functions of the coefficients."""
        design = self.fit.design
        errors, loads = design.errors, design.errors.loads
        errors_there = replace(
            errors,
            loads=None if loads is None else replace(loads, joints=loads.gravity.at(q)),
            # The direction of approach is unknown in advance, so the side that depends on it is zero.
            approach=None if errors.approach is None else np.zeros_like(q),
        )
        play, sags = design.play_and_sag(q, errors_there)
        along = JointShapes(q, design.accuracy, errors.curves, (play, sags))
        return CorrectionShapes(
            shapes=along.at(q, slice(0, len(q))),
            q=q,
            expected=play.expected + sags.expected,
            play=play.expected,
        )

    def with_parameters(self, index: IntArray) -> FloatArray:
        """Return the covariance (k + c, k + c) of the k parameters at `index` (rad, m), then the c `coefficients`."""
        fit, effects = self.fit, self._effects
        columns = np.arange(fit.design.flat_count, fit.design.width)[effects]
        columns = np.concatenate((fit.design.column[index], columns))
        size = np.concatenate((fit.unit[index], fit.root[effects]))
        block = fit.H_inverse[np.ix_(columns, columns)] * np.outer(size, size)
        return np.asarray(0.5 * (block + block.T))
