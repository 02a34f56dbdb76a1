"""Programs killed at random instants: are accepted poses lost or wrong?

    python -m tests.benchmarks.campaign [--kills 300] [--processes 3] [--seed 0]

SIGKILL (``tests.oracles.killing``) of `sarcal run` and of `sarcal controller`, four fifths of the kills on the loopback
bus, the others of a program with its arm inside. Bars: no accepted pose lost and none wrong, no traceback, 5 s of the
processor at most until a dead controller is reported, 500 MB at most.
"""

import sys
import tempfile
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context
from pathlib import Path

from tests.benchmarks.command_line import options
from tests.oracles.killing import KillSequence, KillStatistics

KILLS_A_CHAIN = 12
EMBEDDED_SHARE = 0.2


def killed(folder: str, seed: int, kills: int, embedded: bool) -> KillStatistics:
    """Run a sequence of kills in this process; an error of the test itself is a fault as well."""
    try:
        return KillSequence(Path(folder), seed, kills, embedded=embedded).run()
    except Exception:  # noqa: BLE001 - what is looked for
        return KillStatistics(faults=[f"{folder}:\n{traceback.format_exc(limit=-3)}"])


def main() -> int:
    """Run sequences of kills until so many are done; 0 without faults."""
    chosen = options(__doc__, kills=300, processes=3, seed=0)
    count, seed, whole = chosen.kills, chosen.seed, KillStatistics()
    chains = max(1, round(count / KILLS_A_CHAIN))
    with (
        tempfile.TemporaryDirectory() as root,
        ProcessPoolExecutor(chosen.processes, get_context("spawn")) as pool,
    ):
        jobs = [
            pool.submit(
                killed,
                f"{root}/chain-{seed + k}",
                seed + k,
                count * (k + 1) // chains - count * k // chains,
                k < round(chains * EMBEDDED_SHARE),
            )
            for k in range(chains)
        ]
        for job in as_completed(jobs):
            whole.add(job.result())
            print(*job.result().faults, sep="\n\n", flush=True)
    print(
        f"{whole.kills} kills; {whole.sessions} sessions went on to their end with {whole.poses} poses; "
        f"{len(whole.faults)} faults"
    )
    return 1 if whole.faults else 0


if __name__ == "__main__":
    sys.exit(main())
