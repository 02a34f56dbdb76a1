"""What the pose after a slip tells of it, by the poses before it; and sessions in which a sound pose is doubted.

    python -m tests.benchmarks.next_pose [--poses planned] [--kinds stated] [--arms 100] [--processes 2]

Arms of ``tests.oracles.shop_floor_remounted``: as their files state, with the paper's larger errors, and wild
ones; 40 poses each, explored. Or, without wild arms, poses of plans, or by hand
(``tests.oracles.shop_floor_elsewhere``). A slip is in one joint's reading, as of one that is led and whose drive makes
up for it. Bar: sound sessions in which a pose is doubted are fewer than one in a hundred. Plans for arms with the
larger errors do not meet it: 4 of 100.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
from collections import Counter
from collections.abc import Sequence
from dataclasses import replace
from functools import partial
from pathlib import Path

import numpy as np

sys.path.append(str(Path(__file__).resolve().parents[2]))

from tests.oracles.shop_floor import Session
from tests.oracles.shop_floor_elsewhere import led_by_hand, plan_of, planned
from tests.oracles.shop_floor_remounted import ENOUGH, KINDS, remounted
from tests.oracles.workers import workers

POSES = 40
PLANNED, CANDIDATES, PLANS = 12, 300, 4
"""Poses of a plan, and of how many it is chosen; so many plans are made."""
SLIPPED_BEFORE = {
    "explored": (12, 20, 30, 40),
    "by hand": (12, 20, 30, 40),
    "planned": (12, 15, 18),
}
"""Numbers of the poses that are the first after a slip."""
COUNTS = (111, 250, 500, 1111)
COUNT_RAD = 2.0 * np.pi / 400_000
JOINTS = (1, 2, 3, 4, 5)

Found = Counter[tuple[int, int]]
"""Out of line, by joint and counts; (0, 0): sound sessions in which any pose is, (0, 1): slips that were tried."""


def one_arm(how: str, counts_lost: Sequence[int], kind: str, seed: int) -> Found:
    """Try every pose as it is, and some with every slip."""
    from operator_app.calibration.closed_loops import pick
    from operator_app.calibration.innovation import LEAST, contradicts, fit_recent_poses
    from operator_app.config.poses_file import parse_poses
    from operator_app.config.procedure_file import load_procedure

    procedure = load_procedure("hinge")
    arm, fixture = procedure.arm, procedure.fixture.fixture
    csv = taken(how, kind, seed).csv()
    poses = parse_poses(csv.encode(), "poses.csv").poses
    found = Found()
    for before in range(LEAST, len(poses)):
        by, last = (
            fit_recent_poses(arm, fixture, pick(poses, np.arange(before))),
            pick(poses, np.array([before])),
        )
        if by is None:
            continue
        if contradicts(by, arm, fixture, last):
            found[0, 0] = 1
        if before + 1 not in SLIPPED_BEFORE[how]:
            continue
        found[0, 1] += 1
        for joint in JOINTS:
            for counts in counts_lost:
                q = last.q_rad.copy()
                q[0, joint - 1] += (1 if (seed + before) % 2 else -1) * counts * COUNT_RAD
                found[joint, counts] += contradicts(by, arm, fixture, replace(last, q_rad=q))
    return found


def taken(how: str, kind: str, seed: int) -> Session:
    """Draw an arm and let it take its poses; one that cannot is drawn again."""
    if how == "explored":
        return remounted(kind, seed, poses=POSES, standings=1).first
    for number in range(ENOUGH * seed, ENOUGH * (seed + 1)):
        try:
            if how == "by hand":
                return led_by_hand(number, KINDS[kind], poses=POSES)
            plan = plan_of(seed % PLANS, poses=PLANNED, candidates=CANDIDATES)
            return planned(number, KINDS[kind], plan)
        except RuntimeError:
            continue
    raise RuntimeError(f"arm {seed} takes no poses")


def main() -> int:
    """Print a table for each kind of arm; 1 where sound sessions are doubted too often."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--poses", choices=SLIPPED_BEFORE, default="explored")
    parser.add_argument("--kinds", choices=KINDS, nargs="+", default=None)
    parser.add_argument("--counts", type=int, nargs="+", default=COUNTS)
    parser.add_argument("--arms", type=int, default=100)
    parser.add_argument("--processes", type=int, default=2)
    chosen = parser.parse_args()
    kinds = chosen.kinds or [k for k in KINDS if chosen.poses == "explored" or k != "wild"]
    doubted = 0
    with workers(chosen.processes) as pool:
        for kind in kinds:
            found = Found()
            work = partial(one_arm, chosen.poses, chosen.counts, kind)
            for one in pool.map(work, range(chosen.arms)):
                found += one
            doubted += found[0, 0]
            print(f"{kind}, {chosen.poses}: seen at the next pose of {found[0, 1]}, %")
            print("counts    " + "".join(f"{c:>6}" for c in chosen.counts))
            for joint in JOINTS:
                cells = (f"{100 * found[joint, c] / found[0, 1]:6.0f}" for c in chosen.counts)
                print(f"joint {joint}   " + "".join(cells))
            print(f"sound sessions doubted: {found[0, 0]} of {chosen.arms}\n", flush=True)
    return 1 if 100 * doubted >= len(kinds) * chosen.arms else 0


if __name__ == "__main__":
    sys.exit(main())
