"""Result of a calibration: parameters, their quality, verdict and reasons. Computes nothing.

A `Solution` is the input of journal, report, export and verification; `operator_app.calibration.calibrate` makes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from operator_app.calibration.acceptance import Adjudication, Verdict
from operator_app.calibration.placements import Distance
from operator_app.calibration.tool_accuracy import (
    HandAccuracy,
    MeasuredOffset,
    TipSigma,
    TrueErrors,
)
from operator_app.messages.finding import Finding
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.limits import LEAST_INFORMATION_SHARE
from solver.diagnostics.rvdt import RvdtVerdict
from solver.diagnostics.stated_sizes import Scale
from solver.estimators.estimate import Estimate
from solver.estimators.variance_components import VarianceComponents
from solver.loops.closure import ClosureModel, ClosureSigmas
from solver.posterior.best_table import BestTable
from solver.posterior.corrections import Corrections
from solver.search.global_start import GlobalStart


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """A calibration with its verdict.

    `paper`: estimate of the paper's estimator from the same poses; None with unsensed joints.
    `before`: closure sigmas at the nominal parameters, for comparison with `estimate.sigmas`.
    `dropped_flipped`: indices of poses that were left out because they are on the flipped branch.
    `held`: unknowns that were fixed at their nominal values on request.
    `tolerated`: lengths and twists corrected within their tolerance; they are parameters of `estimate` as well.
    `components`: further results: noise and linearity deviations of the RVDTs, compliance of the fixture, and the
    uncertainty budget of every parameter.
    `outliers`: labels of poses whose readings do not fit the others, the worst first; the calibration still uses them.
    `rvdt`: verdict on each RVDT, from a fit in which its joint was taken as unsensed.
    `reasons`: reasons against acceptance; may be empty. `adjudication`: all tests, and the causes that they support.
    `assumed`: values of the error model for which defaults were used, because no file states them.
    `hand`: tool position uncertainty at the poses of the calibration.
    `accuracy`: tool position error before and after calibration over the joints' ranges.
    `condition_at_readings`: scaled condition number at the readings, as in the paper; None with unsensed joints.
    `implicit`: estimate of the implicit estimator, if the paper's estimator was chosen.
    `best`: best D-H table for uncorrected readings, with sigmas. With the paper's estimator or unsensed joints, `best`,
    `corrections`, `with_best_table` and `with_corrections` are None.
    `corrections`: corrections that a controller may add to the readings. `with_best_table`: closure sigmas with `best`.
    `with_corrections`: closure sigmas with the identified entries, at readings to which `corrections` are added.
    `shares`: share of each parameter's information that comes from the poses, by name.
    `unsensed_offsets`: offsets, by joint, of joints whose readings were not used.
    `length_tolerance_m`: standard deviation of the link lengths, if one was stated in place of the arm file's.
    `truth`: errors relative to the true values; None if these are unknown, as for any real arm.
    `hand`, `accuracy`, `condition_at_readings`, `best` and `unsensed_offsets` are None in records of earlier versions.
    """

    model: ClosureModel
    estimate: Estimate
    paper: Estimate | None
    identifiability: Identifiability
    before: ClosureSigmas
    poses: int
    dropped_flipped: tuple[int, ...]
    held: tuple[str, ...]
    tolerated: tuple[str, ...]
    components: VarianceComponents | None
    search: GlobalStart | None
    outliers: tuple[str, ...]
    rvdt: tuple[RvdtVerdict, ...]
    warnings: tuple[Finding, ...]
    reasons: tuple[str, ...]
    assumed: tuple[str, ...] = ()
    adjudication: Adjudication = field(
        default_factory=Adjudication, metadata={"record": "judgement"}
    )
    hand: TipSigma | None = None
    accuracy: HandAccuracy | None = None
    implicit: Estimate | None = None
    condition_at_readings: float | None = None
    best: BestTable | None = None
    corrections: Corrections | None = None
    with_best_table: ClosureSigmas | None = None
    with_corrections: ClosureSigmas | None = None
    scales: tuple[Scale, ...] = ()
    shares: Mapping[str, float] = field(default_factory=dict)
    distances: tuple[Distance, ...] = ()
    unsensed_offsets: Mapping[int, MeasuredOffset] | None = None
    length_tolerance_m: float | None = None
    truth: TrueErrors | None = None

    @property
    def accepted(self) -> bool:
        """Whether the parameters may be used, with or without warnings."""
        return not self.reasons

    @property
    def verdict(self) -> Verdict:
        """Verdict on the calibration: not accepted if there are any `reasons`."""
        if not self.accepted:
            return Verdict.NOT_ACCEPTED
        return self.adjudication.verdict

    @property
    def causes(self) -> tuple[Finding, ...]:
        """Causes of a misfit, the main cause first."""
        return self.adjudication.causes

    @property
    def within(self) -> dict[str, float]:
        """Type A uncertainty of each parameter (rad, m): its scatter over repeats of the poses; empty if unknown."""
        if self.components is None:
            return {}
        # For parameters without information from the poses the variance is zero; rounding may make it negative.
        sd = np.sqrt(np.maximum(np.diagonal(self.components.repeatability), 0.0))
        return {p.name: s for p, s in zip(self.estimate.parameters, sd.tolist(), strict=True)}

    @property
    def identified(self) -> Estimate:
        """The estimate without the `tolerated` lengths and twists, which are only corrected within tolerances."""
        return self.estimate.without(self.tolerated)

    @property
    def by_files(self) -> tuple[str, ...]:
        """Identified parameters for which less than half of the information comes from the poses."""
        return tuple(
            p.name
            for p in self.identified.parameters
            if self.shares.get(p.name, 1.0) < LEAST_INFORMATION_SHARE
        )

    @property
    def beside(self) -> Estimate | None:
        """Estimate by the estimator that was not chosen, from the same poses; None if not computed."""
        return self.implicit if self.estimate.estimator == "paper" else self.paper

    def with_notices(self, notices: Iterable[Finding]) -> Solution:
        """Return the solution with `notices` added to its `warnings`."""
        return replace(self, warnings=(*self.warnings, *notices))
