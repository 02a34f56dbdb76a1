"""How small an error of an upper arm or forearm can any test find? The power of the best one; a table.

    python tests/benchmarks/elbow_power.py [--arms 5]

The best test of one length against everything the files state looks along that length only and knows
which it is (Neyman and Pearson): its statistic is normal with a mean of the error times the root of its
information. A verdict that must look at every length can do no better.
"""

# ruff: noqa: T201 - a benchmark prints

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.special import ndtr, ndtri

from operator_app.calibration.closed_loops import loop_of_poses
from operator_app.calibration.error_model import error_model, free_within_tolerance
from operator_app.config.poses_file import parse_poses
from solver.estimators.variance_components import estimate_with_errors
from tests.benchmarks.shop_floor_outcome import packaged
from tests.oracles.shop_floor import session

FIRST_SEED = 3000
LEVELS = (1e-3, 0.05)


def information(seed: int, names: tuple[str, ...]) -> list[float]:
    """Root of what a sound session tells of each length, 1/m, everything else as stated."""
    arm, hinge = packaged()
    poses = parse_poses(session(seed).csv().encode(), "poses.csv").poses
    model, tolerance = free_within_tolerance(loop_of_poses(arm, hinge, poses), arm)
    errors = error_model(arm, hinge, poses, np.arange(len(poses)), tolerance=tolerance)
    stated = estimate_with_errors(model, poses.q_rad, errors).linear.stated
    rates = stated.system.part(slice(0, len(poses))).A
    known = [p.name for p in model.parameters]
    here = [stated.score(rates[:, :, known.index(n), None]).information for n in names]
    return [float(np.sqrt(one[0, 0])) for one in here]


def main() -> int:
    """Print the power for several sizes of error."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=5)
    options = parser.parse_args()
    names = ("s_3", "s_5")
    found = np.array([information(FIRST_SEED + k, names) for k in range(options.arms)])
    print(f"{'length':8}{'error mm':>9}{'in sigmas':>11}" + "".join(f"{a:>10g}" for a in LEVELS))
    for name, column in zip(names, found.T, strict=True):
        for mm in (1.0, 2.0, 5.0, 30.0):
            z = 1e-3 * mm * column
            power = [float(np.mean(ndtr(z + ndtri(0.5 * a)))) for a in LEVELS]
            print(f"{name:8}{mm:9g}{z.mean():11.2f}" + "".join(f"{p:10.3f}" for p in power))
    return 0


if __name__ == "__main__":
    sys.exit(main())
