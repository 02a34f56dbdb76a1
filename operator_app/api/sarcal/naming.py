"""Parameters under names that end in their unit: ``theta_off_1_deg``, ``a_0_mm``."""

from __future__ import annotations

from collections.abc import Iterable, Mapping
from types import MappingProxyType
from typing import TYPE_CHECKING

from operator_app.units.figure import ANGLE, LENGTH

if TYPE_CHECKING:
    from solver.chain.parameters import Parameter


def with_units(parameters: Iterable[Parameter], values: Iterable[float]) -> Mapping[str, float]:
    """Return values (rad, m) in deg and mm, read-only."""
    return MappingProxyType(
        {
            f"{p.name}_deg" if p.is_angle else f"{p.name}_mm": (
                float(v) * (ANGLE if p.is_angle else LENGTH).per_si
            )
            for p, v in zip(parameters, values, strict=True)
        }
    )
