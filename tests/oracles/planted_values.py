"""True parameter values of a virtual arm."""

import numpy as np

from hardware.virtual.true_loop import BallTruth, Truth
from solver.chain.parameters import DhEntry


def planted_values(truth: Truth, *, si: bool = False) -> dict[str, float]:
    """Values by parameter name: in deg and m, as JSON has them, or in rad and m."""
    stacked, values = truth.table.stacked(), dict[str, float]()
    for row in range(stacked.shape[1]):
        for kind in ("theta_off", "s", "a", "alpha"):
            entry = DhEntry.parse(f"{kind}_{row}")
            value = float(stacked[entry.kind, entry.row])
            degrees = entry.kind.is_angle and not si
            values[entry.name] = float(np.rad2deg(value)) if degrees else value
    if isinstance(truth, BallTruth):
        for side, point in (("tip", truth.tip_m), ("ground", truth.ground_m)):
            values |= {f"{side}_{axis}": float(v) for axis, v in zip("xyz", point, strict=True)}
    return values
