"""Possible faults of arm, fixture and readings, and their models: further columns of the linear fit.

A column holds the derivatives of the misclosures with respect to a quantity that the fit took as exact. With these
columns, faults can be compared without a refit.
"""

from __future__ import annotations

from collections.abc import Iterator, Mapping, Sequence
from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.chain.arm_model import ArmModel
from solver.chain.sensors import Encoder, Rvdt, SensorCurve, encoder_waves
from solver.diagnostics.limits import CERTAIN_SIGMAS, FROZEN_POSES, OTHERS_MOVED_RAD
from solver.estimators.linear_fit import LinearFit
from solver.estimators.shapes import pose_process


class Cause(Enum):
    """Kind of fault; `prior`: its prior probability, divided equally among the candidates of this kind."""

    SLIPPED = ("slipped", 0.02)
    LOST_COUNTS = ("lost counts", 0.02)
    OUTLIERS = ("outliers", 0.02)
    FROZEN = ("frozen", 0.01)
    READING = ("reading", 0.01)
    CURVE = ("curve", 0.02)
    LENGTH = ("length", 0.02)
    TWIST = ("twist", 0.01)
    GIVES = ("gives", 0.01)
    TURN_ERROR = ("once-per-turn error", 0.005)
    SAG = ("sag", 0.003)
    SCATTER = ("scatter of all readings", 0.005)
    DRIFT = ("drift", 0.001)
    SCALE = ("scale of an encoder", 0.003)
    LENGTH_CHANGED = ("length changed", 2e-5)

    def __init__(self, kind: str, prior: float) -> None:
        self.kind, self.prior = kind, prior


class PeakDeviation(NamedTuple):
    """A sensor's largest deviation and its sigma, rad: from the best-fit line if `from_line`, else from the angle."""

    peak: float
    sd: float
    from_line: bool

    def beyond(self, stated: float) -> bool:
        """Whether `peak` certainly exceeds `stated`: by more than `CERTAIN_SIGMAS` standard deviations."""
        return self.peak - CERTAIN_SIGMAS * self.sd > stated


SAG_COLUMNS = 8
"""Number of smooth functions of the pose that describe the faulty sag of a joint."""

LENGTHS_SHARE = 0.1
"""False-alarm probability of the step test of a length, relative to that of other suspects. It is small because a metal
link hardly ever changes its length during a session."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """One possible cause of misclosures, described by c coefficients that a fit to m poses can determine.

    `subject`: the joint, arm file entry or half of the fixture that is concerned.
    `columns` (m, r, c): derivatives of the r misclosures of each pose with respect to the coefficients.
    `expected_size` (c,): expected magnitudes of the coefficients.
    `own` (p,): None if the same c coefficients apply to all poses. Otherwise, each of p poses has c coefficients of its
    own, `own` are the indices of these poses, `columns` is (p, r, c), and `expected_size` is (p * c,).
    `places`: number of places (e.g. poses) at which the fault may be; the prior probability is divided by it.
    `poses`: poses concerned, indices in time order; empty if all poses are concerned.
    `most`: largest credible magnitude (rms) of the coefficients, in units of `expected_size`.
    `shapes` (m, c): coefficients b change the readings by the deviation ``shapes @ b``, rad; None: b is the deviation.
    `most_stated`: limit that the files state for the deviation, or 0. A deviation counts as a cause only if it exceeds
    the limit by more than `CERTAIN_SIGMAS` of its standard deviations.
    `least`: smallest deviation (rms) that counts as a cause if the files state no limit.
    `measured`: linearity deviation of the sensor as measured by loops that do not use its readings; None if unknown.
    `lines` (m, 2): orthonormal basis of the straight lines over the readings, i.e. of an offset and a gain error.
    `entries`: for a slip of the fixture or a changed length, the parameter that each column changes; otherwise empty.
    """

    cause: Cause
    subject: str
    columns: FloatArray
    expected_size: FloatArray
    own: IntArray | None = None
    places: int = 1
    poses: tuple[int, ...] = ()
    most: float = 300.0
    shapes: FloatArray | None = None
    least: float = 0.0
    most_stated: float = 0.0
    measured: PeakDeviation | None = None
    lines: FloatArray | None = None
    entries: tuple[str, ...] = ()

    @property
    def false_alarm_share(self) -> float:
        """False-alarm probability of this candidate in the step test, relative to that of most other candidates."""
        return LENGTHS_SHARE if self.cause is Cause.LENGTH_CHANGED else 1.0

    def from_pose(self, first: int) -> Candidate:
        """Return the candidate of a step at pose `first`, an index in time order."""
        columns = self.columns.copy()
        columns[:first] = 0.0
        return replace(self, columns=columns, places=len(columns), poses=(first,))

    def within_specification(self, b: FloatArray, covariance: FloatArray) -> bool:
        """Whether coefficients b (c,) are too small to count as a cause (see `most_stated` and `least`)."""
        size = b if self.shapes is None else self.shapes @ b
        if self.most_stated:
            return not self.deviation(b, covariance).beyond(self.most_stated)
        return float(np.sqrt(np.mean(size**2))) < self.least

    def moves(self, b: FloatArray, poses: int) -> FloatArray:
        """Return the change of the misclosures (m, r) caused by coefficients `b`; `poses`: number m of all poses."""
        if self.own is None:
            return np.asarray(self.columns @ b)
        out = np.zeros((poses, self.columns.shape[1]))
        out[self.own] = (self.columns @ b.reshape(len(self.own), -1, 1))[..., 0]
        return out

    def deviation(self, b: FloatArray, covariance: FloatArray) -> PeakDeviation:
        """Return the sensor's largest deviation over the poses, with its standard deviation.

        It is the deviation from the true angle, or from the best-fit line (whose slope is the gain error): whichever
        exceeds `most_stated` by more sigmas. The deviation from the line is `measured`, if that is known. If `measured`
        certainly exceeds `most_stated`, it is returned in any case.
        """
        if self.measured is not None and self.measured.beyond(self.most_stated):
            return self.measured
        shapes = self.columns[:, 0] if self.shapes is None else self.shapes
        kinds = [(False, shapes)]
        if self.lines is not None and self.measured is None:
            kinds.append((True, shapes - self.lines @ (self.lines.T @ shapes)))
        peaks = []
        for of_line, columns in kinds:
            size = np.abs(columns @ b)
            k = int(np.argmax(size))
            sd = float(np.sqrt(max(float(columns[k] @ covariance @ columns[k]), 0.0)))
            peaks.append(PeakDeviation(peak=float(size[k]), sd=sd, from_line=of_line))
        if self.measured is not None:
            peaks.append(self.measured)
        return max(
            peaks,
            key=lambda deviation: (deviation.peak - self.most_stated) / max(deviation.sd, 1e-12),
        )


ANGLE_RAD, LENGTH_M = 1e-3, 1e-3
"""Expected magnitude (rad, m) of faults for which no file states a magnitude."""

SCALE = 1e-2
"""Expected magnitude of a scale error."""


class FaultModels:
    """Fault models of a fit at the stated variances, with poses in the order in which they were taken.

    `order` (m,): for each pose in time order, its index in the fit.
    `measured`: by joint (1-based), the sensor's linearity deviation as measured by loops that do not use its readings.
    `readings` (m, n): readings of the poses in time order, rad. `system`: loop equations of the poses in time order.
    """

    def __init__(
        self,
        arm: ArmModel,
        stated: LinearFit,
        order: IntArray,
        measured: Mapping[int, PeakDeviation],
    ) -> None:
        self.arm, self.order, self.measured = arm, order, measured
        self.design, self.system = stated.design, stated.whole.at_poses(order)
        self.readings = self.design.q[order]

    @property
    def sensed(self) -> tuple[int, ...]:
        """Joints (1-based) whose readings are used."""
        unsensed = self.design.model.unsensed_joints
        return tuple(j for j in range(1, self.arm.joint_count + 1) if j not in unsensed)

    def joint(self, j: int) -> FloatArray:
        """Derivatives (m, r, 1) of the misclosures with respect to the reading of joint j."""
        return self.system.B[:, :, j - 1, None]

    def _along(
        self,
        cause: Cause,
        j: int,
        shapes: FloatArray,
        size: float = ANGLE_RAD,
        *,
        most: float = 300.0,
        least: float = 0.0,
    ) -> Candidate:
        """Return the candidate for errors ``shapes @ b`` (rad) of joint j's readings. `size`: expected size of b."""
        return Candidate(
            cause=cause,
            subject=str(j),
            columns=self.joint(j) * shapes[:, None, :],
            expected_size=np.full(shapes.shape[1], size),
            shapes=shapes,
            most=most,
            least=least,
        )

    def _of_parameters(self, cause: Cause, subject: str, names: Sequence[str]) -> Candidate:
        parameters = self.design.model.parameters
        columns = [k for name in names for k, p in enumerate(parameters) if p.name == name]
        return Candidate(
            cause=cause,
            subject=subject,
            columns=self.system.A[:, :, columns],
            expected_size=np.array(
                [ANGLE_RAD if parameters[k].is_angle else LENGTH_M for k in columns]
            ),
            entries=tuple(names),
        )

    def changes(self) -> list[Candidate]:
        """Return candidates for lasting changes; `Candidate.from_pose` sets the pose at which a change begins."""
        model = self.design.model
        always = np.ones((len(self.readings), 1))
        candidates = [self._along(Cause.LOST_COUNTS, j, always) for j in self.sensed]
        # A slip along the fixture's axis changes s_0, whichever half slips.
        along = tuple(name for name in model.ground_side if name.partition("[")[0] == "s_0")
        for side, own in (("table", model.ground_side), ("hand", (*model.hand_side, *along))):
            if len(own) > len(along):
                candidates.append(self._of_parameters(Cause.SLIPPED, side, own))
        for p in (model.parameters[k] for k in self.design.prior_index):
            if p.name in self.design.errors.tolerance and not p.is_angle:
                candidates.append(self._of_parameters(Cause.LENGTH_CHANGED, p.name, (p.name,)))
        return candidates

    def persistent_faults(self) -> Iterator[Candidate]:
        """Yield the causes that act in all poses, or in a run of consecutive poses."""
        # One sensor is noisy because it is defective, or all are because the arm was not at rest.
        for j in self.sensed:
            yield self._independent(Cause.READING, str(j), (j,), most=300.0)
        yield self._independent(Cause.SCATTER, "all joints", self.sensed, most=15.0)
        # A linear drift over the poses, of mean zero.
        ramp = np.linspace(-0.5, 0.5, len(self.readings))
        for j in self.sensed:
            yield self._along(Cause.DRIFT, j, ramp[:, None])
        yield from self.scales()
        yield from self._frozen()
        yield from self._smooth()
        yield from self._entries()
        yield from self._fixture()

    def _independent(
        self, cause: Cause, subject: str, joints: tuple[int, ...], most: float
    ) -> Candidate:
        """Return the candidate for independent errors of equal variance in all readings of `joints` (1-based)."""
        columns, m = [j - 1 for j in joints], len(self.readings)
        stated = self.design.noise_variance(self.design.stated_variances())[:, columns]
        return Candidate(
            cause=cause,
            subject=subject,
            columns=self.system.B[:, :, columns],
            own=np.arange(m),
            expected_size=np.full(m * len(columns), ANGLE_RAD),
            most=most,
            least=2.0 * float(np.sqrt(np.mean(stated))),
        )

    def scales(self) -> Iterator[Candidate]:
        """Yield, for each encoder, the fault that its counts per turn differ from the number in the arm file."""
        for j in self.sensed:
            if isinstance(self.arm.joints[j - 1].sensor, Encoder):
                turn = self.readings[:, j - 1]
                yield self._along(Cause.SCALE, j, (turn - turn.mean())[:, None], SCALE)

    def _frozen(self) -> Iterator[Candidate]:
        tolerance = 3.0 * np.maximum(self.arm.sigma_rad(), 1e-6)
        for j in self.sensed:
            for first, last in constant_reading_runs(self.readings, j, float(tolerance[j - 1])):
                poses = np.arange(first + 1, last)
                yield Candidate(
                    cause=Cause.FROZEN,
                    subject=str(j),
                    columns=self.joint(j)[poses],
                    own=poses,
                    expected_size=np.full(len(poses), 10.0 * ANGLE_RAD),
                    poses=tuple(range(first, last)),
                )

    def linearity_curve(self, j: int) -> Candidate | None:
        """Return the candidate for gain error and linearity deviation of joint j's RVDT; None for any other sensor."""
        sensor, turn = self.arm.joints[j - 1].sensor, self.readings[:, j - 1]
        if not isinstance(sensor, Rvdt):
            return None
        half, middle = 0.5 * sensor.full_scale_rad, self.arm.joints[j - 1].middle_rad
        # The line may have any slope; its expected magnitude is half that of the bow (P2) and the S (P3).
        curve = SensorCurve(joint=j, middle_rad=middle, half_scale_rad=half, gain=0.5 / half)
        stated = sensor.linearity_rad
        candidate = self._along(
            Cause.CURVE, j, curve.basis(turn), max(stated, ANGLE_RAD), most=10.0, least=0.5 * stated
        )
        line = np.stack((np.ones_like(turn), turn - turn.mean()), axis=-1)
        lines, measured = np.linalg.qr(line)[0], self.measured.get(j)
        return replace(candidate, most_stated=stated, measured=measured, lines=lines)

    def _smooth(self) -> Iterator[Candidate]:
        sags = self.design.sag.any()
        sag = self._in_time(pose_process(self.design.q, SAG_COLUMNS).phi) if sags else None
        for j in self.sensed:
            joint, turn = self.arm.joints[j - 1], self.readings[:, j - 1]
            if (curve := self.linearity_curve(j)) is not None:
                yield curve
            elif isinstance(joint.sensor, Encoder):
                waves = encoder_waves(turn)
                least = 2.0 * joint.sensor.accuracy_rad
                yield self._along(Cause.TURN_ERROR, j, waves, most=30.0, least=least)
            if sag is not None:
                yield self._along(Cause.SAG, j, sag, most=30.0, least=2.0 * joint.sag_rad)

    def _entries(self) -> Iterator[Candidate]:
        design = self.design
        for k, sd in zip(design.prior_index, design.prior_sd, strict=True):
            parameter = design.model.parameters[k]
            if parameter.name in design.errors.tolerance:
                yield Candidate(
                    cause=Cause.TWIST if parameter.is_angle else Cause.LENGTH,
                    subject=parameter.name,
                    columns=self.system.A[:, :, k, None],
                    expected_size=np.array([sd]),
                    most=100.0,
                    least=2.0 * sd,
                )

    def _fixture(self) -> Iterator[Candidate]:
        Et = np.swapaxes(self.system.E, -1, -2)
        m, r, k = Et.shape
        expected_size = np.repeat((ANGLE_RAD, LENGTH_M), (k - 3, 3))
        yield Candidate(
            cause=Cause.GIVES,
            subject="in every pose",
            columns=Et,
            own=np.arange(m),
            expected_size=np.tile(expected_size, m),
            most=15.0,
        )
        phi = self._in_time(self.design.deflection_basis.phi)
        yield Candidate(
            cause=Cause.GIVES,
            subject="with the pose",
            columns=(Et[..., None] * phi[:, None, None, :]).reshape(m, r, -1),
            expected_size=np.repeat(expected_size, phi.shape[1]),
            most=15.0,
        )

    def _in_time(self, phi: FloatArray) -> FloatArray:
        return np.asarray(phi[self.order] if phi.size else np.zeros((len(self.order), 0)))


def constant_reading_runs(q: FloatArray, joint: int, tolerance_rad: float) -> list[tuple[int, int]]:
    """Return runs [first, last) of poses in which a joint's reading is constant while at least half the others move."""
    m = len(q)
    reading = q[:, joint - 1]
    others = np.delete(q, joint - 1, axis=1)
    runs, first = [], 0
    for k in range(1, m + 1):
        if k < m and abs(reading[k] - reading[first]) <= tolerance_rad:
            continue
        others_move = np.ptp(others[first:k], axis=0) > OTHERS_MOVED_RAD
        if k - first >= FROZEN_POSES and 2 * int(others_move.sum()) >= others.shape[1]:
            runs.append((first, k))
        first = k
    return runs
