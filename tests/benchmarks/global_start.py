"""The global start on random problems. Run: python -m tests.benchmarks.global_start [COUNT]

Offsets anywhere, hinge anywhere, 40 poses; run on two cores. Solved means: the offsets of joints 2 to 6
(the arm's own) and all closures are right to 1e-8 without sensor errors; with encoders, RVDT noise and a 1 %
RVDT curve, that the search ends in the minimum nearest to the truth. Every problem counts, however its poses
are conditioned. Bar: 99 % solved, within 5 s each.
"""

import sys
from time import perf_counter

import numpy as np

from solver.chain.parameters import wrap_angle
from solver.search.global_start import GlobalStart, global_start
from tests.oracles.wild_loops import random_hinge_problem, with_sensor_errors
from tests.solver.search.test_global_start import distance_to_minimum, model_without_initial_guess

GOAL_SOLVED, GOAL_SECONDS = 0.99, 5.0


def right(found: GlobalStart, offsets: np.ndarray) -> bool:
    off = np.abs(wrap_angle(found.x[1:6] - offsets[1:6])).max()
    return bool(off < 1e-8 and found.best.rms < 1e-8)


def main() -> int:
    count = int(sys.argv[1]) if len(sys.argv) > 1 else 200
    model = model_without_initial_guess()
    rows: dict[str, list[tuple[bool, float]]] = {"none": [], "encoders, RVDTs 1 %": []}
    for seed in range(count):
        problem, exact = random_hinge_problem(seed), None
        for kind, read in zip(rows, (problem.q, with_sensor_errors(problem.q, seed)), strict=True):
            start = perf_counter()
            found = global_start(model, read)
            seconds = perf_counter() - start
            if exact is None:
                good, exact = right(found, problem.offsets), found.x
            else:
                good = distance_to_minimum(model, found.x, exact, read) < 1e-4
            if not good:
                print(f"not solved: seed {seed}, sensor errors {kind}")
            rows[kind].append((good, seconds))
    print(f"{count} random hinge problems, nothing known, 40 poses; {found.starts} starts")
    print("sensor errors            solved   seconds: mean  worst")
    met = True
    for kind, values in rows.items():
        solved, seconds = np.array(values).T
        print(
            f"{kind:22} {solved.sum():4.0f}/{count:<4d} {seconds.mean():13.2f} {seconds.max():6.2f}"
        )
        met &= bool(solved.mean() >= GOAL_SOLVED and seconds.max() <= GOAL_SECONDS)
    return 0 if met else 1


if __name__ == "__main__":
    sys.exit(main())
