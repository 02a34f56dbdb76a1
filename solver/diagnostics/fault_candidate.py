"""Possible faults of arm, fixture or readings, each with derivatives of the misclosures and an expected magnitude."""

from __future__ import annotations

from dataclasses import dataclass, replace
from enum import Enum
from typing import NamedTuple

import numpy as np

from solver.arrays import FloatArray, IntArray
from solver.diagnostics.limits import CERTAIN_SIGMAS


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
    """Largest deviation of a sensor from its best-fit line (`from_line`) or from the true angle, and its sigma, rad."""

    peak: float
    sd: float
    from_line: bool

    def beyond(self, stated: float) -> bool:
        """Whether `peak` certainly exceeds `stated`: by more than `CERTAIN_SIGMAS` standard deviations."""
        return self.peak - CERTAIN_SIGMAS * self.sd > stated


LENGTHS_SHARE = 0.1
"""False-alarm probability of the step test of a length, relative to that of other suspects. It is small because a metal
link hardly ever changes its length during a session."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Candidate:
    """One possible cause of misclosures, described by c coefficients that a fit to m poses can determine.

    `subject`: the joint, arm file entry or half of the fixture that is concerned.
    `columns` (m, r, c): derivatives of the r misclosures of each pose with respect to the coefficients.
    `expected_size` (c,): expected magnitudes of the coefficients.
    `own`: None if one set of c coefficients applies to all poses. If each pose concerned has its own set, the indices
    (p,) of these poses; then `columns` is (p, r, c), and `expected_size` is (p * c,).
    `places`: number of alternatives (e.g. poses) from which this one was selected; its prior is divided by this number.
    `poses`: poses concerned, indices in time order; empty if all poses are concerned.
    `most`: largest credible magnitude (rms) of the coefficients, in units of `expected_size`.
    `shapes` (m, c): coefficients b change the readings by ``shapes @ b``, rad; None if b itself is the deviation.
    `least`: smallest deviation (rms) that counts as a cause; not used if `most_stated` is given.
    `most_stated`: largest deviation that the files allow; 0 if they state none. A deviation counts as a cause only if
    it exceeds this value by more than `CERTAIN_SIGMAS` of its standard deviations.
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
        """Weight of this candidate in the step test, which divides its false-alarm probability among all candidates."""
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

        Deviations from the true angle include the gain error, which the poses determine badly. So deviations from the
        best-fit line (or `measured`, if known) are compared, too. The one that exceeds `most_stated` by more sigmas is
        returned. If `measured` certainly exceeds `most_stated`, it is returned in any case.
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
