"""What an arm file states of its links' weight and of which way is down.

Without it, what bends under load is taken to be any smooth function of the pose.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from typing import Annotated

import numpy as np
from pydantic import Field, field_validator

from operator_app.config.quantities import (
    Count,
    LengthM,
    NonNegativeNumber,
    Number,
    StatedDeg,
    StatedMm,
    refuse,
)
from operator_app.config.schema import StrictModel
from solver.chain.statics import LinkMasses

MASS_PERCENT, CENTRE_MM, TILT_DEG = 20.0, 15.0, 3.0
"""How well masses, centres and the mounting are known where a file gives no figure."""


class LinkModel(StrictModel):
    """What moves with one joint: its mass and where its centre is."""

    link: Annotated[Count, Field(description="The joint that it moves with, from 1.")]
    mass_kg: Annotated[NonNegativeNumber, Field(le=10_000.0)]
    centre_m: Annotated[
        tuple[LengthM, LengthM, LengthM],
        Field(
            description="Centre of mass from the joint's origin p_{j-1}: z along the joint's axis, "
            "x where theta + theta_off turns the link (x_j)."
        ),
    ]
    mass_tolerance_percent: Annotated[
        NonNegativeNumber, Field(le=100.0, description="One standard deviation.")
    ] = MASS_PERCENT
    centre_tolerance_mm: Annotated[
        StatedMm, Field(description="One standard deviation of each component.")
    ] = CENTRE_MM


class GravityModel(StrictModel):
    """Which way is down, seen from the arm's base (frame 0)."""

    down: Annotated[
        tuple[Number, Number, Number], Field(description="Any length: [-1, 0, 0] is along -x.")
    ]
    tolerance_deg: StatedDeg = TILT_DEG

    @field_validator("down")
    @classmethod
    def _some_way(cls, value: tuple[float, float, float]) -> tuple[float, float, float]:
        if not math.hypot(*value) > 0.0:
            raise refuse("down points nowhere", "write for example [0, 0, -1]")
        return value


def link_masses(links: Sequence[LinkModel], gravity: GravityModel) -> LinkMasses:
    """Domain object."""
    mass = np.array([link.mass_kg for link in links])
    down = np.array(gravity.down, dtype=np.float64)
    down /= np.abs(down).max()  # of any length, also one whose square is no float
    return LinkMasses(
        mass_kg=mass,
        centre_m=np.array([link.centre_m for link in links], dtype=np.float64),
        mass_sd_kg=mass * np.array([link.mass_tolerance_percent for link in links]) / 100.0,
        centre_sd_m=np.array([link.centre_tolerance_mm for link in links]) / 1e3,
        down=down / np.linalg.norm(down),
        down_sd_rad=math.radians(gravity.tolerance_deg),
    )
