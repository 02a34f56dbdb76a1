"""Programs killed at random instants: are accepted poses lost or wrong?

    python -m tests.benchmarks.campaign [--kills 300] [--processes 3] [--seed 0]

SIGKILL (``tests.oracles.killing``) of `sarcal run` and of `sarcal controller`, four fifths of the kills on the loopback
bus, the others of a program with its arm inside. Bars: no accepted pose lost and none wrong, no traceback, 5 s of the
processor at most until a dead controller is reported, 500 MB at most.
"""

import sys
import tempfile
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from tests.benchmarks.command_line import options
from tests.oracles.killing import KillSequence, KillStatistics

KILLS = 12
"""Of one sequence."""
EMBEDDED_SHARE = 0.2


def killed(folder: Path, seed: int, embedded: bool) -> KillStatistics:
    return KillSequence(folder, seed, KILLS, embedded=embedded).run()


def main() -> int:
    """Run sequences of kills, at least so many in total; 0 without faults."""
    chosen = options(__doc__, kills=300, processes=3, seed=0)
    count, results = -(-chosen.kills // KILLS), []
    with (
        tempfile.TemporaryDirectory() as root,
        ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool,
    ):
        jobs = [
            pool.submit(killed, Path(root, str(seed)), seed, k < round(count * EMBEDDED_SHARE))
            for k, seed in enumerate(range(chosen.seed, chosen.seed + count))
        ]
        for job in as_completed(jobs):
            results.append(job.result())
            print(*results[-1].faults, sep="\n\n", flush=True)
    kills, sessions, poses = (
        sum(getattr(r, name) for r in results) for name in ("kills", "sessions", "poses")
    )
    faults = sum(len(r.faults) for r in results)
    print(f"{kills} kills; {sessions} sessions completed with {poses} poses; {faults} faults")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
