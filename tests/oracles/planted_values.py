"""What a virtual arm really is, by parameter name as JSON has it: deg and m."""

import numpy as np

from hardware.virtual.true_loop import BallTruth, Truth
from solver.chain.parameters import DhEntry


def planted_values(truth: Truth) -> dict[str, float]:
    stacked, found = truth.table.stacked(), dict[str, float]()
    for row in range(stacked.shape[1]):
        for kind in ("theta_off", "s", "a", "alpha"):
            entry = DhEntry.parse(f"{kind}_{row}")
            value = float(stacked[entry.kind, entry.row])
            found[entry.name] = float(np.rad2deg(value)) if entry.kind.is_angle else value
    if isinstance(truth, BallTruth):
        for side, point in (("tip", truth.tip_m), ("ground", truth.ground_m)):
            found |= {f"{side}_{axis}": float(v) for axis, v in zip("xyz", point, strict=True)}
    return found
