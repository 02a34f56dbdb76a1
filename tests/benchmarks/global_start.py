"""The global start on random problems. Run: python -m tests.benchmarks.global_start [COUNT]

Offsets anywhere, hinge anywhere, 40 poses; run on two cores. Solved means: the offsets of joints 2 to 6
(the arm's own) and all closures are right to 1e-8 without sensor errors; with encoders, RVDT noise and a 1 %
RVDT curve, that the search ends in the minimum nearest to the truth. Every problem counts, however its poses
are conditioned.
"""

import argparse
import sys
from time import perf_counter

import numpy as np

from solver.chain.parameters import wrap_angle, wrap_angles
from solver.estimators.least_squares import solve_damped
from solver.estimators.paper import closure_problem
from solver.loops.closure import nearest_equivalent
from solver.loops.dh import DhLoop
from solver.search.global_start import GlobalStart, global_start
from tests.oracles.wild_loops import random_hinge_problem, with_sensor_errors
from tests.solver.search.test_global_start import model_without_initial_guess

GOAL_SOLVED, GOAL_SECONDS = 0.99, 5.0


def right(found: GlobalStart, offsets: np.ndarray) -> bool:
    off = np.abs(wrap_angle(found.x[1:6] - offsets[1:6])).max()
    return bool(off < 1e-8 and found.best.rms < 1e-8)


def same_minimum(model: DhLoop, found: GlobalStart, exact: np.ndarray, q: np.ndarray) -> bool:
    x = nearest_equivalent(model, solve_damped(closure_problem(model, q), exact).x, found.x)
    return bool(np.abs(wrap_angles(model.parameters, x - found.x)).max() < 1e-4)


def main() -> int:
    parser = argparse.ArgumentParser(description=__doc__)
    parser.add_argument("count", nargs="?", type=int, default=200)
    count = parser.parse_args().count
    model = model_without_initial_guess()
    rows: dict[str, list[tuple[bool, float, float, int]]] = {"exact": [], "sensors": []}
    failed = []
    for seed in range(count):
        problem = random_hinge_problem(seed)
        exact = None
        for kind, read in (("exact", problem.q), ("sensors", with_sensor_errors(problem.q, seed))):
            start = perf_counter()
            found = global_start(model, read)
            seconds = perf_counter() - start
            if exact is None:
                good = right(found, problem.offsets)
                exact = found.x
            else:
                good = same_minimum(model, found, exact, read)
            if not good:
                failed.append(f"{kind} {seed}")
            share = found.best.starts / found.starts
            rows[kind].append((good, seconds, share, len(found.alternatives)))
    print(f"{count} random hinge problems, nothing known, 40 poses; {found.starts} starts")
    print(
        "sensors                  solved   seconds: mean  worst   starts in best: median  least  rivals"
    )
    names = {"exact": "none", "sensors": "encoders, RVDTs 1 %"}
    good = True
    for kind, values in rows.items():
        solved, seconds, share, alternatives = (
            np.array(column) for column in zip(*values, strict=True)
        )
        print(
            f"{names[kind]:22} {solved.sum():4d}/{count:<4d} {seconds.mean():13.2f} {seconds.max():6.2f}"
            f" {np.median(share):21.1%} {share.min():7.1%} {(alternatives > 0).sum():5d}"
        )
        good &= solved.mean() >= GOAL_SOLVED and seconds.max() <= GOAL_SECONDS
    if failed:
        print("not solved: " + ", ".join(failed))
    print(f"goal ({GOAL_SOLVED:.0%} within {GOAL_SECONDS:g} s each): {'met' if good else 'missed'}")
    return 0 if good else 1


if __name__ == "__main__":
    sys.exit(main())
