"""A thousand poses in one session: what the last hundred cost beside the first, in time and in memory.

    python -m tests.benchmarks.many_poses [--poses 1000] [--solve-every 250]

The session is that of `sarcal run` on the embedded virtual arm, in its fast clock: moves, settling,
readings, and each pose in the journal before it counts. Every so many poses it is solved and the solution
kept, as an operator does who wants to see how it stands. Printed for each hundred: CPU time of this process
and bytes of the journal per pose, memory of the process after it. Bars: the last hundred poses take at most
1.2 times the first in CPU time, and memory grows by at most 20 kB a pose (what a pose is, twice kept).
"""

# ruff: noqa: E402, T201 - threads are limited before NumPy starts; a benchmark prints

from __future__ import annotations

import os

for name in ("OMP_NUM_THREADS", "OPENBLAS_NUM_THREADS", "MKL_NUM_THREADS"):
    os.environ.setdefault(name, "1")

import argparse
import sys
import tempfile
import time
from collections.abc import Iterator
from contextlib import contextmanager
from dataclasses import dataclass, replace
from pathlib import Path

from operator_app.calibration.calibrate import calibrate
from operator_app.composition import unattended
from operator_app.config.poses_file import load_poses
from operator_app.session.store.state import SessionState
from operator_app.session.workflow.capture import connect, take_poses
from operator_app.session.workflow.drive_selection import drives_of
from operator_app.session.workflow.listener import Listener
from operator_app.session.workflow.opening import Choices, begin
from operator_app.session.workflow.session import Session

BLOCK = 100
DATA = Path(__file__).parents[1] / "data" / "hinge" / "hinge_quantised.csv"
SLOWER, KILOBYTES_A_POSE = 1.2, 20.0


def memory_mb() -> float:
    """Resident memory of this process."""
    pages = int(Path("/proc/self/statm").read_text(encoding="ascii").split()[1])
    return pages * os.sysconf("SC_PAGE_SIZE") / 1e6


@dataclass(frozen=True, slots=True, kw_only=True)
class Block:
    """What some poses cost: CPU time and journal per pose, memory after them."""

    last: int
    cpu_ms: float
    journal_bytes: float
    memory_mb: float


class Watching(Listener):
    """Takes the figures as poses come."""

    def __init__(self, journal: Path, every: int) -> None:
        self.journal, self.every = journal, every
        self.blocks: list[Block] = []
        self._cpu_s, self._size = time.process_time(), journal.stat().st_size

    def pose_captured(self, state: SessionState, wanted: int) -> None:
        """Close a block, where one is full."""
        if state.captured % self.every:
            return
        cpu_s, size = time.process_time(), self.journal.stat().st_size
        self.blocks.append(
            Block(
                last=state.captured,
                cpu_ms=(cpu_s - self._cpu_s) / self.every * 1e3,
                journal_bytes=(size - self._size) / self.every,
                memory_mb=memory_mb(),
            )
        )
        self._cpu_s, self._size = cpu_s, size

    @contextmanager
    def not_counting(self) -> Iterator[None]:
        """Leave out what is done here: it is no pose's."""
        cpu_s, size = time.process_time(), self.journal.stat().st_size
        yield
        self._cpu_s += time.process_time() - cpu_s
        self._size += self.journal.stat().st_size - size


def session_of(poses: int, folder: Path, *, solve_every: int, block: int) -> list[Block]:
    """Take so many poses in one session, solving now and then; what each block of them cost."""
    opening = begin("hinge", Choices(poses=poses, seed=0), root=folder)
    with unattended(opening) as session:
        watching = Watching(session.journal.path, block)
        with watching.not_counting():
            # What is loaded for the first solution is no pose's memory.
            sound = load_poses(DATA, joint_count=session.model.joint_count).poses
            calibrate(session.model, session.fixture, sound)
            connect(session, watching)
            session.require_fixture()
            drives = drives_of(session, watching)
        whole = session.procedure
        for wanted in range(solve_every, poses + 1, solve_every):
            session.procedure = replace(whole, capture=replace(whole.capture, poses=wanted))
            take_poses(session, watching, drives)
            drives = None
            with watching.not_counting():
                print(f"{wanted} poses, solved in {solved(session):.1f} s of CPU", flush=True)
    return watching.blocks


def solved(session: Session) -> float:
    """Solve as it stands; CPU time it took."""
    begun = time.process_time()
    session.calibrate()
    return time.process_time() - begun


def main() -> int:
    """Take them and print the table."""
    parser = argparse.ArgumentParser(
        description=__doc__, formatter_class=argparse.RawTextHelpFormatter
    )
    parser.add_argument("--poses", type=int, default=1000)
    parser.add_argument("--solve-every", type=int, default=250)
    chosen = parser.parse_args()
    with tempfile.TemporaryDirectory() as folder:
        block = min(BLOCK, chosen.poses // 4)
        blocks = session_of(chosen.poses, Path(folder), solve_every=chosen.solve_every, block=block)
    print(f"{'to pose':>8}{'CPU ms a pose':>15}{'journal bytes a pose':>22}{'memory MB':>11}")
    for b in blocks:
        print(f"{b.last:8}{b.cpu_ms:15.1f}{b.journal_bytes:22.0f}{b.memory_mb:11.1f}")
    first, last = blocks[0], blocks[-1]
    slower = last.cpu_ms / first.cpu_ms
    grown_mb = last.memory_mb - first.memory_mb
    print(f"last over first: {slower:.2f} in time, {grown_mb:+.1f} MB")
    flat = slower < SLOWER and grown_mb < (last.last - first.last) * KILOBYTES_A_POSE / 1e3
    return 0 if flat else 1


if __name__ == "__main__":
    sys.exit(main())
