"""Distances between points of a loop that were measured, with a caliper: rows beside those of the poses.

A distance ``d = |p_b - p_a|`` of standard uncertainty s is one equation more, linearised where the parameters are:

    (d(x) - d_measured) / s + u . (dp_b - dp_a) / s,      u = (p_b - p_a) / d
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray
from solver.chain.parameters import Parameter

Names = tuple[str, str, str]


@dataclass(frozen=True, slots=True, kw_only=True)
class MeasuredDistance:
    """Distance (m) of two points, each named by its three coordinates among the parameters, and its sigma (m)."""

    first: Names
    second: Names
    value_m: float
    sigma_m: float


def distance_and_rates(
    first: Sequence[int], second: Sequence[int], x: FloatArray
) -> tuple[float, FloatArray]:
    """Return the distance of two points, m, and its rates (P,) with the parameters x (P,)."""
    apart = x[list(second)] - x[list(first)]
    value = float(np.linalg.norm(apart))
    rates = np.zeros_like(x)
    rates[list(second)] = apart / max(value, 1e-300)
    rates[list(first)] = -rates[list(second)]
    return value, rates


def distance_rows(
    distances: Sequence[MeasuredDistance], parameters: Sequence[Parameter], x: FloatArray
) -> tuple[FloatArray, FloatArray]:
    """Return misclosures (k,) and rates (k, P) at x (P,), in units of each distance's sigma."""
    index = {p.name: k for k, p in enumerate(parameters)}
    w, rows = np.zeros(len(distances)), np.zeros((len(distances), len(x)))
    for k, d in enumerate(distances):
        a, b = ([index[name] for name in names] for names in (d.first, d.second))
        value, rates = distance_and_rates(a, b, x)
        w[k] = (value - d.value_m) / d.sigma_m
        rows[k] = rates / d.sigma_m
    return w, rows
