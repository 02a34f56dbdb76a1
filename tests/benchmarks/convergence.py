"""Convergence of the iteration on many sound sessions, small and large, of two generators; prints a table.

    python -m tests.benchmarks.convergence [--seeds 60] [--workers 2]

Bar: no sound data set is refused because the iteration did not converge. Sessions are the first poses of a longer one:
arms of `tests.oracles.shop_floor` with every error at its stated size and with none, and random loops
(`tests.oracles.simulated_loops`) with noise and curves only.
"""

import sys
from collections.abc import Sequence
from functools import partial

import numpy as np
import sarcal

from operator_app.calibration.calibrate import calibrate
from operator_app.exit_codes import EXPECTED_ERRORS
from solver.estimators.estimate import Estimate
from tests.benchmarks.command_line import options, workers
from tests.oracles.as_shipped import ARM, HINGE, poses_of
from tests.oracles.shop_floor import Sizes, session
from tests.oracles.simulated_loops import Simulation, wrist_curves

COUNTS = (6, 7, 8, 10, 14, 24, 60)
KINDS = ("every error", "no error", "random loops")
FIRST_SEED = 5100


def estimates_of(seed: int, *, kind: str, counts: Sequence[int]) -> list[Estimate | None]:
    """Calibrate the first poses of one session, so many each time; None where they are refused."""
    most = max(counts)
    if kind == "random loops":
        q = Simulation(poses=most, bows=wrist_curves()).readings(seed)
        sets = [sarcal.poses_of(q_rad=q[:n])._set for n in counts]
    else:
        taken = session(seed, Sizes() if kind == "every error" else Sizes.only(), poses=most)
        sets = [poses_of(taken.picked(slice(n))) for n in counts]
    results = []
    for poses in sets:
        try:
            results.append(calibrate(ARM, HINGE, poses).estimate)
        except EXPECTED_ERRORS:
            results.append(None)
    return results


def main() -> int:
    """Run and print; 0 when every data set converges."""
    chosen = options(__doc__, seeds=60, workers=2)
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.seeds)
    diverged = sets = 0
    print(f"{'':14}{'poses':>6}{'sets':>6}{'refused':>9}{'rounds':>8}{'most':>6}  not converged")
    with workers(chosen.workers) as pool:
        for kind in KINDS:
            of_seeds = list(pool.map(partial(estimates_of, kind=kind, counts=COUNTS), seeds))
            for n, column in zip(COUNTS, zip(*of_seeds, strict=True), strict=True):
                solved = {seed: c for seed, c in zip(seeds, column, strict=True) if c is not None}
                bad = [seed for seed, c in solved.items() if not c.converged]
                rounds = np.array([c.iterations for c in solved.values()])
                diverged, sets = diverged + len(bad), sets + len(solved)
                print(
                    f"{kind:14}{n:6}{len(solved):6}{len(column) - len(solved):9}"
                    f"{rounds.mean():8.1f}{rounds.max():6}  {len(bad)} {bad or ''}",
                    flush=True,
                )
    print(f"not converged: {diverged} of {sets} (bar 0)")
    return 0 if diverged == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
