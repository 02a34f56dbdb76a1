"""Variance components, and the groups of columns whose coefficients share one. Knows no loop and no reading."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from solver.arrays import FloatArray


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class VarianceComponent:
    """One variance to be estimated: where it starts, its floor, and where its prior puts a wall.

    `stated` is what the files say. With `scaled` the logarithm of its size over the stated one has a
    normal prior (method, section 10): the poses decide where they see it, the statement where they do not.
    `soft` and `wall` bound an amplitude by its specification: a prior of that mean variance, and a
    value it never exceeds. ``inf`` where there is none. `leap` may be reached in one step however
    small it was. `spread_variance` is what `spread_dof` differences inside poses say of it, or a
    specification that weighs like so many.
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
        """What an uncertainty budget calls it: that of the groups it moves, if it moves any."""
        kind, _, which = self.name.partition("_")
        if kind in _OF_RVDTS:
            return f"rvdt_{_OF_RVDTS[kind]}_{which}"
        return "fixture_give" if kind == "fixture" else self.name


_OF_RVDTS = {"rvdt": "noise", "curve": "curve", "gain": "gain"}
"""What an RVDT's components are of it."""


@dataclass(frozen=True, slots=True, kw_only=True, eq=False)
class Group:
    """Columns that share a variance ``fixed + sum of rates * components``.

    `source` is what an uncertainty budget calls it; `rates` are pairs of a component and its factor; `names`
    say what each column is.
    """

    source: str
    width: int
    fixed: float = 0.0
    rates: tuple[tuple[int, float], ...] = ()
    names: tuple[str, ...] = ()

    def variance(self, v: FloatArray) -> float:
        """Variance of these columns' coefficients under the components (K,)."""
        return self.fixed + sum(rate * float(v[c]) for c, rate in self.rates)
