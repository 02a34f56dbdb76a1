"""Variance components, and the groups of columns whose coefficients share one. Knows no loop and no reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VarianceComponent:
    """One variance to be estimated, with its start value, floor and upper limit.

    `stated` is the value in the files. With `scaled` the logarithm of its size over the stated one has a normal prior
    (method, section 10): the poses determine it where they can, otherwise the stated value does. `soft` and `wall`
    bound an amplitude by its specification: a prior of that mean variance, and a value it never exceeds. ``inf`` where
    there is none. `leap` may be reached in one step from any value. `spread_variance` is its estimate from `spread_dof`
    differences inside poses, or from a specification of the same weight.
    """

    name: str
    start: float
    floor: float
    stated: float
    scaled: bool = False
    soft: float = np.inf
    wall: float = np.inf
    leap: float = 0.0
    spread_variance: float = 0.0
    spread_dof: int = 0

    @property
    def source(self) -> str:
        """Its name in an uncertainty budget: that of the groups it scales, if any."""
        kind, _, which = self.name.partition("_")
        if kind in _OF_RVDTS:
            return f"rvdt_{_OF_RVDTS[kind]}_{which}"
        return "fixture_give" if kind == "fixture" else self.name


_OF_RVDTS = {"rvdt": "noise", "curve": "curve", "gain": "gain"}
"""Sources that are components of an RVDT."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """Columns that share a variance ``fixed + sum of rates * components``.

    `source` is its name in an uncertainty budget; `rates` are pairs of a component and its factor; `names` describe the
    columns.
    """

    source: str
    width: int
    fixed: float = 0.0
    rates: tuple[tuple[int, float], ...] = ()
    names: tuple[str, ...] = ()

    def variance(self, v: FloatArray) -> float:
        """Variance of these columns' coefficients under the components (K,)."""
        return self.fixed + sum(rate * float(v[c]) for c, rate in self.rates)
