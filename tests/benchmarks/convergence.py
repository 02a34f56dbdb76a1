"""Does the iteration settle? Many sound sessions, small and large, of two generators; prints a table.

    python -m tests.benchmarks.convergence [--seeds 60] [--workers 2]

Bar: of all sound data sets none is refused because the iteration did not settle. Sessions are the first
so many poses of a longer one: arms of the shop floor with every error at its stated size and with none,
and loops that close anywhere in the room (`tests.oracles.simulated_loops`), with noise and curves only.
"""

import sys
from collections.abc import Sequence
from dataclasses import dataclass
from functools import partial

import numpy as np
import sarcal

from operator_app.calibration.calibrate import calibrate
from operator_app.exit_codes import EXPECTED_ERRORS
from solver.chain.poses import PoseSet
from tests.benchmarks.command_line import options, workers
from tests.oracles.as_shipped import ARM, HINGE, poses_of
from tests.oracles.shop_floor import Sizes, session
from tests.oracles.simulated_loops import Simulation, wrist_curves

COUNTS = (6, 7, 8, 10, 14, 24, 60)
KINDS = ("every error", "no error", "random loops")
FIRST_SEED = 5100


@dataclass(frozen=True, kw_only=True)
class Settling:
    """One data set: rounds until the iteration settled, or why there was nothing to iterate."""

    rounds: int = 0
    settled: bool = True
    refused: str = ""


def prefixes(kind: str, seed: int, counts: Sequence[int]) -> list[PoseSet]:
    """The first so many poses of one session."""
    most = max(counts)
    if kind == "random loops":
        q = Simulation(poses=most, bows=wrist_curves()).readings(seed)
        return [sarcal.poses_of(q_rad=q[:n])._set for n in counts]
    sizes = Sizes.everything() if kind == "every error" else Sizes.only()
    taken = session(seed, sizes, poses=most)
    return [poses_of(taken.picked(np.arange(n))) for n in counts]


def settlings(seed: int, *, kind: str, counts: Sequence[int]) -> list[Settling]:
    """Calibrate every one of them with default options."""
    found = []
    for poses in prefixes(kind, seed, counts):
        try:
            estimate = calibrate(ARM, HINGE, poses).estimate
        except EXPECTED_ERRORS as error:
            found.append(Settling(refused=type(error).__name__))
            continue
        found.append(Settling(rounds=estimate.iterations, settled=estimate.converged))
    return found


def main() -> int:
    """Run and print; 0 when every data set settles."""
    chosen = options(__doc__, seeds=60, workers=2)
    seeds = range(FIRST_SEED, FIRST_SEED + chosen.seeds)
    unsettled = sets = 0
    print(f"{'':14}{'poses':>6}{'sets':>6}{'refused':>9}{'rounds':>8}{'most':>6}  not settled")
    with workers(chosen.workers) as pool:
        for kind in KINDS:
            of_seeds = list(pool.map(partial(settlings, kind=kind, counts=COUNTS), seeds))
            for n, column in zip(COUNTS, zip(*of_seeds, strict=True), strict=True):
                solved = [s for s in column if not s.refused]
                bad = [seed for seed, s in zip(seeds, column, strict=True) if not s.settled]
                rounds = np.array([s.rounds for s in solved])
                unsettled, sets = unsettled + len(bad), sets + len(solved)
                print(
                    f"{kind:14}{n:6}{len(solved):6}{len(column) - len(solved):9}"
                    f"{rounds.mean():8.1f}{rounds.max():6}  {len(bad)} {bad or ''}",
                    flush=True,
                )
    print(f"not settled: {unsettled} of {sets} (bar 0)")
    return 0 if unsettled == 0 else 1


if __name__ == "__main__":
    sys.exit(main())
