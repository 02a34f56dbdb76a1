"""What the pose after a slip tells of it, by the poses before it; and sessions in which a sound pose is doubted.

    python -m tests.benchmarks.next_pose [--arms 100] [--processes 2]

Arms of ``oracles.shop_floor_remounted``: as their files state, with the paper's larger errors, and wild ones; 40
poses each. A slip is in one joint's reading, as of one that is led and whose drive makes up for it. Bar: sound
sessions in which a pose is doubted are fewer than one in a hundred.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
from collections import Counter
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2]))

from tests.oracles.shop_floor_remounted import KINDS, remounted
from tests.oracles.workers import workers

POSES = 40
SLIPPED_BEFORE = (12, 20, 30, 40)
"""Numbers of the poses that are the first after a slip."""
COUNTS = (111, 250, 500, 1111)
COUNT_RAD = 2.0 * np.pi / 400_000
JOINTS = (1, 2, 3, 4, 5)

Found = Counter[tuple[int, int]]
"""Out of line, by joint and counts; (0, 0): sound sessions in which any pose is."""


def one_arm(kind: str, seed: int) -> Found:
    """Try every pose as it is, and some with every slip."""
    from operator_app.calibration.foreseen import LEAST, out_of_line
    from operator_app.calibration.loop import pick
    from operator_app.config.poses_file import parse_poses
    from operator_app.config.procedure_file import load_procedure

    procedure = load_procedure("hinge")
    arm, fixture = procedure.arm, procedure.fixture.fixture
    taken = remounted(kind, seed, poses=POSES, standings=1).first
    poses = parse_poses(taken.csv().encode(), "poses.csv").poses
    found = Found()
    for count in range(LEAST + 1, POSES + 1):
        here = pick(poses, np.arange(count))
        if out_of_line(arm, fixture, here):
            found[0, 0] = 1
        if count not in SLIPPED_BEFORE:
            continue
        for joint in JOINTS:
            for counts in COUNTS:
                q = here.q_rad.copy()
                q[-1, joint - 1] += (1 if (seed + count) % 2 else -1) * counts * COUNT_RAD
                found[joint, counts] += out_of_line(arm, fixture, replace(here, q_rad=q))
    return found


def main() -> int:
    """Print a table for each kind of arm; 1 where sound sessions are doubted too often."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    doubted, tried = 0, chosen.arms * len(SLIPPED_BEFORE)
    with workers(chosen.processes) as pool:
        for kind in KINDS:
            found = Found()
            for one in pool.map(partial(one_arm, kind), range(chosen.arms)):
                found += one
            doubted += found[0, 0]
            print(f"{kind}: seen at the next pose of {tried}, %")
            print("counts    " + "".join(f"{c:>6}" for c in COUNTS))
            for joint in JOINTS:
                cells = (f"{100 * found[joint, c] / tried:6.0f}" for c in COUNTS)
                print(f"joint {joint}   " + "".join(cells))
            print(f"sound sessions doubted: {found[0, 0]} of {chosen.arms}\n", flush=True)
    return 1 if 100 * doubted >= len(KINDS) * chosen.arms else 0


if __name__ == "__main__":
    sys.exit(main())
