"""Compares the placements of a fixture, and computes distances between the sockets in which a ball was placed.

All placements share the arm's parameters; each has its own parameters of the fixture. If those of two placements agree
within their covariance, the fixture was not remounted in between, and the two count as one.
"""

import math
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from itertools import combinations

import numpy as np

from fixtures.ball import KnownDistance
from operator_app.calibration.error_model import stated_distances
from operator_app.calibration.experiment import Experiment
from operator_app.messages.finding import Finding, FindingKind
from solver.arrays import FloatArray
from solver.chain.parameters import wrap_angles
from solver.diagnostics.limits import DISTANCE_NOTICE_PROBABILITY, REMOUNT_FALSE_ALARM_PROBABILITY
from solver.diagnostics.statistics import chi2_limit, sigmas_at
from solver.estimators.error_model import distance_and_rates
from solver.estimators.estimate import Estimate
from solver.estimators.linear_fit import LinearFit
from solver.loops.closure import ClosureModel
from solver.loops.endpoints import GROUND, PointClosure
from solver.loops.placements import Placements

SINGULAR_DISTANCE = 1e-10
"""Directions are left out of chi2 if their eigenvalue of the correlation matrix is below this share of the largest."""


def indistinguishable_placements(model: ClosureModel, estimate: Estimate) -> tuple[Finding, ...]:
    """Return findings of placements between which the fixture was not remounted.

    Each finding names the parameter with the largest difference (in standard deviations), and states this difference.
    `estimate` covers all unknowns of `model`. Stations of an instrument are not compared, since a further station adds
    no information about the arm.
    """
    if not isinstance(model, Placements) or model.parts()[0][0].constrained_part is None:
        return ()
    findings: list[Finding] = []
    for pair in _pairs(model, estimate):
        joined = [other for other in findings if set(other.joints) & set(pair.joints)]
        most = max([pair, *joined], key=lambda a: a.figures["sigmas"])
        numbers = sorted({n for a in (pair, *joined) for n in a.joints})
        findings = [other for other in findings if other not in joined]
        findings.append(replace(most, joints=tuple(numbers)))
    return tuple(sorted(findings, key=lambda a: a.joints))


def _pairs(model: Placements, estimate: Estimate) -> Iterator[Finding]:
    for one, other in combinations(model.numbers, 2):
        own = model.columns(one) != model.columns(other)
        a, b = model.columns(one)[own], model.columns(other)[own]
        if not len(a):
            continue
        parameters = [estimate.parameters[k] for k in a]
        difference = wrap_angles(parameters, estimate.x[b] - estimate.x[a])
        C = estimate.covariance
        covariance = C[np.ix_(a, a)] + C[np.ix_(b, b)] - C[np.ix_(a, b)] - C[np.ix_(b, a)]
        sigmas, chi2 = _in_sigmas(difference, covariance)
        if chi2 < chi2_limit(len(a), REMOUNT_FALSE_ALARM_PROBABILITY):
            k = int(np.argmax(sigmas))
            parameter = model.of(one)[0].parameters[int(np.flatnonzero(own)[k])]
            yield Finding(
                FindingKind.SAME_PLACEMENT,
                joints=(one, other),
                names=(parameter.name,),
                size=abs(float(difference[k])),
                unit=parameter.unit,
                figures={"sigmas": float(sigmas[k])},
            )


def _in_sigmas(difference: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """Return the magnitude of each difference (k,) in standard deviations, and the chi2 of all differences together."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    known = sd > 0.0
    if np.any(difference[~known] != 0.0):
        return np.full(len(sd), np.inf), np.inf
    z, scale = difference[known] / sd[known], np.outer(sd[known], sd[known])
    inverse = np.linalg.pinv(
        covariance[np.ix_(known, known)] / scale, SINGULAR_DISTANCE, hermitian=True
    )
    sigmas = np.zeros(len(sd))
    sigmas[known] = np.abs(z)
    return sigmas, float(z @ inverse @ z)


MOST_PAIRS = 45
"""Up to this number of pairs of placements, the distances of all pairs are listed (ten placements have 45 pairs). If
there are more, only distances of neighbours and measured distances are listed."""


@dataclass(frozen=True, slots=True, kw_only=True)
class Distance:
    """Distance between the sockets of two placements, m, and its standard uncertainty.

    `between`: numbers of the placements. `measured`: distance in the fixture's file, if any; `value_m` already uses it.
    `deviation`: measured distance minus the distance from the poses alone, in standard deviations of this difference.
    """

    between: tuple[int, int]
    value_m: float
    sigma_m: float
    measured: KnownDistance | None = None
    deviation: float = 0.0


def distances(
    model: ClosureModel,
    x: FloatArray,
    covariance: FloatArray,
    placements: tuple[int, ...],
    measured: Sequence[tuple[KnownDistance, float]] = (),
) -> tuple[Distance, ...]:
    """Return the distances between sockets in which a ball was placed; empty for other fixtures or a single placement.

    `x`, `covariance`: estimate (P,) of the parameters and its covariance (P, P), rad and m.
    `measured`: the measured distances that the estimate used, each with its deviation in sigmas.
    """
    parts = model.parts()
    if len(parts) < 2 or not all(isinstance(part, PointClosure) for part, _, _ in parts):
        return ()
    columns = np.arange(len(x))
    where = []
    for part, own, _ in parts:
        names = [p.name for p in part.parameters]
        if not set(GROUND) <= set(names):
            return ()
        where.append(columns[own][[names.index(name) for name in GROUND]])
    stated = {frozenset(d.between): (d, sigmas) for d, sigmas in measured}
    pairs = [
        (a, b)
        for a, b in combinations(range(len(where)), 2)
        if len(where) * (len(where) - 1) <= 2 * MOST_PAIRS
        or b == a + 1
        or frozenset((placements[a], placements[b])) in stated
    ]
    listed = []
    for a, b in pairs:
        value, rates = distance_and_rates(where[a].tolist(), where[b].tolist(), x)
        between = (placements[a], placements[b])
        known, deviation = stated.get(frozenset(between), (None, 0.0))
        listed.append(
            Distance(
                between=between,
                value_m=value,
                sigma_m=math.sqrt(max(float(rates @ covariance @ rates), 0.0)),
                measured=known,
                deviation=deviation,
            )
        )
    return tuple(listed)


def compared(experiment: Experiment, fit: LinearFit) -> tuple[tuple[KnownDistance, float], ...]:
    """Return the measured distances used in a fit, each with its deviation in sigmas (`Distance.deviation`)."""
    stated = stated_distances(experiment)
    return tuple(zip(stated, fit.distance_deviations().tolist(), strict=True))


def contradicted(experiment: Experiment, fit: LinearFit) -> tuple[Finding, ...]:
    """Return a finding for each measured distance that the poses of a fit contradict."""
    known = compared(experiment, fit)
    limit = sigmas_at(DISTANCE_NOTICE_PROBABILITY, len(known))
    return tuple(contradiction(d.between, sigmas) for d, sigmas in known if abs(sigmas) > limit)


def contradiction(between: tuple[int, int], deviation: float) -> Finding:
    """Return the finding that the poses contradict the measured distance between two sockets by `deviation` sigmas."""
    return Finding(
        FindingKind.DISTANCE_ABOVE if deviation > 0.0 else FindingKind.DISTANCE_BELOW,
        joints=between,
        figures={"sigmas": abs(deviation)},
    )
