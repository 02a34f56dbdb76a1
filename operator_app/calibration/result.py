"""What a calibration gives: parameters, what they are worth, and why. Computes none of it.

A `Solution` is journalled, reported, exported and verified from; `operator_app.calibration.calibrate` makes it.
"""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from dataclasses import dataclass, field, replace

import numpy as np

from operator_app.calibration.acceptance import Adjudication, Verdict
from operator_app.calibration.placements import Distance
from operator_app.calibration.tool_accuracy import HandAccuracy, TipSigma, TrueErrors
from operator_app.messages.finding import Finding
from solver.diagnostics.identifiability import Identifiability
from solver.diagnostics.rvdt import RvdtVerdict
from solver.estimators.estimate import ClosureSigmas, Estimate
from solver.estimators.variance_components import VarianceComponents
from solver.loops.closure import ClosureModel
from solver.posterior.best_table import BestTable
from solver.posterior.corrections import Corrections
from solver.posterior.scales import Scale
from solver.search.global_start import GlobalStart


@dataclass(frozen=True, slots=True, kw_only=True)
class Solution:
    """A judged calibration.

    Attributes
    ----------
    model
        The loop that was solved.
    estimate
        By the chosen estimator.
    paper
        By the paper's estimator on the same poses; None when joints are unsensed.
    seen
        Rank, condition number, weakest direction.
    before
        Closure sigmas at the nominal parameters, for comparison with `estimate.sigmas`.
    dropped_flipped
        Indices (into the poses given) left out because they lie on the flipped branch.
    held
        Unknowns that were dropped on request: held at their nominal values.
    tolerated
        Lengths and twists corrected within their tolerance; they are parameters of `estimate` as well.
    components
        What was found with the parameters: noise and curves of the RVDTs, give of the fixture, and
        what each source of error brings to every parameter.
    search
        The global start, where one was asked for.
    outliers
        Labels of poses whose readings do not fit the others, the worst first. They still count: the
        operator excludes them or not.
    rvdt
        What the loops say of each RVDT, its joint taken as unsensed for that.
    reasons
        Why it is not accepted; empty when it is.
    judgement
        Every test that was made, and the causes that they point to.
    assumed
        Figures of the error model that no file states.
    hand
        How far off the hand may be at these poses; None in records of earlier versions.
    accuracy
        What the calibration brings over the joints' ranges; None in records of earlier versions.
    condition_at_readings
        Scaled condition number where the joints were read, as the paper took it; None with unsensed
        joints, and in records of earlier versions.
    implicit
        What weighing every reading by its noise gives, where the paper's estimate is the chosen one.
    best
        The D-H table that has the tool where corrections would have it, and how well it has it; None with the
        paper's estimator, and in records of earlier versions.
    corrections
        What a controller may add to the readings beside the identified parameters; None likewise.
    scales
        How large each family of errors was found, stated = 1.
    shares
        Share of what is known of each parameter that the poses brought, by name.
    distances
        Between the placements of a ball.
    length_tolerance_m
        How well lengths were taken to be known, where that was asked for and is not what the arm's file states.
    truth
        How far it is from the truth; None where nobody knows that, as of any real arm.
    """

    model: ClosureModel
    estimate: Estimate
    paper: Estimate | None
    seen: Identifiability
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
    scales: tuple[Scale, ...] = ()
    shares: Mapping[str, float] = field(default_factory=dict)
    distances: tuple[Distance, ...] = ()
    length_tolerance_m: float | None = None
    truth: TrueErrors | None = None

    @property
    def accepted(self) -> bool:
        """Whether the parameters may be used: with or without warnings."""
        return not self.reasons

    @property
    def verdict(self) -> Verdict:
        """Which of the three classes it is of."""
        if not self.accepted:
            return Verdict.NOT_ACCEPTED
        return self.adjudication.verdict

    @property
    def causes(self) -> tuple[Finding, ...]:
        """What is wrong, the most probable first."""
        return self.adjudication.causes

    @property
    def within(self) -> dict[str, float]:
        """Type A of each parameter (rad, m): what the same poses taken again would scatter; empty if not known."""
        if self.components is None:
            return {}
        # What the poses do not tell at all has none, but for rounding.
        sd = np.sqrt(np.maximum(np.diagonal(self.components.repeatability), 0.0))
        return {p.name: s for p, s in zip(self.estimate.parameters, sd.tolist(), strict=True)}

    @property
    def identified(self) -> Estimate:
        """The estimate of what calibration identifies: without the lengths and twists it corrected."""
        return self.estimate.without(self.tolerated)

    @property
    def beside(self) -> Estimate | None:
        """The other estimator's result on the same poses; None where there is none."""
        return self.implicit if self.estimate.estimator == "paper" else self.paper

    def with_notices(self, notices: Iterable[Finding]) -> Solution:
        """Return the same solution with more warnings."""
        return replace(self, warnings=(*self.warnings, *notices))
