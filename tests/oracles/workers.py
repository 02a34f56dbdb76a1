"""A pool of processes that ends with all that its workers began, whatever ends it: Ctrl-C above all.

Each worker leads a process group of its own: a terminal's Ctrl-C reaches the program alone, which then ends every
group. What a worker starts is in its group unless it leaves it by itself; its temporary files go with the pool.
"""

from __future__ import annotations

import os
import signal
import tempfile
from collections.abc import Iterable, Iterator
from concurrent.futures import ProcessPoolExecutor
from contextlib import contextmanager, suppress
from multiprocessing import active_children
from multiprocessing.context import SpawnContext, SpawnProcess
from multiprocessing.process import BaseProcess

INTERRUPTED = 130


class Worker(SpawnProcess):
    """A process that no Ctrl-C reaches before it leads a group of its own."""

    def start(self) -> None:
        """Begin it, Ctrl-C blocked: the mask goes over to the new program."""
        before = signal.pthread_sigmask(signal.SIG_BLOCK, {signal.SIGINT})
        try:
            super().start()
        finally:
            signal.pthread_sigmask(signal.SIG_SETMASK, before)


class _Context(SpawnContext):
    Process = Worker


def _lead_a_group(folder: str) -> None:
    tempfile.tempdir = folder
    os.setpgid(0, 0)
    # What came meanwhile was for the program.
    signal.signal(signal.SIGINT, signal.SIG_IGN)
    signal.pthread_sigmask(signal.SIG_UNBLOCK, {signal.SIGINT})
    signal.signal(signal.SIGINT, signal.default_int_handler)


@contextmanager
def workers(processes: int) -> Iterator[ProcessPoolExecutor]:
    """Return such a pool; where the work with it is left by an error, nothing is waited for."""
    others = set(active_children())
    with tempfile.TemporaryDirectory() as folder:
        pool = ProcessPoolExecutor(
            processes,
            mp_context=_Context(),
            initializer=_lead_a_group,
            initargs=(folder,),
        )
        try:
            yield pool
        except BaseException:
            _end(pool, set(active_children()) - others)
            raise
        finally:
            pool.shutdown()


def _end(pool: ProcessPoolExecutor, its: Iterable[BaseProcess]) -> None:
    pool.shutdown(wait=False, cancel_futures=True)
    for worker in its:
        if worker.pid is not None:
            # One that has only just begun leads no group yet.
            with suppress(ProcessLookupError):
                os.killpg(worker.pid, signal.SIGKILL)
        worker.kill()
        worker.join()


def end_as_by_ctrl_c() -> None:
    """Let SIGTERM, as of `timeout`, end this program as Ctrl-C does."""
    signal.signal(signal.SIGTERM, signal.default_int_handler)
