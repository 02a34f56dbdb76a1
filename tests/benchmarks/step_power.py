"""How small a shift of one joint's reading can any test find? The power of the best one; a table.

    python tests/benchmarks/step_power.py [--arms 5] [--counts 50]

The best test of one shift against all that the shop floor's arms have (tests/oracles/shop_floor_bound:
their true second moments) knows joint and pose (Neyman and Pearson): its statistic is normal with a mean
of the shift over its standard deviation. A verdict knows neither: the third column is the power of one
that may raise as few false alarms over all joints and poses together (Bonferroni). Bar for the verdict
(tests/benchmarks/verdicts.py): 90 % of slips of 50 counts named.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np
from scipy.special import ndtr, ndtri

from tests.oracles.shop_floor import RVDTS, Sizes, session
from tests.oracles.shop_floor_bound import step_sigma
from tests.oracles.shop_floor_misread import COUNT, LSB

FIRST_SEED = 3000
LEVEL = 1e-3
PLACES = slice(8, 33)
"""Where the verdict's cases slip."""


def main() -> int:
    """Print the power for every joint."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=5)
    parser.add_argument("--counts", type=float, default=50.0)
    options = parser.parse_args()
    sigma = np.array([step_sigma(session(FIRST_SEED + k), Sizes()) for k in range(options.arms)])
    everywhere = LEVEL / sigma[0].size
    print("joint   shift deg   in sigmas (least)   power: joint and pose known   not known")
    for j in range(sigma.shape[1]):
        shift = options.counts * (LSB if j + 1 in RVDTS else COUNT)
        z = shift / sigma[:, j, PLACES]
        power = [float(ndtr(z + ndtri(0.5 * a)).mean()) for a in (LEVEL, everywhere)]
        print(
            f"{j + 1:5}{np.rad2deg(shift):12.4f}{z.mean():12.1f} ({z.min():5.1f})"
            f"{power[0]:30.4f}{power[1]:12.4f}"
        )
    return 0


if __name__ == "__main__":
    sys.exit(main())
