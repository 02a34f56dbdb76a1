"""How a planned calibration is to go, and where it is."""

from __future__ import annotations

from collections.abc import Mapping
from dataclasses import dataclass, field
from enum import Enum

import numpy as np

from solver.design.exploration import ExplorationLimits


class Phase(Enum):
    """What the campaign is at."""

    EXPLORING = "exploring"
    PLANNED = "visiting planned poses"
    FINISHED = "finished"


@dataclass(frozen=True, slots=True, kw_only=True)
class CampaignSettings:
    """How a campaign goes.

    Attributes
    ----------
    poses
        Planned poses to take, beside those of the exploration.
    requested
        Standard deviations to reach by parameter name (rad, m); empty for none.
    exploration
        How boldly to explore.
    tolerance_rad
        How far readings may stray from the predicted trace of a planned move.
    most_blocked
        Planned moves that may be stopped short before the campaign gives up.
    """

    poses: int = 12
    requested: Mapping[str, float] | None = None
    exploration: ExplorationLimits = field(default_factory=ExplorationLimits)
    tolerance_rad: float = float(np.deg2rad(8.0))
    most_blocked: int = 8
