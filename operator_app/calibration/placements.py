"""Placements of a fixture that do not differ.

The arm's parameters are shared, the fixture's belong to each placement. Where the fixture was not remounted these
agree within their covariance; two such placements count as one.
"""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import dataclass
from itertools import combinations

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import Parameter, wrap_angle
from solver.diagnostics.limits import REMOUNT_FALSE_ALARM_PROBABILITY
from solver.estimators.estimate import Estimate
from solver.loops.closure import ClosureModel
from solver.loops.placements import Placements

SINGULAR = 1e-10
"""Directions of a correlation matrix in which nothing is known of a difference."""


@dataclass(frozen=True, slots=True, kw_only=True)
class IndistinguishablePlacements:
    """Placements whose own parameters do not differ.

    Attributes
    ----------
    numbers
        As the operator counts them, ascending.
    parameter, difference, sigmas
        What differs most among them in standard deviations: by how much (rad or m, without sign), and in
        standard deviations of the difference.
    """

    numbers: tuple[int, ...]
    parameter: Parameter
    difference: float
    sigmas: float


def indistinguishable_placements(
    model: ClosureModel, estimate: Estimate
) -> tuple[IndistinguishablePlacements, ...]:
    """Find placements between which the fixture was not remounted; `estimate` is of all unknowns of `model`."""
    if not isinstance(model, Placements):
        return ()
    found: list[IndistinguishablePlacements] = []
    for pair in _pairs(model, estimate):
        joined = [other for other in found if set(other.numbers) & set(pair.numbers)]
        most = max([pair, *joined], key=lambda a: a.sigmas)
        together = IndistinguishablePlacements(
            numbers=tuple(sorted({n for a in (pair, *joined) for n in a.numbers})),
            parameter=most.parameter,
            difference=most.difference,
            sigmas=most.sigmas,
        )
        found = [other for other in found if other not in joined] + [together]
    return tuple(sorted(found, key=lambda a: a.numbers))


def _pairs(model: Placements, estimate: Estimate) -> Iterator[IndistinguishablePlacements]:
    from scipy.special import chdtri

    for one, other in combinations(model.numbers, 2):
        own = model.columns(one) != model.columns(other)
        a, b = model.columns(one)[own], model.columns(other)[own]
        if not len(a):
            continue
        parameters = [estimate.parameters[k] for k in a]
        difference = estimate.x[b] - estimate.x[a]
        angle = np.array([p.is_angle for p in parameters])
        difference[angle] = wrap_angle(difference[angle])
        C = estimate.covariance
        there = C[np.ix_(a, a)] + C[np.ix_(b, b)] - C[np.ix_(a, b)] - C[np.ix_(b, a)]
        sigmas, chi2 = _in_sigmas(difference, there)
        if chi2 < chdtri(len(a), REMOUNT_FALSE_ALARM_PROBABILITY):
            k = int(np.argmax(sigmas))
            yield IndistinguishablePlacements(
                numbers=(one, other),
                parameter=model.of(one)[0].parameters[int(np.flatnonzero(own)[k])],
                difference=abs(float(difference[k])),
                sigmas=float(sigmas[k]),
            )


def _in_sigmas(difference: FloatArray, covariance: FloatArray) -> tuple[FloatArray, float]:
    """Size of each difference (k,) in its standard deviations, and chi2 of all of them together."""
    sd = np.sqrt(np.maximum(np.diagonal(covariance), 0.0))
    known = sd > 0.0
    if np.any(difference[~known] != 0.0):
        return np.full(len(sd), np.inf), np.inf
    z, scale = difference[known] / sd[known], np.outer(sd[known], sd[known])
    inverse = np.linalg.pinv(covariance[np.ix_(known, known)] / scale, SINGULAR, hermitian=True)
    sigmas = np.zeros(len(sd))
    sigmas[known] = np.abs(z)
    return sigmas, float(z @ inverse @ z)
