"""Programs killed at random instants; prints a table.

    python -m tests.benchmarks.campaign [--kills 300] [--processes 3] [--seed 0]

SIGKILL (``tests.oracles.killing``) of `sarcal run` and of `sarcal controller`, four fifths of the kills on the loopback
bus, the others of a program with its arm inside. Bars: no accepted pose lost and none wrong, no traceback, 5 s of the
processor at most until a dead controller is reported, 500 MB at most.
"""

import sys
import tempfile
import time
import traceback
from concurrent.futures import ProcessPoolExecutor, as_completed
from multiprocessing import get_context

from tests.benchmarks.command_line import options
from tests.oracles.killing import CPU_S, MEMORY_MB, KillStatistics, chain

KILLS_A_CHAIN = 12
EMBEDDED_SHARE = 0.2


def killed_chain(folder: str, seed: int, kills: int, embedded: bool) -> KillStatistics:
    """Run a chain here; what breaks the judge itself is a fault as well."""
    try:
        return chain(folder, seed, kills, embedded=embedded)
    except Exception:  # noqa: BLE001 - what is looked for
        return KillStatistics(faults=[f"{folder}:\n{traceback.format_exc(limit=-3)}"])


def kills(count: int, processes: int, seed: int) -> list[str]:
    """Run chains until so many kills are done; print what came of them, return the faults."""
    chains = max(1, round(count / KILLS_A_CHAIN))
    embedded = round(chains * EMBEDDED_SHARE)
    whole, begun = KillStatistics(), time.monotonic()
    with (
        tempfile.TemporaryDirectory() as root,
        ProcessPoolExecutor(processes, get_context("spawn")) as pool,
    ):
        jobs = [
            pool.submit(
                killed_chain,
                f"{root}/chain-{seed + k}",
                seed + k,
                count * (k + 1) // chains - count * k // chains,
                k < embedded,
            )
            for k in range(chains)
        ]
        for job in as_completed(jobs):
            done = job.result()
            whole.add(done)
            for fault in done.faults:  # at once: who ends this early has seen it
                print(fault, file=sys.stderr)
            print(f"  {whole.total} kills, {len(whole.faults)} faults", file=sys.stderr, flush=True)
    for (victim, phase), times in whole.killed.most_common():
        print(f"{times:5} kills of the {victim} after {phase}")
    print(
        f"{whole.total} kills in {time.monotonic() - begun:.0f} s, {whole.sessions} sessions went on to their "
        f"end with {whole.poses} poses; last lines torn: {whole.torn}"
    )
    if whole.reactions_s:
        print(
            f"CPU time of an operator until it said that its controller is dead: "
            f"median {sorted(whole.reactions_s)[len(whole.reactions_s) // 2]:.2f} s, "
            f"most {max(whole.reactions_s):.2f} s (bar {CPU_S:g})"
        )
    print(f"memory: at most {whole.peak_mb:.0f} MB (bar {MEMORY_MB:g})")
    for words, times in whole.words.most_common():
        print(f"{times:5} times: {words}")
    return whole.faults


def main() -> int:
    chosen = options(__doc__, kills=300, processes=3, seed=0)
    broke = kills(chosen.kills, chosen.processes, chosen.seed)
    print(f"{len(broke)} faults")
    for words in broke:
        print(f"\n{words}")
    return 1 if broke else 0


if __name__ == "__main__":
    sys.exit(main())
