"""True parameter values of a virtual arm."""

from itertools import product

import numpy as np

from hardware.virtual.true_loop import Truth
from solver.chain.parameters import DhEntry
from solver.loops.endpoints import PointClosure


def planted_values(truth: Truth, *, si: bool = False) -> dict[str, float]:
    """Values by parameter name: in deg and m, as JSON has them, or in rad and m."""
    stacked, values = truth.table.stacked(), dict[str, float]()
    for row, kind in product(range(stacked.shape[1]), ("theta_off", "s", "a", "alpha")):
        entry = DhEntry.parse(f"{kind}_{row}")
        value = float(stacked[entry.kind, entry.row])
        degrees = entry.kind.is_angle and not si
        values[entry.name] = float(np.rad2deg(value)) if degrees else value
    if isinstance(truth.loop, PointClosure):
        for side, point in (("tip", truth.loop.tip_m), ("ground", truth.loop.ground_m)):
            values |= {f"{side}_{axis}": float(v) for axis, v in zip("xyz", point, strict=True)}
    return values
