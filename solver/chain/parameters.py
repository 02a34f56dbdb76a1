"""Names, quantities and nominal values of the estimated parameters.

Names are the paper's: ``theta_off_1``, ``s_1``, ``a_0``, ``alpha_7``; the number is the D-H row. If row 2 joins
parallel axes, Hayati's ``beta_2`` takes the place of ``s_2``.
"""

from __future__ import annotations

import re
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass
from enum import IntEnum
from functools import lru_cache
from types import MappingProxyType

import numpy as np

from solver.arrays import FloatArray


class DhKind(IntEnum):
    """Column of a D-H table; the value is the column's index in `DhTable.stacked`."""

    THETA_OFF = 0
    S = 1
    A = 2
    ALPHA = 3
    BETA = 4

    @property
    def symbol(self) -> str:
        """The paper's symbol, as used in parameter names."""
        return _SYMBOLS[self]

    @property
    def is_angle(self) -> bool:
        """Whether the entry is an angle (rad) rather than a length (m)."""
        return self not in (DhKind.S, DhKind.A)


_SYMBOLS = tuple(kind.name.lower() for kind in DhKind)

_NAME = re.compile(rf"({'|'.join(_SYMBOLS)})_(\d+)")


@dataclass(frozen=True, slots=True, order=True)
class DhEntry:
    """One entry of a D-H table: its column and row."""

    kind: DhKind
    row: int

    @property
    def name(self) -> str:
        """Paper notation, e.g. ``theta_off_4``."""
        return f"{_SYMBOLS[self.kind]}_{self.row}"

    @classmethod
    @lru_cache(maxsize=1024)
    def parse(cls, name: str) -> DhEntry:
        """Read ``theta_off_4``, ``a_0``, ...; ValueError for any other name."""
        if (match := _NAME.fullmatch(name)) is None:
            raise ValueError(
                f"{name!r} is not a D-H entry "
                "(theta_off_<row>, s_<row>, a_<row>, alpha_<row>, beta_<row>)"
            )
        return cls(DhKind(_SYMBOLS.index(match[1])), int(match[2]))


@dataclass(frozen=True, slots=True, kw_only=True)
class Parameter:
    """One unknown: its name, whether it is an angle, its nominal value (rad or m)."""

    name: str
    is_angle: bool
    nominal: float

    @property
    def unit(self) -> str:
        """SI unit of the value."""
        return "rad" if self.is_angle else "m"


def is_entry(name: str) -> bool:
    """Whether `name` is the name of a D-H table entry."""
    return _NAME.fullmatch(name) is not None


def nominal_vector(
    parameters: Iterable[Parameter], known: Mapping[str, float] = MappingProxyType({})
) -> FloatArray:
    """Values (P,), rad and m: those in `known` (by name), and nominal values for all other parameters."""
    return np.array([known.get(p.name, p.nominal) for p in parameters])


def wrap_angle(angle_rad: FloatArray | float) -> FloatArray:
    """Bring angles into (-pi, pi]."""
    return np.asarray(np.pi - np.mod(np.pi - np.asarray(angle_rad), 2.0 * np.pi))


def wrap_angles(parameters: Sequence[Parameter], x: FloatArray) -> FloatArray:
    """Bring the angles of parameter vectors (..., P) into (-pi, pi]; lengths do not change."""
    is_angle = np.array([p.is_angle for p in parameters])
    return np.where(is_angle, wrap_angle(x), x)
