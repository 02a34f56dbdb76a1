"""All that can go wrong, in one command: kills, every fault in each phase of a session and in an upload; a table.

    python -m tests.benchmarks.campaign [--kills 300] [--processes 3] [--seed 0] [--without-faults]

Kills (``tests.oracles.killing``): SIGKILL at random instants of `sarcal run` and of `sarcal controller`, four fifths of
them on the loopback bus, the others of a program with its arm inside. Faults (``test_fault_campaign``): each
kind that the virtual controller knows, in five phases of a session and in an upload. Bars: no accepted pose
lost and none wrong, no traceback, 5 s of the processor at most until a fault is told, 500 MB at most.
Ctrl-C ends it, and whatever it began.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import resource
import sys
import tempfile
import time
import traceback
from collections import Counter
from concurrent.futures import as_completed
from pathlib import Path

sys.path.append(str(Path(__file__).resolve().parents[1]))

from tests.oracles.killing import CPU_S, MEMORY_MB, Deaths, chain
from tests.oracles.workers import INTERRUPTED, end_as_by_ctrl_c, workers

KILLS_A_CHAIN = 12
EMBEDDED_SHARE = 0.2
PER_PROCESS = 10
"""Faults before a process is replaced: its peak of memory is to be that of a few."""


def killed_chain(folder: str, seed: int, kills: int, embedded: bool) -> Deaths:
    """Run a chain here; what breaks the judge itself is a fault as well."""
    try:
        return chain(folder, seed, kills, embedded=embedded)
    except Exception:  # noqa: BLE001 - what is looked for
        return Deaths(faults=[f"{folder}:\n{traceback.format_exc(limit=-3)}"])


def kills(count: int, processes: int, seed: int) -> list[str]:
    """Run chains until so many kills are done; print what came of them, return the faults."""
    chains = max(1, round(count / KILLS_A_CHAIN))
    embedded = round(chains * EMBEDDED_SHARE)
    whole, begun = Deaths(), time.monotonic()
    with tempfile.TemporaryDirectory() as root, workers(processes) as pool:
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
    victims = sorted({victim for victim, _ in whole.killed})
    phases = Counter[str]()
    for (_, phase), times in whole.killed.items():
        phases[phase] += times
    print(f"{'killed after':18}" + "".join(f"{v:>24}" for v in victims))
    for phase, _ in phases.most_common():
        print(f"{phase:18}" + "".join(f"{whole.killed[v, phase]:24}" for v in victims))
    print(f"{'all':18}" + "".join(f"{sum(whole.killed[v, p] for p in phases):24}" for v in victims))
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


def one_fault(kind: str, at_sync: int) -> tuple[str, float, float, int]:
    """Run one session, or one upload (`at_sync` -1); what broke, CPU of the reaction, memory, poses."""
    from tests.system.test_fault_campaign import judge, upload_with

    begun, reaction_s, poses, broke = time.process_time(), 0.0, 0, ""
    where = "upload" if at_sync < 0 else f"SYNC {at_sync}"
    try:
        if at_sync < 0:
            upload_with(kind)
            reaction_s = time.process_time() - begun
        else:
            with tempfile.TemporaryDirectory() as folder:
                found = judge(kind, at_sync, Path(folder) / "s")
            reaction_s, poses = found.reaction_s, len(found.poses)
    except BaseException:  # noqa: BLE001 - what is looked for
        broke = f"{kind}, {where}:\n{traceback.format_exc(limit=-3)}"
    memory_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if not broke and (reaction_s > CPU_S or memory_mb > MEMORY_MB):
        broke = f"{kind}, {where}: {reaction_s:.1f} s, {memory_mb:.0f} MB"
    return broke, reaction_s, memory_mb, poses


def faults(processes: int) -> list[str]:
    """Run every fault in every phase and in an upload; print what came of them, return what broke."""
    from hardware.virtual.faults import FAULT_KINDS
    from tests.system.test_fault_campaign import BEFORE, FIRST_SYNCS, IN_CAPTURE

    phases = (BEFORE, FIRST_SYNCS, *IN_CAPTURE, -1)
    begun = time.monotonic()
    jobs = [(kind, phase) for kind in FAULT_KINDS for phase in phases]
    came: list[tuple[str, float, float, int]] = []
    for first in range(0, len(jobs), PER_PROCESS * processes):
        # Not by `max_tasks_per_child`: with it the pool of Python 3.11 to 3.14 may wait for ever
        # (python/cpython#115634).
        some = jobs[first : first + PER_PROCESS * processes]
        with workers(processes) as pool:
            came += [job.result() for job in [pool.submit(one_fault, *job) for job in some]]
        broke = [words for words, *_ in came if words]
        print(f"  {len(came)} faults, {len(broke)} broke", file=sys.stderr, flush=True)
    print(
        f"{len(came) - len(FAULT_KINDS)} sessions with a fault, {len(FAULT_KINDS)} uploads in "
        f"{time.monotonic() - begun:.0f} s: {sum(poses for *_, poses in came)} poses accepted, "
        f"{len(broke)} not as the table of faults says\n"
        f"CPU time until the fault was told: most {max(c[1] for c in came):.2f} s (bar {CPU_S:g}); memory: "
        f"at most {max(c[2] for c in came):.0f} MB (bar {MEMORY_MB:g})"
    )
    return broke


def main() -> int:
    """Run both, print, say what broke."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--kills", type=int, default=300)
    parser.add_argument("--processes", type=int, default=3)
    parser.add_argument("--seed", type=int, default=0)
    parser.add_argument("--without-faults", action="store_true")
    chosen = parser.parse_args()
    end_as_by_ctrl_c()
    try:
        broke = kills(chosen.kills, chosen.processes, chosen.seed) if chosen.kills else []
        if not chosen.without_faults:
            broke += faults(chosen.processes)
    except KeyboardInterrupt:
        print("ended before its time; nothing of it goes on", file=sys.stderr)
        return INTERRUPTED
    print(f"{len(broke)} faults")
    for words in broke:
        print(f"\n{words}")
    return 1 if broke else 0


if __name__ == "__main__":
    sys.exit(main())
