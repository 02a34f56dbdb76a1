"""Is the noise of single RVDT readings found, whatever was averaged? Arms from the shop floor; a table.

    python tests/benchmarks/rvdt_noise.py [--arms 40] [--workers 2]

Noise of 1, 2, 4 and 8 LSB in means of 1, 8 and 32 samples, every other error at its stated size. Bar:
the median over arms and joints is within 10 % of what was drawn; of 10 arms it varies by 5 % itself.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
from collections.abc import Sequence
from concurrent.futures import ProcessPoolExecutor
from itertools import product
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[2]))

import numpy as np

from operator_app.calibration.calibrate import calibrate
from operator_app.config.poses_file import parse_poses
from tests.benchmarks.shop_floor_outcome import packaged
from tests.oracles.shop_floor import Sizes, session

FIRST_SEED = 7000
BAR = 0.10


def found_lsb(job: tuple[float, int, int]) -> list[float]:
    """Noise (LSB) that the verdicts on joints 6 and 7 state; NaN where they cannot."""
    lsb, samples, seed = job
    taken = session(seed, Sizes(noise_lsb=lsb), samples=samples)
    solution = calibrate(*packaged(), parse_poses(taken.csv().encode(), "poses.csv").poses)
    return [np.nan if v.noise is None else v.noise.lsb for v in solution.rvdt]


def main(arguments: Sequence[str] | None = None) -> int:
    """Measure and print; 0 when every bar is met."""
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("--arms", type=int, default=40)
    parser.add_argument("--workers", type=int, default=2)
    options = parser.parse_args(arguments)
    good = True
    print("noise LSB  samples   found (median, 10..90 % of arms)   none found")
    with ProcessPoolExecutor(options.workers) as pool:
        for lsb, samples in product((1.0, 2.0, 4.0, 8.0), (1, 8, 32)):
            jobs = [(lsb, samples, FIRST_SEED + k) for k in range(options.arms)]
            found = np.array(list(pool.map(found_lsb, jobs))).ravel()
            none = np.isnan(found)
            low, middle, high = (
                np.nanquantile(found, (0.1, 0.5, 0.9)) if not none.all() else [0] * 3
            )
            met = bool(abs(middle / lsb - 1.0) <= BAR)
            good = good and met
            print(
                f"{lsb:9.0f}{samples:9}{middle:11.2f}   {low:.2f} .. {high:.2f}{none.sum():14}"
                f"   {'' if met else 'MISSED'}",
                flush=True,
            )
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
