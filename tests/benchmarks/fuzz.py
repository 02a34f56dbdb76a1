"""Inputs nobody would write through every parser and over the wire: counts, the slowest, the memory; a table.

    python -m tests.benchmarks.fuzz [--inputs 50000] [--processes 2] [--first 0]

Bars: an answer or an error that `sarcal` says in words, five seconds of the processor and 500 MB at most
for each. An input that breaks one is named by parser and seed, and is made again by
``tests.oracles.fuzzing.outcome(parser, seed, folder)``; one of the wire by all seeds of its batch up to it, for an
operator that is connected has a past. Ctrl-C prints the table so far.
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import resource
import signal
import sys
import tempfile
import time
import traceback
import warnings
from collections import Counter
from dataclasses import dataclass, field
from multiprocessing import get_context
from pathlib import Path

sys.path.insert(0, str(Path(__file__).resolve().parents[1]))

from tests.oracles.fuzzing import PARSERS, outcome, over

LIMIT_S = 5.0
"""Of the processor: the machine may be busy with other things."""
LIMIT_MB = 500.0
STUCK_S = 300.0
"""By the clock: who waits for ever uses no processor."""
BATCH = 100


class TooLongError(Exception):
    """It was still at it when the limit was over."""


@dataclass
class Found:
    """What came of some inputs of one parser."""

    kind: str
    counts: Counter[str] = field(default_factory=Counter)
    slowest_s: float = 0.0
    peak_mb: float = 0.0
    faults: list[str] = field(default_factory=list)

    def add(self, other: Found) -> None:
        """Take in another batch."""
        self.counts += other.counts
        self.slowest_s = max(self.slowest_s, other.slowest_s)
        self.peak_mb = max(self.peak_mb, other.peak_mb)
        self.faults += other.faults


def batch(kind: str, seeds: range) -> Found:
    """Try inputs one after another."""

    def too_long(*_: object) -> None:
        raise TooLongError

    warnings.simplefilter("error")
    found = Found(kind)
    signal.signal(signal.SIGPROF, too_long)
    signal.signal(signal.SIGALRM, too_long)
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    with tempfile.TemporaryDirectory() as folder:
        for seed in seeds:
            begun = time.process_time()
            signal.setitimer(signal.ITIMER_PROF, LIMIT_S)
            signal.setitimer(signal.ITIMER_REAL, STUCK_S)
            try:
                came = outcome(kind, seed, Path(folder))
            except TooLongError:
                came = "too long"
                found.faults.append(f"{kind}, seed {seed}: over {LIMIT_S:g} s")
            except Exception:  # noqa: BLE001 - what is looked for
                came = "traceback"
                found.faults.append(f"{kind}, seed {seed}:\n{traceback.format_exc(limit=-3)}")
            finally:
                signal.setitimer(signal.ITIMER_PROF, 0.0)
                signal.setitimer(signal.ITIMER_REAL, 0.0)
            found.counts[came] += 1
            found.slowest_s = max(found.slowest_s, time.process_time() - begun)
        over()
    found.peak_mb = resource.getrusage(resource.RUSAGE_SELF).ru_maxrss / 1024
    if found.peak_mb > LIMIT_MB:
        found.faults.append(f"{kind}, seeds {seeds}: {found.peak_mb:.0f} MB")
    return found


def one_batch(job: tuple[str, range]) -> Found:
    """Try a batch."""
    return batch(*job)


def main() -> int:
    """Run all, print the table, say what broke."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--inputs", type=int, default=50_000)
    parser.add_argument("--processes", type=int, default=2)
    parser.add_argument("--first", type=int, default=0)
    chosen = parser.parse_args()
    shares = sum(share for share, _ in PARSERS.values())
    jobs: list[tuple[str, range]] = []
    for kind, (share, _) in PARSERS.items():
        last = chosen.first + max(1, round(chosen.inputs * share / shares))
        jobs += [(kind, range(k, min(k + BATCH, last))) for k in range(chosen.first, last, BATCH)]
    totals = {kind: Found(kind) for kind in PARSERS}
    begun = time.monotonic()
    # Other processes now and then, so that what one input takes is not held against the next.
    # The slow ones first: nobody waits for a last batch of theirs.
    slow = ("the wire", "the controller's nodes")
    jobs.sort(key=lambda job: (job[1].start, job[0] not in slow))
    with get_context("spawn").Pool(chosen.processes, maxtasksperchild=10) as pool:
        try:
            for found in pool.imap_unordered(one_batch, jobs):
                totals[found.kind].add(found)
        except KeyboardInterrupt:
            print("ended before its time:")
    print(
        f"{'parser':26}{'inputs':>8}{'accepted':>10}{'refused':>9}{'faults':>8}{'slowest s':>11}{'MB':>6}"
    )
    for kind, found in totals.items():
        count = found.counts
        print(
            f"{kind:26}{count.total():8}{count['accepted']:10}{count['refused']:9}"
            f"{len(found.faults):8}{found.slowest_s:11.2f}{found.peak_mb:6.0f}"
        )
    total = sum(found.counts.total() for found in totals.values())
    faults = [fault for found in totals.values() for fault in found.faults]
    print(f"{total} inputs in {time.monotonic() - begun:.0f} s, {len(faults)} faults")
    for fault in faults[:20]:
        print(f"\n{fault}")
    return 1 if faults else 0


if __name__ == "__main__":
    sys.exit(main())
