"""What the first standing of a second placement sees of a slip since the first: by the files, and by its poses.

    python -m tests.benchmarks.second_standing [--arms 100] [--poses 20] [--processes 2]

Arms of ``tests.oracles.shop_floor_remounted``: as their files state, with the paper's larger errors, and wild ones. One
joint's reading has slipped meanwhile; found is what is refused before a drive is enabled. The last figures are
sound arms that are refused.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
from collections import Counter
from concurrent.futures import ProcessPoolExecutor
from functools import partial
from multiprocessing import get_context
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2]))

from tests.oracles.shop_floor_remounted import KINDS, remounted

STANDINGS = 3
SLIPS_DEG = (10, 15, 20, 30, 60)

Found = Counter[tuple[int, int, bool]]
"""Refused, by joint, size (deg; both 0 for a sound arm) and whether the first placement was asked."""


def one_arm(kind: str, poses: int, seed: int) -> Found:
    """Try every slip on one arm, wherever it stands."""
    from hardware.arm import Reading
    from operator_app.calibration.prior import known_arm
    from operator_app.config.poses_file import parse_poses
    from operator_app.config.procedure_file import load_procedure
    from operator_app.errors import GuardError
    from operator_app.session.safety.preflight import check_closure_without_poses

    procedure = load_procedure("hinge")
    case = remounted(kind, seed, poses=poses, standings=STANDINGS)
    taken = parse_poses(case.first.csv().encode(), "first.csv").poses
    known = known_arm(procedure.arm, procedure.fixture.fixture, taken)
    found = Found()
    for q in case.standing:
        for joint, degrees in ((0, 0), *((j, d) for j in range(1, 8) for d in SLIPS_DEG)):
            read = q.copy()
            read[joint - 1] += np.deg2rad(degrees) * (-1.0 if (seed + joint) % 2 else 1.0)
            here = Reading(
                mean_counts=read, mean_rad=read, sd_rad=np.zeros(7), samples=32, first_sync=1
            )
            for asked in (False, True):
                try:
                    check_closure_without_poses(procedure, here, known if asked else None)
                except GuardError:
                    found[joint, degrees, asked] += 1
    return found


def main() -> None:
    """Print a table for each kind of arm."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--poses", type=int, default=20)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    stood = STANDINGS * chosen.arms
    with ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool:
        for kind in KINDS:
            found = Found()
            for one in pool.map(partial(one_arm, kind, chosen.poses), range(chosen.arms)):
                found += one
            print(f"{kind}: found of {stood}, by the files -> with the first placement, %")
            print("slip      " + "".join(f"{d:>9} deg" for d in SLIPS_DEG))
            for joint in range(1, 8):
                cells = (
                    f"{100 * found[joint, d, False] / stood:5.0f} -> {100 * found[joint, d, True] / stood:3.0f}"
                    for d in SLIPS_DEG
                )
                print(f"joint {joint}   " + "".join(f"{cell:>13}" for cell in cells))
            print(f"sound arms refused: {found[0, 0, False]} -> {found[0, 0, True]}\n", flush=True)


if __name__ == "__main__":
    main()
